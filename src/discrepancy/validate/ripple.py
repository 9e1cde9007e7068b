"""Do residuals ripple with a ball's turns? Then it is out of round, or loaded, or a mark on it is followed for it.

A ball that rolls turns once in a way of pi times its diameter. How it lay at the start is unknown: so each stretch of
rolling, before the contact and after the slide, has a phase of its own. Cubics of time are free beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from discrepancy.arrays import Array, Ints
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.validate.stages import BEFORE, ROLLING, directions, stages
from discrepancy.validate.trial import ClipAmplitudes, ClipSolution, results

SAID = {"once a turn": "once a turn", "twice a turn": "twice a turn"}
TIMES = dict(zip(SAID, (1, 2), strict=True))  # a turn
LEAST = 1.0  # periods in a stretch: less is a bend of it
ORDER = 3  # of the polynomials of time that are free beside the ripple in each stretch: they are no ripple

Where = tuple[str, int, int]  # which ripple, ball, axis


def ripples(
    clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise
) -> Iterator[tuple[Where, str, float, int, float]]:
    """Each trial, as of `residual_map.trials`.

    Parameters
    ----------
    clips : sequence of Measured
    fit : Fit
        Of these clips.
    noise : Noise

    Yields
    ------
    tuple
        (ripple, ball, axis), "", chi^2, degrees of freedom, size in um.
    """
    found: dict[Where, list[ClipAmplitudes]] = {}
    expected = predict_tracks(fit.model, fit.launches, clips)
    size = np.sqrt(sum((s**2).sum(axis=0) for s in fit.slopes))
    unit = 1 / np.where(size > 0, size, 1)
    for k, clip in enumerate(clips):
        white = ClipWhitener.of(clip, noise)
        for name, times in TIMES.items():
            terms, raw = _terms(clip, expected[k], times)
            if not terms:
                continue
            solved = ClipSolution.of(fit.launch_slopes[k], white(raw), fit.residuals[k], fit.slopes[k] * unit)
            for which in sorted({term for term in terms if term}):
                mine = [i for i, term in enumerate(terms) if term == which and solved.kept[i]]
                if mine:
                    found.setdefault((name, *which), []).append(
                        _part(solved, mine, raw[..., mine], clip.xy - expected[k])
                    )
    for where, parts in found.items():
        for result in results(parts):  # none where the shared parameters can make them all
            yield where, *result


def _part(solved: ClipSolution, mine: list[int], columns: Array, residual: Array) -> ClipAmplitudes:
    pulls, per_metre, shared = solved.group(mine)
    squares = np.einsum("nai,naj->ij", columns, columns)
    rows = (columns != 0).any(axis=(1, 2))
    left = float((residual[rows] ** 2).sum())
    return ClipAmplitudes(pulls, per_metre, shared, solved.information, solved.pull, squares, int(rows.sum()), left, {})


def _terms(clip: MeasuredCollision, path: Array, times: int) -> tuple[list[tuple[int, int] | None], Array]:
    """Ball and axis of each term, None of a stretch's polynomials; displacements by a metre of it, (n, 2, terms)."""
    stage, _ = stages(clip)
    motion = directions(clip, stage, path)
    smooth: list[Array] = []
    waves: dict[tuple[int, int], list[Array]] = {}
    for ball in range(2):
        for s in (BEFORE, ROLLING):
            rows = np.flatnonzero((stage == s) & (clip.ball == ball))
            angle = times * _turned(clip, rows, path)
            if len(rows) == 0 or angle[-1] < LEAST * 2 * np.pi:
                continue
            columns = np.column_stack(
                [np.vander(np.linspace(-1, 1, len(rows)), ORDER + 1), np.cos(angle), np.sin(angle)]
            )
            for axis in range(2):
                along = np.zeros((len(stage), 2, columns.shape[1]))
                along[rows] = motion[rows, axis, :, None] * columns[:, None]
                smooth += list(np.moveaxis(along[..., :-2], -1, 0))
                waves.setdefault((ball, axis), []).extend(np.moveaxis(along[..., -2:], -1, 0))
    terms = [None] * len(smooth) + [which for which, each in waves.items() for _ in each]
    every = [*smooth, *(column for each in waves.values() for column in each)]
    return terms, np.stack(every, axis=-1) if every else np.zeros((len(stage), 2, 0))


def _turned(clip: MeasuredCollision, rows: Ints, path: Array) -> Array:
    """By how much a ball has turned since the first of these rows, rad."""
    way = np.hypot(*np.diff(path[rows], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(way)]) / (clip.camera.ball_diameter / 2)
