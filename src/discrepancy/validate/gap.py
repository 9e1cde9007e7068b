"""The gap between model and held-out collisions, with the base model and with all claims."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit, orthonormal_basis
from discrepancy.fitting.stretch_starts import fit_launches
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class GapPhase:
    """The gap in a phase of the held-out clips: chi^2 per point, and rms in um."""

    # the gap with the base model, and with all claims
    before: float
    after: float
    floor: float  # the gap that noise alone makes
    # the same as rms of the residuals of each axis, um
    before_um: float
    after_um: float
    floor_um: float


@dataclass(frozen=True)
class Gap(GapPhase):
    """The gap in all phases together."""

    closure: float  # the share of the gap between before and floor that is closed; NaN if that gap is within chance
    by_phase: dict[str, GapPhase]  # the gap in the phases before, sliding and rolling
    outliers: int = 0  # clips that count less, because neither model predicts them


@dataclass(frozen=True)
class GapFits:
    """The gap with the two fits of the held-out clips that it compares."""

    gap: Gap
    before: ModelFit
    after: ModelFit


def measure_gap(
    clips: Sequence[MeasuredCollision],
    base: ModelFit,
    best: ModelFit,
    noise: Noise,
    fit_law: Callable[[ModelFit], ModelFit] | None = None,
) -> GapFits:
    """Measure the gap on clips that were held out of both fits; only their launches are fitted.

    The gap, chi^2 per point, is the mean squared whitened residual, as in posterior predictive checks (Gelman, Meng &
    Stern, Statistica Sinica 6 (1996) 733). Noise alone makes it less than one, because each launch absorbs some noise.

    base, best: the fits of the other clips, without and with all claims. Their shared parameters are fixed. fit_law
    makes the second fit of these clips from the first, if no model can hold the free law. If the best model has no
    motion for one of the clips, it closes nothing. Clips that neither model predicts count less (`weigh_clips`).
    """
    before = fit_launches(clips, base.model, noise)
    try:
        if fit_law:
            after = fit_law(before)
        elif best.model == base.model:
            after = before
        else:
            after = fit_launches(clips, best.model, noise, before.launches)
    except ValueError:  # no motion
        after = before
    every = zip(clips, before.residuals, after.residuals, before.launch_slopes, strict=True)
    squares = np.concatenate([_mean_squares(*each, noise) for each in every])
    phase = np.concatenate([c.phases() for c in clips])
    by_clip = weigh_clips(before.residuals, after.residuals)
    weights = np.repeat(by_clip, [len(c.frame) for c in clips])

    def average(rows: Array) -> GapPhase:
        means = np.average(squares[rows], axis=0, weights=weights[rows])
        return GapPhase(*means[:3].tolist(), *(1e6 * np.sqrt(means[3:])).tolist())

    whole = average(phase == phase)
    names = ("before", "sliding", "rolling")
    by_phase = {name: average(phase == k) for k, name in enumerate(names) if np.any(phase == k)}
    closure, outliers = closed_share(whole, before.points), int(np.sum(by_clip < 1))
    return GapFits(Gap(**vars(whole), closure=closure, by_phase=by_phase, outliers=outliers), before, after)


def weigh_clips(without: Sequence[Array], with_: Sequence[Array], freedom: float = 4.0, in_full: float = 0.5) -> Array:
    """Weigh each clip as in a fit of Student's t to whole clips: one that no model predicts must not decide alone.

    A clip of p points with a scaled chi^2 of D has the weight (freedom + p) / (freedom + D): Lange, Little & Taylor,
    J. Am. Stat. Assoc. 84 (1989) 881, who propose 4 degrees of freedom. A weight above `in_full` counts as one, so
    noise alone changes nothing. D is that of the model that predicts the clip better, so a claim that spoils a clip
    pays in full. The scale is the chi^2 per point of the worst clip but one in ten, so no more count less. If
    more stand out, the model lacks something.

    without, with_: whitened residuals of each clip, by two models.
    """
    points = np.array([len(r) for r in without])
    chi2 = np.array([min(float(p @ p), float(q @ q)) for p, q in zip(without, with_, strict=True)])
    most = max(len(points) // current_policy().outlier_clips_one_in, 1)
    scale = max(float(np.sort(chi2 / points)[-min(most + 1, len(points))]), 1.0)
    weights = (freedom + points) / (freedom + chi2 / scale)
    return np.asarray(np.where(weights > in_full, 1.0, weights))


def closed_share(whole: GapPhase, points: int) -> float:
    """The share of the gap that is closed; NaN if chance alone makes such a gap."""
    room = whole.before - whole.floor
    least = current_policy().min_gap_sigma * float(np.sqrt(2 / points))
    return (whole.before - whole.after) / room if room > least else float("nan")


def _mean_squares(clip: MeasuredCollision, before: Array, after: Array, launch: Array, noise: Noise) -> Array:
    """Squared whitened residuals of each row before, after and from noise alone, then the same in m^2: (n, 6).

    Those from noise are its covariance less the part that the launch absorbs. Each is a mean over the axes. Those in
    m^2 are without the most likely scatter from stretch to stretch.
    """
    white, q = ClipWhitener.of(clip, noise), orthonormal_basis(launch)
    left = np.eye(len(q)) - q @ q.T
    chi2 = (before**2, after**2, np.diag(left))
    metres = (white.undo_noise(before) ** 2, white.undo_noise(after) ** 2, (white.undo_noise(left) ** 2).sum(axis=2))
    return np.stack([np.mean(np.reshape(x, (-1, 2)), axis=1) for x in (*chi2, *metres)], axis=1)
