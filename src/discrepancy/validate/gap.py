"""How far simulation and measurement stand apart on collisions that no fit has seen, before and after."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import ModelFit, orthonormal_basis
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.policy import current_policy

PHASES = ("before", "sliding", "rolling")


@dataclass(frozen=True)
class GapPhase:
    """The gap in a phase of the clips kept out: chi^2 a point, and rms in um. The floor is what noise alone leaves."""

    before: float
    after: float
    floor: float
    before_um: float
    after_um: float
    floor_um: float


@dataclass(frozen=True)
class Gap(GapPhase):
    """The gap in all phases together.

    Attributes
    ----------
    closure : float
        The share of the gap between before and floor that is closed; NaN where that gap is no larger than chance makes
        it.
    by_phase : dict of str to Part
        Of the phases before, sliding and rolling.
    """

    closure: float
    by_phase: dict[str, GapPhase]


@dataclass(frozen=True)
class GapFits:
    """The gap with the two fits of the clips kept out, for the figures."""

    gap: Gap
    before: ModelFit
    after: ModelFit


def measure_gap(
    clips: Sequence[MeasuredCollision],
    base: ModelFit,
    best: ModelFit,
    noise: Noise,
    progress: Callable[[], None] = lambda: None,
    outside: Callable[[ModelFit], ModelFit] | None = None,
) -> GapFits:
    """The gap on clips that were kept out of both fits; only their launches are fitted.

    Parameters
    ----------
    clips : sequence of Measured
        Kept out.
    base, best : Fit
        Of the other clips, before and after the search; their shared parameters stay as they are.
    noise : Noise
    progress : callable
        Told of progress.
    outside : callable, optional
        Makes the fit of these clips after the search from that before, where no model can hold what was found.

    Returns
    -------
    GapFits
        A best model that has no motion for one of the clips closes nothing.
    """
    before = fit_model(clips, base.model, (), noise, progress=progress)
    try:
        if outside:
            after = outside(before)
        else:
            after = (
                before
                if best.model == base.model
                else fit_model(clips, best.model, (), noise, before.launches, progress)
            )
    except ValueError:  # no motion
        after = before
    rows = [_squares(c, one, two, a, noise) for c, one, two, a in _by_clip(clips, before, after)]
    squares = np.concatenate(rows)
    phase = np.concatenate([c.phases() for c in clips])
    whole = _part(squares)
    by_phase = {name: _part(squares[phase == k]) for k, name in enumerate(PHASES) if np.any(phase == k)}
    return GapFits(Gap(**vars(whole), closure=_closure(whole, before.points), by_phase=by_phase), before, after)


def _closure(whole: GapPhase, points: int) -> float:
    """The share of the gap that is closed; NaN of one that chance may make."""
    room = whole.before - whole.floor
    least = current_policy().min_gap_sigma * float(np.sqrt(2 / points))
    return (whole.before - whole.after) / room if room > least else float("nan")


def _by_clip(
    clips: Sequence[MeasuredCollision], before: ModelFit, after: ModelFit
) -> Sequence[tuple[MeasuredCollision, Array, Array, Array]]:
    return list(zip(clips, before.residuals, after.residuals, before.launch_slopes, strict=True))


def _squares(clip: MeasuredCollision, before: Array, after: Array, launch: Array, noise: Noise) -> Array:
    """Of each row: white residual^2 before, after and as noise alone leaves it; the same in m^2: (n, 6), axes' means.

    What noise leaves: its covariance less the part that the six numbers of the launch take.
    """
    white, q = ClipWhitener.of(clip, noise), orthonormal_basis(launch)
    left = np.eye(len(q)) - q @ q.T
    chi2 = (before**2, after**2, np.diag(left))
    metres = (white.undo(before) ** 2, white.undo(after) ** 2, (white.undo(left) ** 2).sum(axis=2))
    return np.stack([np.mean(np.reshape(x, (-1, 2)), axis=1) for x in (*chi2, *metres)], axis=1)


def _part(squares: Array) -> GapPhase:
    means = squares.mean(axis=0)
    return GapPhase(*means[:3].tolist(), *(1e6 * np.sqrt(means[3:])).tolist())


def as_dict(gap: Gap) -> dict[str, Any]:
    return dataclasses.asdict(gap)
