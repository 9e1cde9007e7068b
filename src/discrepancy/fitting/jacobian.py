"""Derivatives of the forecast by shared parameters and by the launches, by finite differences."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import find_free_columns
from discrepancy.fitting.parameters import FINE, difference_step, parameter_limits
from discrepancy.fitting.predict import predict_tracks
from synthcam.dynamics.solve import without_mutual_push
from synthcam.model import Model

LAUNCH_STEP = 1e-6  # m, s, m/s, rad, 1
AT_ONCE = 64  # clips whose launches are nudged in one batch


def differentiate(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], name: str, here: Sequence[Array] | None = None
) -> list[Array]:
    """The derivative of the forecast by a shared parameter.

    A central difference, or a one-sided one at a limit of the parameter or where there is no motion on the other side,
    as when a tilt would set the resting ball rolling; zero where there is none on either side.

    Parameters
    ----------
    model : Model
    launches : (clips, p) array
        Columns as in `discrepancy.data.launch`.
    clips : sequence of Measured
    name : str
        Of the parameter, dotted.
    here : sequence of (n, 2) array, optional
        The forecast, where it is known: a short forward difference from it is then taken where there is a motion.

    Returns
    -------
    list of (n, 2) array
        Of each clip, m over the parameter's unit.
    """
    value, step, (low, high) = model.value(name), difference_step(model, name), parameter_limits(model, name)
    ends = []
    if here is not None and value + FINE * step <= high:
        try:
            ahead = predict_tracks(model.replace({name: value + FINE * step}), launches, clips)
            return [(a - b) / (FINE * step) for a, b in zip(ahead, here, strict=True)]
        except ValueError:
            pass
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
    """`differentiate` by each of several parameters.

    Where balls push each other the motion takes some eight times as long to compute, and other parameters act on it
    nearly as they do without the push. Their derivatives are then taken without it, where there is such a motion.

    Parameters
    ----------
    model, launches, clips
        As of `differentiate`.
    names : sequence of str
    here : sequence of (n, 2) array
        The forecast.
    exact : bool
        Take all derivatives with the push.

    Returns
    -------
    list of list of (n, 2) array
        By name, then by clip.
    """
    plain, there = (model, here) if exact else decouple(model, launches, clips, here)
    pushing = coupling_effects(model, plain)
    return [
        differentiate(model, launches, clips, name, here)
        if name.partition(".")[0] in pushing
        else differentiate(plain, launches, clips, name, there)
        for name in names
    ]


def decouple(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], here: Sequence[Array] | None = None
) -> tuple[Model, Sequence[Array]]:
    """The model without the push between balls, whose motion is computed sooner, and its forecast.

    The model itself where it has no such push, or where a ball would not have rested without it. `here` is the model's
    own forecast, where it is known.
    """
    plain = without_mutual_push(model)
    if plain.effects != model.effects:
        with suppress(ValueError):
            return plain, predict_tracks(plain, launches, clips)
    return model, predict_tracks(model, launches, clips) if here is None else here


def coupling_effects(model: Model, plain: Model) -> set[str]:
    """The names of the effects by which balls push each other; plain: the model without them."""
    return {e.name() for e in model.effects} - {e.name() for e in plain.effects}


def differentiate_launches(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision]
) -> tuple[list[Array], list[Array]]:
    """The forecast, and its derivatives by each clip's own launch, many clips in one batch.

    At the edge of where a ball can rest, differences are taken to the side that has a motion; zero where neither has.

    Parameters
    ----------
    model, launches, clips
        As of `differentiate`.

    Returns
    -------
    here : list of (n, 2) array
        Of each clip, m.
    slopes : list of (n, 2, p) array
        By the columns of `discrepancy.data.launch`; zero for those that are not free.
    """
    here: list[Array] = []
    slopes: list[Array] = []
    for first in range(0, len(clips), AT_ONCE):
        some, places = clips[first : first + AT_ONCE], launches[first : first + AT_ONCE]
        try:
            parts = [_difference_launches(model, places, some)]
        except ValueError:
            parts = [_difference_one_sided(model, place, clip) for place, clip in zip(places, some, strict=True)]
        here += [h for part, _ in parts for h in part]
        slopes += [s for _, part in parts for s in part]
    return here, slopes


def _difference_launches(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision]
) -> tuple[list[Array], list[Array]]:
    (k, size), own = launches.shape, find_free_columns(launches)
    nudges = LAUNCH_STEP * np.concatenate([np.zeros((1, size)), np.eye(size)])[:, None] * own
    every = predict_tracks(model, (launches[None] + nudges).reshape(-1, size), list(clips) * len(nudges))
    slopes = [
        np.stack([(every[(1 + j) * k + i] - every[i]) / LAUNCH_STEP for j in range(size)], axis=-1) for i in range(k)
    ]  # unmoved launches differ too, by rounding: the steps of their integration are of all that are solved together
    return every[:k], [s * free_here for s, free_here in zip(slopes, own, strict=True)]


def _difference_one_sided(model: Model, launch: Array, clip: MeasuredCollision) -> tuple[list[Array], list[Array]]:
    (here,) = predict_tracks(model, launch[None], [clip])
    slopes = np.zeros((*here.shape, len(launch)))
    own = np.flatnonzero(find_free_columns(launch[None])[0]).tolist()
    for j, step in itertools.product(own, (-LAUNCH_STEP, LAUNCH_STEP)):  # the later counts
        with suppress(ValueError):
            (there,) = predict_tracks(model, (launch + step * np.eye(len(launch))[j])[None], [clip])
            slopes[..., j] = (there - here) / step
    return [here], [slopes]
