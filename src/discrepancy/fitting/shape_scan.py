"""Differentiates tracks by an effect's strengths at many values of its shape parameters at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.parameters import Candidate, find_parameter
from discrepancy.fitting.predict import collect_measurement_context, predict_velocities
from discrepancy.fitting.response import ResponseSegment, compute_responses
from synthcam.effect import Effect
from synthcam.model import Model
from synthcam_shared.arrays import Array

Shapes = dict[str, float]
SizedEffects = Sequence[tuple[Effect, float]]  # each with the size of its only strength that is not zero

# laws whose small changes are integrals over the motion; a change of the load is one of friction, in proportion
MOTION_LAWS = {"friction": "friction", "normal_load": "friction", "rolling": "rolling", "push": "push"}
MIN_SCANNED_VALUES = 30  # of the shape parameters; fewer are tried one by one, exactly


def can_scan(candidate: Candidate, tries: Sequence[Shapes]) -> bool:
    """True if `scan_shapes` can serve a candidate: it has many values to try, and laws that a segment suffices for.

    Two values are enough for a tracker's defect, which needs no new motion.
    """
    known = {"position", "velocity", "speed", "slip", "slip_speed", "gravity", "radius"}
    laws = candidate.kind.laws if candidate.kind else {}
    if not laws or len(tries) < (2 if "measure" in laws else MIN_SCANNED_VALUES):
        return False
    if "measure" in laws or "clock" in laws:
        return len(laws) == 1 and laws.get("clock", ("fps",)) == ("fps",)
    return all(law in MOTION_LAWS and set(asks) <= known for law, asks in laws.items())


def scan_shapes(
    model: Model,
    launches: Array,
    clips: Sequence[MeasuredCollision],
    candidate: Candidate,
    tries: Sequence[Shapes],
    here: Sequence[Array],
) -> list[Array]:
    """Differentiate the tracks by a candidate's strengths, at many values of its shape parameters at once.

    Returns (n, 2, tries, strengths) for each clip, m over the strength's unit.
    model: without the candidate, for which `can_scan` holds.
    tries: values of its shape parameters by dotted name.
    here: the predicted tracks (n, 2) of the model, m.
    """
    batch = 64  # columns, for memory
    kind = candidate.kind
    assert kind is not None
    sizes = {_short(s): find_parameter(model, s).typical for s in candidate.strengths}
    nothing = dict.fromkeys(sizes, 0.0)
    sized = [
        (kind(**nothing | {_short(n): v for n, v in shapes.items()} | {s: size}), size)
        for shapes in tries
        for s, size in sizes.items()
    ]
    if "clock" in kind.laws:
        found = _delay_tracks(predict_velocities(model, launches, clips), clips, sized)
    elif "measure" in kind.laws:
        found = _misplace_tracks(here, clips, sized)
    else:
        parts = [sized[k : k + batch] for k in range(0, len(sized), batch)]
        every = [compute_responses(model, launches, clips, _changes(p, model), len(p)) for p in parts]
        found = [np.concatenate(own, axis=-1) for own in zip(*every, strict=True)]
    return [f.reshape(*f.shape[:2], len(tries), len(sizes)) for f in found]


def _short(name: str) -> str:
    return name.rpartition(".")[2]


def _changes(sized: SizedEffects, model: Model) -> dict[str, Callable[[ResponseSegment], Array]]:
    """Changes of friction, rolling loss and push by each of several effects of one kind, divided by its size."""
    laws = sized[0][0].laws

    def change(kind: str, segment: ResponseSegment) -> Array:
        return np.asarray(sum(_change(law, sized, model, segment) for law in laws if MOTION_LAWS[law] == kind))

    return {kind: partial(change, kind) for kind in dict.fromkeys(MOTION_LAWS[law] for law in laws)}


def _change(law: str, sized: SizedEffects, model: Model, segment: ResponseSegment) -> Array:
    instant: dict[str, Any] = {"position": segment.place, "gravity": model.gravity, "radius": model.ball.radius}
    instant |= {name: getattr(segment, name) for name in ("velocity", "speed", "slip", "slip_speed")}
    values: dict[str, Any] = {"friction": model.sliding_friction, "normal_load": model.gravity, "rolling": 0.0}
    value = values[law] if law in values else np.zeros_like(segment.velocity)
    asks = sized[0][0].laws[law]
    each = [(getattr(e, law)(value, *[instant[a] for a in asks]) - value) / size for e, size in sized]
    worth = model.sliding_friction / model.gravity if law == "normal_load" else 1.0
    return np.asarray(worth * np.stack(each, axis=-1))


def _delay_tracks(moving: Sequence[Array], clips: Sequence[MeasuredCollision], sized: SizedEffects) -> list[Array]:
    """Displacements (n_k, 2, columns) of each clip by an effect on the clock: velocity times delay."""
    out = []
    for v, clip in zip(moving, clips, strict=True):
        t = clip.frame / clip.fps
        late = [(e.clock(t, clip.fps) - t) / size for e, size in sized]  # type: ignore[attr-defined]
        out.append(v[..., None] * np.stack(late, axis=-1)[:, None])
    return out


def _misplace_tracks(here: Sequence[Array], clips: Sequence[MeasuredCollision], sized: SizedEffects) -> list[Array]:
    """Displacements (n_k, 2, columns) of each clip by a defect of the tracker, carried from pixels to the plate."""
    camera, places = clips[0].camera, np.concatenate(here)
    pixels = camera.project(np.concatenate([places, np.full((len(places), 1), camera.radius)], axis=1))
    slope, known = camera.unproject(pixels)[1], collect_measurement_context(camera)
    columns = []
    for effect, size in sized:
        seen = effect.measure(pixels, *[known[a] for a in effect.laws["measure"]])  # type: ignore[attr-defined]
        columns.append((slope @ ((seen - pixels) / size)[..., None])[..., 0])
    return np.split(np.stack(columns, axis=-1), np.cumsum([len(h) for h in here])[:-1])
