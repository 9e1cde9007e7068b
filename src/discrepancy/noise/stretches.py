"""Bundles stretches of smooth motion, and computes the restricted likelihood of their residuals from a cubic."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz

from discrepancy.arrays import Array, Ints
from discrepancy.policy import current_policy

Stretch = tuple[Array, Array, Ints]  # positions (n, axes), claimed standard deviations (n,), and frames (n,)

CUBIC_COEFFICIENTS = 4


@dataclass(frozen=True)
class StretchBundle:
    """k stretches of about the same length, the longest of n positions.

    Attributes
    ----------
    values : (k, n, d) array
        Positions without their cubics, over the claimed deviations; zero beyond each stretch's own length.
    basis : (k, n, CUBIC_COEFFICIENTS) array
        An orthonormal basis of the cubics, over the claimed deviations.
    lengths : (k,) array of int
    frames : (k, n) array of int, optional
        Counted from each first one, and continued beyond a stretch's end; None where no frame is missing.
    """

    values: Array
    basis: Array
    lengths: Ints
    frames: Ints | None = None

    @classmethod
    def of(
        cls, values: Sequence[Array], claims: Sequence[Array], frames: Sequence[Ints] | None = None
    ) -> StretchBundle:
        """Bundle stretches: the positions (n, d), the claimed deviations (n,) and the frames (n,) of each."""
        lengths = np.array([len(v) for v in values])
        since = np.tile(np.arange(lengths.max()), (len(values), 1))
        cubics, rest = (
            np.zeros((len(values), int(lengths.max()), m)) for m in (CUBIC_COEFFICIENTS, values[0].shape[1])
        )
        for k, (places, claimed) in enumerate(zip(values, claims, strict=True)):
            n = len(places)
            if frames is not None:
                since[k, :n] = frames[k] - frames[k][0]
                since[k, n:] = since[k, n - 1] + 1 + np.arange(since.shape[1] - n)
            powers, own = cubic_basis(since[k, :n]) / claimed[:, None], places / claimed[:, None]
            q, _ = np.linalg.qr(powers)
            cubics[k, :n], rest[k, :n] = q, own - q @ (q.T @ own)
        return cls(rest, cubics, lengths, since if np.any(np.diff(since) != 1) else None)

    @property
    def span(self) -> int:
        """Frames from the first to the last, both counted."""
        return int(self.lengths.max()) if self.frames is None else int(self.frames.max()) + 1

    def covariance(self, lags: Array) -> Array:
        """Covariance from autocovariances at lags 0 to span - 1: (n, n), or (k, n, n) where frames are missing."""
        if self.frames is None:
            return np.asarray(toeplitz(lags[: self.values.shape[1]]))
        return np.asarray(lags[np.abs(self.frames[:, :, None] - self.frames[:, None])])

    def restricted_likelihood(self, covariance: Array) -> tuple[float, float]:
        """(log determinants, sum of squares) of REML's -2 log likelihood, for a covariance (n, n) or (k, n, n).

        A shorter stretch uses the first rows and columns: their inverse Cholesky factor is the first part of the
        whole one's. See Harville, Biometrika 61 (1974) 383.
        """
        inside = np.arange(self.values.shape[1]) < self.lengths[:, None]
        factor = np.linalg.cholesky(covariance)
        white = np.linalg.inv(factor) @ np.concatenate([self.basis, self.values], axis=2) * inside[..., None]
        fitted, seen = white[..., :CUBIC_COEFFICIENTS], white[..., CUBIC_COEFFICIENTS:]
        gram, pull = fitted.swapaxes(1, 2) @ fitted, fitted.swapaxes(1, 2) @ seen
        squares = (seen**2).sum() - (pull * np.linalg.solve(gram, pull)).sum()
        logs = (np.log(np.diagonal(factor, axis1=-2, axis2=-1)) * inside).sum() + np.linalg.slogdet(gram)[1].sum() / 2
        return float(2 * self.values.shape[2] * logs), float(squares)

    @property
    def freedom(self) -> int:
        return int((self.lengths - CUBIC_COEFFICIENTS).sum()) * int(self.values.shape[2])


def cubic_basis(since: Ints) -> Array:
    """Powers 3 to 0 of increasing frames (n,), scaled to -1 ... 1: (n, CUBIC_COEFFICIENTS)."""
    even = np.linspace(-1, 1, since[-1] - since[0] + 1)
    return np.vander(even[since - since[0]], CUBIC_COEFFICIENTS)


def group_by_length(lengths: Sequence[int], ratio: float = 1.4) -> list[list[int]]:
    """Which stretches to put into one bundle: the longest is at most `ratio` times the shortest."""
    out: list[list[int]] = []
    least = shortest_usable(lengths)
    for k in sorted(range(len(lengths)), key=lambda k: -lengths[k]):
        if lengths[k] >= least:
            if not out or lengths[out[-1][0]] > ratio * lengths[k]:
                out.append([])
            out[-1].append(k)
    return out


def shortest_usable(lengths: Sequence[int]) -> int:
    """Positions that a stretch must have; fewer where no stretch is long."""
    enough = max(lengths, default=0) >= current_policy().min_stretch_positions
    return current_policy().min_stretch_positions if enough else current_policy().min_short_stretch_positions


def bundle_stretches(stretches: Iterable[Stretch]) -> list[StretchBundle]:
    every = list(stretches)
    groups = group_by_length([len(places) for places, *_ in every])
    parts = [[every[k] for k in group] for group in groups]
    return [
        StretchBundle.of([p for p, _, _ in some], [c for _, c, _ in some], [f for _, _, f in some]) for some in parts
    ]
