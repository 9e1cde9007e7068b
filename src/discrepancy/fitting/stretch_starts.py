"""Chooses the start of each free stretch: a slide of any length, by how well the stretch is then fitted.

chi^2 of a stretch has a minimum for each way in which slide and roll may share it. So the fit begins from several.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, SLIP, T_C, V0, X, Y
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.fitting.gauss_newton import STEP_ERRORS, fit_model, minimise_chi2
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.policy import current_policy
from synthcam.model import Model
from synthcam_shared.arrays import Array

SLIDES = (0.2, 0.5, 0.9)  # shares of a stretch for which its ball may slide
LEAST_SHARE = 0.01  # a descent of launches ends where a step gains less than this share of chi^2 of poor stretches


def choose_starts(
    clips: Sequence[MeasuredCollision], model: Model, slides: Sequence[float] = SLIDES, most_chi2: float = 50.0
) -> tuple[list[MeasuredCollision], list[SearchNote]]:
    """Choose the start of each stretch, with the friction of the model; leave out those that do not move freely.

    The values of the model may be wrong. So friction and rolling loss are fitted before a stretch is left out. It stays
    if a friction and a loss of its own describe it.

    slides: see `SLIDES`. most_chi2: times the median, of a stretch that is used;
    it is large, since those that show a missing effect best must stay.
    Returns the stretches, and for each clip a note on those that are left out. Bodies glide if the model has no
    friction.
    """
    best, names = _fit_from_each(clips, model, slides), ("sliding_friction", "rolling_decel", "rolling_drag")
    losses = [name for name in names if getattr(model, name)][:2]
    if not best:
        return list(clips), []
    limit = most_chi2 * float(np.median([chi2 for chi2, _ in best]))
    if any(chi2 > limit for chi2, _ in best):
        with suppress(*STEP_ERRORS):
            fit = fit_model([clip for chi2, clip in best if chi2 <= limit], model, losses, Noise(NoiseComponent(1.0)))
            best = _fit_from_each(clips, fit.model, slides) or best
    limit = most_chi2 * float(np.median([chi2 for chi2, _ in best]))
    for k, (chi2, clip) in enumerate(best):
        if chi2 > limit:
            best[k] = min([(chi2, clip), *_fit_from_each([clips[k]], model, slides, losses)], key=lambda pair: pair[0])
    kept = [clip for chi2, clip in best if chi2 <= limit]
    notes = []
    for number in dict.fromkeys(clip.clip for chi2, clip in best if chi2 > limit):
        own = [(chi2, int(clip.frame[0])) for chi2, clip in best if clip.clip == number]
        out = [(chi2, first) for chi2, first in own if chi2 > limit]
        values = {"count": len(out), "total": len(own), "ratio": most_chi2 * max(out)[0] / limit}
        notes.append(SearchNote(SearchNoteKind.NO_FREE_MOTION, number, tuple(sorted(f for _, f in out)), values))
    return kept, notes


def fit_launches(
    clips: Sequence[MeasuredCollision], model: Model, noise: Noise, launches: Array | None = None
) -> ModelFit:
    """Fit the launches alone, by a model whose values stay; poor stretches from several starts.

    launches: start of the fit, as in `fit_model`. Raises ValueError where the model has no motion for one of them.
    """
    whitened = WhitenedClips.of(clips, noise)
    start = np.array([c.launch for c in clips] if launches is None else launches, dtype=float)
    share = LEAST_SHARE if any(clip.is_stretch for clip in clips) else 0.0
    fit = minimise_chi2(whitened, linearise(whitened, model, (), start), least_share=share)
    return leave_local_minima(whitened, fit)


def leave_local_minima(whitened: WhitenedClips, fit: ModelFit, max_rounds: int = 2) -> ModelFit:
    """Fit again from better starts of the stretches that are fitted poorly, until none is better.

    `choose_starts` looks for the start of a stretch beside the given model. If that lacks much, a slide may begin where
    a ball rolls. The fit then stays at a local minimum, also with the effect that was missing, and the effect seems to
    explain little. Whole collisions, and bodies that never slide, have no such minima.

    A stretch counts as poor above `SearchPolicy.poor_chi2_per_point`, and above as many times the median of all. If all
    are poor, the noise or the shared parameters are at fault.
    """
    for _ in range(max_rounds):
        launches = _find_better_launches(whitened, fit)
        if launches is None:
            break
        share = 0.0 if fit.names else LEAST_SHARE
        fit = minimise_chi2(whitened, linearise(whitened, fit.model, fit.names, launches), least_share=share)
    return fit


def _find_better_launches(whitened: WhitenedClips, fit: ModelFit, least: float = 2.0) -> Array | None:
    """Find launches of poor stretches that lower chi^2 by more than `least`, by the shared values of a fit."""
    clips = whitened.clips
    chi2 = np.array([r @ r / len(r) for r in fit.residuals])
    most = current_policy().poor_chi2_per_point * max(float(np.median(chi2)), 1.0)
    poor = [k for k in np.flatnonzero(chi2 > most).tolist() if clips[k].is_stretch]
    if not (poor and fit.model.sliding_friction):
        return None
    some = WhitenedClips(tuple(clips[k] for k in poor), tuple(whitened.whiteners[k] for k in poor))
    push = fit.model.sliding_friction * fit.model.gravity
    tries = [np.array([_slide(clips[k], fit.launches[k], share, push) for k in poor]) for share in (0.0, *SLIDES)]
    best = {k: float(fit.residuals[k] @ fit.residuals[k]) - least for k in poor}
    launches = fit.launches.copy()
    for start in [np.array([clips[k].launch for k in poor]), *tries]:
        with suppress(*STEP_ERRORS):  # no motion from one of these starts
            found = minimise_chi2(some, linearise(some, fit.model, (), start), rough=True, least_share=LEAST_SHARE)
            for k, r, own in zip(poor, found.residuals, found.launches, strict=True):
                if r @ r < best[k]:
                    best[k], launches[k] = float(r @ r), own
    return launches if np.any(launches != fit.launches) else None


def _fit_from_each(
    clips: Sequence[MeasuredCollision], model: Model, slides: Sequence[float], names: Sequence[str] = ()
) -> list[tuple[float, MeasuredCollision]]:
    """The least chi^2 of each stretch, and the stretch with that start; empty if no start has a motion."""
    tries = [[replace(clip, launch=_glide(clip)) for clip in clips]]
    if model.sliding_friction:
        push = model.sliding_friction * model.gravity
        tries = [
            list(clips),
            *([replace(c, launch=_slide(c, c.launch, share, push)) for c in clips] for share in slides),
        ]
    found = []
    for some in tries:
        with suppress(*STEP_ERRORS):  # no motion from one of these starts
            fit = fit_model(some, model, names, Noise(NoiseComponent(1.0)))
            chi2 = [float(r @ r) / len(r) for r in fit.residuals]
            found.append([(c, replace(s, launch=own)) for c, s, own in zip(chi2, some, fit.launches, strict=True)])
    return [min(each, key=lambda pair: pair[0]) for each in zip(*found, strict=True)]


def _slide(clip: MeasuredCollision, launch: Array, share: float, push: float) -> Array:
    """The launch of a ball that slides for a share of its stretch; push: the deceleration by sliding, m/s^2."""
    launch, lasts = launch.copy(), share * float(np.ptp(clip.frame)) / clip.fps
    slip_per_loss = 3.5  # a solid ball's slip ends at 7/2 of the deceleration of its centre
    slip = launch[SLIP]
    size = float(np.hypot(*slip))
    launch[SLIP] = slip_per_loss * push * lasts * (slip / size if size else np.array([-1.0, 0.0]))
    return np.asarray(launch)


def _glide(clip: MeasuredCollision) -> Array:
    """The launch of a body that never slides, from a parabola through its positions."""
    launch, times = clip.launch.copy(), clip.frame / clip.fps + clip.exposure / 2 - clip.launch[T_C]
    _, velocity, place = np.polyfit(times, clip.xy, 2)
    launch[[X, Y]] = place
    launch[V0], launch[HEADING] = np.hypot(*velocity), np.arctan2(velocity[1], velocity[0])
    launch[SLIP] = 0.0
    return np.asarray(launch)
