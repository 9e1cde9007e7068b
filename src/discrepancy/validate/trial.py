"""A trial of residuals: terms that are free in each clip, over all clips, beside launches and shared parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from discrepancy.arrays import Array
from discrepancy.policy import current_policy

SEEN = 1e-5  # of a term's length that the terms before it must leave
SHOWN = 1e-6  # of what a shared parameter does that must be in a trial to count there
SPANNED = 1e-3  # of a template's length that others must leave


@dataclass(frozen=True)
class ClipAmplitudes:
    """One clip's part in a trial. P terms, of which the clip tells m combinations.

    pulls (m,): amplitudes, of unit variance; per_metre (m, P): pulls that a metre of each term would make;
    shared (m, S): those of the shared parameters; squares (P, P): products of the terms, summed over `rows` rows, in
    which `left` is the sum of squares of the residuals, m^2; features: by what the trial is held against, numbers (f,)
    of this clip.
    """

    pulls: Array
    per_metre: Array
    shared: Array
    information: Array
    pull: Array
    squares: Array
    rows: int
    left: float
    features: dict[str, Array]


@dataclass(frozen=True)
class ClipSolution:
    """Least squares of one clip: amplitudes of unit-length terms, their covariance, and what shared parameters do.

    information (S, S) and pull (S,): of the shared parameters in what the terms leave free.
    """

    kept: NDArray[np.bool_]
    length: Array
    amplitude: Array
    covariance: Array
    shared: Array
    information: Array
    pull: Array

    @classmethod
    def of(cls, launch: Array, columns: Array, residual: Array, shared: Array) -> ClipSolution:
        """columns (2n, T) of the terms; the launch is free beside them. All whitened."""
        both = np.column_stack([launch, columns])
        length = np.linalg.norm(both, axis=0)
        unit = both / np.where(length > 0, length, 1)
        shown = np.abs(np.diag(np.linalg.qr(unit, mode="r"))) > SEEN
        q, r = np.linalg.qr(unit[:, shown])
        inverse = np.linalg.inv(r)
        at, first = np.flatnonzero(shown), launch.shape[1]
        amplitude, covariance = np.zeros(len(shown)), np.zeros((len(shown),) * 2)
        amplitude[at] = inverse @ (q.T @ residual)
        covariance[np.ix_(at, at)] = inverse @ inverse.T
        slopes = np.zeros((len(shown), shared.shape[1]))
        slopes[at] = inverse @ (q.T @ shared)
        terms, rest = slice(first, None), shared - q @ (q.T @ shared)
        found = amplitude[terms], covariance[terms, terms], slopes[terms]
        return cls(shown[terms], length[terms], *found, rest.T @ rest, rest.T @ residual)

    def group(self, rows: list[int]) -> tuple[Array, Array, Array]:
        """Of some terms, all others free: pulls of unit variance, and those by a metre of each, by what is shared."""
        root = np.linalg.inv(np.linalg.cholesky(self.covariance[np.ix_(rows, rows)]))
        return root @ self.amplitude[rows], root * self.length[rows], root @ self.shared[rows]


def results(parts: Sequence[ClipAmplitudes]) -> Iterator[tuple[str, float, int, float]]:
    """(against, chi^2, degrees of freedom, size in um) of one trial over all clips.

    The shared parameters are free; what the trial leaves of the clips tells of them too, as a few rows more.
    """
    values, axes = np.linalg.eigh(sum(g.information for g in parts))
    seen = values > SHOWN * values.max(initial=0)
    roots = np.sqrt(values[seen])
    rest = axes[:, seen].T @ sum(g.pull for g in parts) / roots
    pulls = np.concatenate([*(g.pulls for g in parts), rest])
    taken = _basis(np.concatenate([*(g.shared for g in parts), roots[:, None] * axes[:, seen].T]))
    left = pulls - taken @ (taken.T @ pulls)
    freedom = len(pulls) - taken.shape[1]
    if freedom:
        yield "", float(left @ left), freedom, _size(parts, left, freedom / len(pulls))
    if not parts[0].features or len(parts) < current_policy().min_clips_for_trend:
        return
    always = _basis(np.column_stack([_stacked([g.per_metre for g in parts], len(rest)), taken]))
    for against in parts[0].features:
        changing = [np.asarray(np.kron(g.features[against], g.per_metre)) for g in parts]
        basis = _basis(_stacked(changing, len(rest)), always)
        shown = basis.T @ pulls
        if len(shown):
            yield against, float(shown @ shown), len(shown), _size(parts, basis @ shown, len(shown) / len(pulls))


def _stacked(columns: Sequence[Array], rest: int) -> Array:
    """Of all clips, with zeros in the `rest` rows that tell of the shared parameters only."""
    return np.concatenate([*columns, np.zeros((rest, columns[0].shape[1]))])


def _basis(columns: Array, besides: Array | None = None) -> Array:
    """An orthonormal basis of what columns span, less what `besides`, orthonormal, spans."""
    length = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(length > 0, length, 1)
    if besides is not None:
        unit = unit - besides @ (besides.T @ unit)
    axes, sizes, _ = np.linalg.svd(unit, full_matrices=False)
    return np.asarray(axes[:, sizes > SPANNED])


def _size(parts: Sequence[ClipAmplitudes], pulls: Array, noisy: float) -> float:
    """rms displacement, um, that makes these pulls, less what noise makes: `noisy` of its directions are in them.

    nan where the residuals are so much smaller that the terms of this trial and those beside it all but cancel.
    """
    total, rows, first = 0.0, 0, 0
    for g in parts:
        metres = np.linalg.pinv(g.per_metre)
        terms = metres @ pulls[first : first + len(g.pulls)]
        total += float(terms @ g.squares @ terms - noisy * np.trace(metres.T @ g.squares @ metres))
        rows, first = rows + g.rows, first + len(g.pulls)
    if total > current_policy().max_disagreement_to_residual ** 2 * sum(g.left for g in parts):
        return float("nan")
    return 1e6 * float(np.sqrt(max(total, 0.0) / rows))
