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
from discrepancy.fitting.gauss_newton import STEP_ERRORS, fit_model
from discrepancy.noise.model import Noise, NoiseComponent
from synthcam.model import Model
from synthcam_shared.arrays import Array

LOSSES = ("sliding_friction", "rolling_decel", "rolling_drag")  # the first two that a model has are fitted


def choose_starts(
    clips: Sequence[MeasuredCollision], model: Model, slides: Sequence[float] = (0.2, 0.5, 0.9), most_chi2: float = 50.0
) -> tuple[list[MeasuredCollision], list[SearchNote]]:
    """Choose the start of each stretch, with the friction of the model; leave out those that do not move freely.

    The values of the model may be wrong. So friction and rolling loss are fitted before a stretch is left out. It stays
    if a friction and a loss of its own describe it.

    slides: shares of a stretch for which its ball may slide. most_chi2: times the median, of a stretch that is used;
    it is large, since those that show a missing effect best must stay.
    Returns the stretches, and for each clip a note on those that are left out. Bodies glide if the model has no
    friction.
    """
    best, losses = _fit_from_each(clips, model, slides), [name for name in LOSSES if getattr(model, name)][:2]
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


def _fit_from_each(
    clips: Sequence[MeasuredCollision], model: Model, slides: Sequence[float], names: Sequence[str] = ()
) -> list[tuple[float, MeasuredCollision]]:
    """The least chi^2 of each stretch, and the stretch with that start; empty if no start has a motion."""
    tries = [[replace(clip, launch=_glide(clip)) for clip in clips]]
    if model.sliding_friction:
        push = model.sliding_friction * model.gravity
        tries = [list(clips), *([replace(c, launch=_slide(c, share, push)) for c in clips] for share in slides)]
    found = []
    for some in tries:
        with suppress(*STEP_ERRORS):  # no motion from one of these starts
            fit = fit_model(some, model, names, Noise(NoiseComponent(1.0)))
            chi2 = [float(r @ r) / len(r) for r in fit.residuals]
            found.append([(c, replace(s, launch=own)) for c, s, own in zip(chi2, some, fit.launches, strict=True)])
    return [min(each, key=lambda pair: pair[0]) for each in zip(*found, strict=True)]


def _slide(clip: MeasuredCollision, share: float, push: float) -> Array:
    """The launch of a ball that slides for a share of its stretch; push: the deceleration by sliding, m/s^2."""
    launch, lasts = clip.launch.copy(), share * float(np.ptp(clip.frame)) / clip.fps
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
