"""Derivatives of the predicted tracks by shared parameters and by launches, and with them a fit to first order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import MAX_SPIN_TO_SPEED, V0, WITH_SPIN, find_free_launch_columns
from discrepancy.fitting.model_fit import Linearisation, ModelFit, WhitenedClips
from discrepancy.fitting.parameters import difference_step, find_parameter, find_tried_range, parameter_limits
from discrepancy.fitting.predict import predict_tracks
from synthcam.dynamics.batch import LAUNCH_COLUMNS, VARIABLE_BASE_PARAMETERS, may_vary_base
from synthcam.model import Model, without_mutual_push
from synthcam_shared.arrays import Array

LAUNCH_STEP = 1e-6  # m, s, m/s, rad, 1


def differentiate_tracks(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], name: str, here: Sequence[Array] | None = None
) -> list[Array]:
    """Differentiate the predicted tracks by a shared parameter: (n, 2) of each clip, m over the parameter's unit.

    The difference is central. It is one-sided if the parameter is at a limit, or if the model has no motion on the
    other side. For example, a tilt may set the resting ball rolling. It is zero if no motion exists on either side.

    here: the predicted tracks, if known; a short forward difference from them is then taken where possible.
    """
    value, step, (low, high) = model.value(name), difference_step(model, name), parameter_limits(model, name)
    short, ends = 0.1 * step, []
    if here is not None and value + short <= high:
        with suppress(ValueError):
            ahead = predict_tracks(model.replace({name: value + short}), launches, clips)
            return [(a - b) / short for a, b in zip(ahead, here, strict=True)]
    for end in (min(value + step, high), max(value - step, low)):
        try:
            ends.append((end, predict_tracks(model.replace({name: end}), launches, clips)))
        except ValueError:
            ends.append((value, predict_tracks(model, launches, clips)))
    (up, ahead), (down, behind) = ends
    return [(a - b) / (up - down) if up > down else 0 * a for a, b in zip(ahead, behind, strict=True)]


def differentiate_all(
    model: Model,
    launches: Array,
    clips: Sequence[MeasuredCollision],
    names: Sequence[str],
    here: Sequence[Array],
    exact: bool = False,
) -> list[list[Array]]:
    """Differentiate the predicted tracks by each of several parameters; the result is by name, then by clip.

    The motion of balls that push each other takes about eight times as long to compute. Other parameters act on it
    nearly as they do without the push. Their derivatives are therefore taken without it, if that motion exists, unless
    `exact` is set. here: the predicted tracks.
    """
    plain, there = (model, here) if exact else drop_mutual_push(model, launches, clips, here)
    pushing = coupling_effects(model, plain)
    return [
        differentiate_tracks(model, launches, clips, name, here)
        if name.partition(".")[0] in pushing
        else differentiate_tracks(plain, launches, clips, name, there)
        for name in names
    ]


def drop_mutual_push(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], here: Sequence[Array] | None = None
) -> tuple[Model, Sequence[Array]]:
    """Choose the model to differentiate: without the push between balls, which is faster; and its predicted tracks.

    It returns the model itself if it has no such push, or if a ball would not have rested without it. here: the model's
    own predicted tracks, if known.
    """
    plain = without_mutual_push(model)
    if plain.effects != model.effects:
        with suppress(ValueError):
            return plain, predict_tracks(plain, launches, clips)
    return model, predict_tracks(model, launches, clips) if here is None else here


def coupling_effects(model: Model, plain: Model) -> set[str]:
    """Name the effects that couple the derivatives of both balls by a push; plain: the model without them."""
    return {e.name() for e in model.effects} - {e.name() for e in plain.effects}


def differentiate_launches(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], batch: int = 64
) -> tuple[list[Array], list[Array]]:
    """Predict tracks (n, 2), m, and differentiate them by each clip's own launch, (n, 2, p).

    The difference is taken to one side if a motion exists only there, as at the limit of a ball's rest. A derivative is
    zero where neither side has one, and for columns of the launch that are not free. batch: clips to predict together,
    to limit memory.
    """
    here: list[Array] = []
    slopes: list[Array] = []
    for first in range(0, len(clips), batch):
        some, places = clips[first : first + batch], launches[first : first + batch]
        try:
            parts = [_difference_launches(model, places, some)[:2]]
        except ValueError:
            parts = [_difference_one_sided(model, place, clip) for place, clip in zip(places, some, strict=True)]
        here += [h for part, _ in parts for h in part]
        slopes += [s for _, part in parts for s in part]
    return here, slopes


def differentiate_launches_and_base(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], names: Sequence[str], batch: int = 32
) -> tuple[list[Array], list[Array], dict[str, list[Array]]]:
    """Predict tracks and differentiate them by launches, as `differentiate_launches`, and by base parameters.

    The third result has those base parameters among `names` that can be differentiated at once: prediction of a few
    clips costs little more than of one. They are forward differences, as those of `differentiate_tracks`.
    """
    steps = {n: 0.1 * difference_step(model, n) for n in names if n in VARIABLE_BASE_PARAMETERS}
    steps = {n: s for n, s in steps.items() if model.value(n) + s <= parameter_limits(model, n)[1]}
    if not steps or not may_vary_base(model):
        return *differentiate_launches(model, launches, clips), {}
    here, slopes, shared = list[Array](), list[Array](), {n: list[Array]() for n in steps}
    with suppress(ValueError):
        for first in range(0, len(clips), batch):
            own = slice(first, first + batch)
            expected, by_launch, by_base = _difference_launches(model, launches[own], clips[own], steps)
            here += expected
            slopes += by_launch
            for n, columns in zip(steps, by_base, strict=True):
                shared[n] += columns
        return here, slopes, shared
    return *differentiate_launches(model, launches, clips), {}


def _difference_launches(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], base_steps: Mapping[str, float] | None = None
) -> tuple[list[Array], list[Array], list[list[Array]]]:
    """Tracks, their derivatives by the launches, and by base parameters with these steps, by name and clip."""
    steps = base_steps or {}
    (k, size), (clip, column) = launches.shape, np.nonzero(find_free_launch_columns(launches))
    nudged = launches[clip]
    nudged[np.arange(len(clip)), column] += LAUNCH_STEP
    nudges = k + len(clip)
    base = {n: np.full(nudges + k * len(steps), model.value(n)) for n in steps}
    for turn, (n, step) in enumerate(steps.items()):
        base[n][nudges + k * turn :][:k] += step
    rows = np.concatenate([launches, nudged, *[launches] * len(steps)])
    some = [*clips, *(clips[i] for i in clip.tolist()), *[c for _ in steps for c in clips]]
    every = predict_tracks(model, rows, some, base)
    here, slopes = every[:k], [np.zeros((*xy.shape, size)) for xy in every[:k]]
    for i, j, there in zip(clip.tolist(), column.tolist(), every[k:nudges], strict=True):
        slopes[i][..., j] = (there - here[i]) / LAUNCH_STEP
    shared = [
        [(a - b) / step for a, b in zip(every[nudges + k * turn :][:k], here, strict=True)]
        for turn, step in enumerate(steps.values())
    ]
    return here, slopes, shared


def _difference_one_sided(model: Model, launch: Array, clip: MeasuredCollision) -> tuple[list[Array], list[Array]]:
    """The same for one clip: all columns at once, or if that fails each to the side that has a motion."""
    with suppress(ValueError):
        return _difference_launches(model, launch[None], [clip])[:2]
    (here,) = predict_tracks(model, launch[None], [clip])
    slopes = np.zeros((*here.shape, len(launch)))
    for j in np.flatnonzero(find_free_launch_columns(launch[None])[0]).tolist():
        for step in (LAUNCH_STEP, -LAUNCH_STEP):
            with suppress(ValueError):
                (there,) = predict_tracks(model, (launch + step * np.eye(len(launch))[j])[None], [clip])
                slopes[..., j] = (there - here) / step
                break
    return [here], [slopes]


def linearise(
    whitened: WhitenedClips, model: Model, names: tuple[str, ...], launches: Array, exact: bool = False
) -> ModelFit:
    """Compute the residuals of a model and their derivatives, at given values and launches, without a fit.

    exact: count the push between balls in all derivatives; see `jacobian.differentiate_all`.
    Raises ValueError where the model has no motion for a launch.
    """
    expected, own, known = differentiate_launches_and_base(model, launches, whitened.clips, names)
    others = [n for n in names if n not in known]
    known |= zip(others, differentiate_all(model, launches, whitened.clips, others, expected, exact), strict=True)
    shared = [known[n] for n in names]
    residuals = whitened.whiten([c.xy - e for c, e in zip(whitened.clips, expected, strict=True)])
    if names:
        slopes = whitened.whiten([np.stack([s[k] for s in shared], axis=-1) for k in range(len(expected))])
        slopes = zero_unidentifiable_shapes(model, names, slopes)
    else:
        slopes = tuple(np.zeros((len(r), 0)) for r in residuals)
    own_slopes = _zero_unidentifiable_spins(launches, whitened.whiten(own))
    return ModelFit(model, names, launches, residuals, Linearisation(model, names, launches, slopes, own_slopes))


def zero_unidentifiable_shapes(model: Model, names: Sequence[str], slopes: tuple[Array, ...]) -> tuple[Array, ...]:
    """Set to zero the derivatives (2n, S) of a linearised fit by shape parameters that are not identifiable.

    Such a parameter moves the tracks by less than one sigma over its whole range. Without derivatives no step carries
    it away; a dropped frame, for example, may be anywhere between two frames.
    """
    shapes = [find_parameter(model, n) if "." in n else None for n in names]
    spans = np.array(
        [
            find_tried_range(p) * (model.value(n) if p.low > 0 else 1.0) if p and p.fixed else np.inf
            for n, p in zip(names, shapes, strict=True)
        ]
    )
    silent = np.sqrt(sum((s**2).sum(axis=0) for s in slopes)) < 1 / spans
    return tuple(np.where(silent, 0.0, s) for s in slopes) if silent.any() else slopes


def _zero_unidentifiable_spins(launches: Array, slopes: tuple[Array, ...]) -> tuple[Array, ...]:
    """Set to zero the derivatives by spins that move no track by a sigma: without friction they are rounding errors."""
    if launches.shape[1] != WITH_SPIN:
        return slopes
    sizes = np.array([np.linalg.norm(s[:, len(LAUNCH_COLUMNS) :], axis=0) for s in slopes])
    silent = np.pad(sizes * MAX_SPIN_TO_SPEED * launches[:, [V0]] < 1, ((0, 0), (len(LAUNCH_COLUMNS), 0)))
    return tuple(np.where(none, 0.0, s) for none, s in zip(silent, slopes, strict=True)) if silent.any() else slopes
