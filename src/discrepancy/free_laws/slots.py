"""Slots: laws left free. A series over the range that the data cover bends one law inside the forward model.

Each slot knows its derivative at any model: what one unit of each of its coefficients moves the tracks by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from discrepancy.data.collisions import Measured
from discrepancy.fitting.jacobian import derivative
from discrepancy.fitting.predict import forecast
from discrepancy.fitting.response import Leg, responses
from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free import ALONE, SLOTS, Slot, lagging
from synthcam.dynamics.batch import collisions
from synthcam.dynamics.kinematics import contact_velocity
from synthcam.model import Model

Array = NDArray[np.float64]
__all__ = ["SLOTS", "Slot", "columns", "lagging", "slots"]

CURVE, TURN, MAP, FIELD = 20, 9, 12, 8  # coefficients: of a curve, of one of angles, a side of a map, and of a field
EACH = 120  # clips: of more, no number of each is fitted
SLIPS = 1e-5  # m/s: a ball whose contact is slower rolls
SAMPLES = 300  # instants at which the base fit's motion is looked at for the ranges that it covers
OBLIQUE = 0.1  # of the impact parameter: a law of it is looked at up to there at least
MU, R, C = ((("sliding_friction", 0),), (("restitution", 0),), (("spin_transfer", 0),))
LOSS, DECEL = (("rolling_decel", 0), ("rolling_drag", 1)), (("rolling_decel", 0),)
WHOSE = {"": "", "a": " of ball a", "b": " of ball b"}


@dataclass(frozen=True)
class Track:
    """The motion of a fit, sampled: what ranges it covers. Of both balls or one, flattened over clips and instants.

    slips (m,): contact speeds while sliding; skids (m, 2): places there; places (p, 2) and speeds (p,) of moving balls;
    rolls (q,): speeds while rolling; ways (q, 2): places there.
    """

    slips: Array
    skids: Array
    places: Array
    speeds: Array
    rolls: Array
    ways: Array

    @classmethod
    def of(cls, model: Model, launches: Array, clips: Sequence[Measured]) -> dict[str, Track]:
        """Of both balls "", of ball "a" and of ball "b"."""
        first, last = min(int(c.frame.min()) for c in clips), max(int(c.frame.max()) for c in clips)
        times = np.linspace(min(first / clips[0].fps, launches[:, 2].min()), (last + 1) / clips[0].fps, SAMPLES)
        a_strikes = np.array([c.striker == "a" for c in clips])
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            states = np.nan_to_num(collisions(model, launches, times[0], times[-1], a_strikes).at(times))
        slip = np.hypot(*np.moveaxis(contact_velocity(states, model.ball.radius), -1, 0))
        speed, place = np.hypot(states[..., 3], states[..., 4]), states[..., :2]

        def ranges(slip: Array, speed: Array, place: Array) -> Track:
            skids, moves = slip > SLIPS, speed > SLIPS
            rolls = moves & ~skids
            return cls(slip[skids], place[skids], place[moves], speed[moves], speed[rolls], place[rolls])

        is_a = np.stack([~a_strikes, a_strikes])
        mine = {"": np.ones_like(is_a), "a": is_a, "b": ~is_a}
        return {ball: ranges(slip[own], speed[own], place[own]) for ball, own in mine.items()}


def slots(model: Model, launches: Array, clips: Sequence[Measured]) -> tuple[Slot, ...]:
    """Every slot, each over the range that these clips cover."""
    tracks = Track.of(model, launches, clips)
    found = [*_impacts(launches, len(clips)), *_picture(tracks[""], clips)]
    for ball, track in tracks.items():
        own = _along(track, WHOSE[ball])
        if ball:
            own = [replace(s, name=f"{s.name}_{ball}", ball=ball) for s in own if s.name in ALONE]
        found += own
    return tuple(sorted(found, key=lambda s: s.name))


def _impacts(launches: Array, count: int) -> list[Slot]:
    """Of laws that are asked once a collision; and of numbers of each clip."""
    speed, oblique = launches[:, 3], np.abs(launches[:, 5])
    normal, turn = speed * np.sqrt(1 - oblique**2), _turn()
    askew = Axis("obliqueness", "1", 0.0, max(float(oblique.max()), OBLIQUE), CURVE)
    found = [
        Slot("restitution_speed", "r", "1", (_over("normal speed", normal),), owners=R),
        Slot("spin_transfer_speed", "C", "1", (_over("contact speed", speed),), owners=C),
    ]
    for name, symbol, owner in (("restitution", "r", R), ("spin_transfer", "C", C)):
        found.append(Slot(f"{name}_heading", symbol, "1", (turn,), owners=owner))
        found.append(Slot(f"{name}_obliqueness", symbol, "1", (askew,), owners=owner))
    if count <= EACH:
        each = Axis("clip", "1", 0.0, count - 1.0, count, "set")
        found += [
            Slot("restitution_clip", "r", "1", (each,), owners=R),
            Slot("spin_transfer_clip", "C", "1", (each,), owners=C),
            Slot("friction_clip", "mu", "1", (each,), owners=MU),
            Slot("rolling_clip", "rolling loss at rest", "m/s^2", (each,), owners=DECEL),
        ]
    return found


def _along(track: Track, whose: str) -> list[Slot]:
    """Of laws that act all along the motion."""
    loss, force = f"rolling loss{whose}", f"force over mass{whose}"
    found = [
        Slot("force_speed", f"{force} along the motion", "m/s^2", (_over("speed", track.speeds, 0.0),)),
        Slot("force_heading", f"force over mass and speed{whose}", "1/s", (_turn(),), parts=2),
        Slot("force_place", force, "m/s^2", _plate(track.places, FIELD), parts=2),
    ]
    if len(track.slips):
        found += [
            Slot("friction_speed", f"mu{whose}", "1", (_over("slip speed", track.slips, 0.0),), owners=MU),
            Slot("friction_place", f"mu{whose}", "1", _plate(track.skids, MAP), owners=MU),
            Slot("friction_heading", f"mu{whose}", "1", (_turn(),), owners=MU),
        ]
    if len(track.rolls):
        found += [
            Slot("rolling_speed", loss, "m/s^2", (_over("speed", track.rolls, 0.0),), owners=LOSS),
            Slot("rolling_place", f"added {loss}", "m/s^2", _plate(track.ways, FIELD), parts=2, centred=True),
            Slot("rolling_heading", f"added {loss}", "m/s^2", (_turn(),), parts=2, centred=True),
        ]
    return found


def _picture(track: Track, clips: Sequence[Measured]) -> list[Slot]:
    camera = clips[0].camera
    seen = np.concatenate([c.xy for c in clips])  # a ball may move where no camera looks
    spatial = np.concatenate([seen, np.full((len(seen), 1), camera.radius)], axis=1)
    return [
        Slot("lag_speed", "lag of the picture", "s", (_over("speed", track.speeds, 0.0),), centred=True),
        Slot("warp_place", "shift of the picture", "px", _plate(camera.project(spatial), FIELD, "px"), 2, centred=True),
    ]


def _turn() -> Axis:
    return Axis("heading", "rad", -np.pi, np.pi, TURN, "circle")


def _over(name: str, values: Array, low: float | None = None) -> Axis:
    return Axis(name, "m/s", float(values.min()) if low is None else low, float(values.max()), CURVE)


def _plate(values: Array, count: int, unit: str = "m") -> tuple[Axis, Axis]:
    ends = zip("xy", values.min(axis=0).tolist(), values.max(axis=0).tolist(), strict=True)
    one, two = (Axis(name, unit, low, high, count) for name, low, high in ends)
    return one, two


def columns(slot: Slot, model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    """d forecast / d each coefficient, (n_k, 2, size), about a model that may have the slot filled."""
    if slot.name == "lag_speed":
        return lagging(slot, model, launches, clips)
    if slot.name == "warp_place":
        return _warped(slot, model, launches, clips)
    if not slot.bends or slot.bends[0] in ("restitution", "spin_transfer"):
        slopes = derivative(model, launches, clips, slot.owners[0][0])
        weights = slot.basis(_at_impact(slot, launches))
        return [s[..., None] * w for s, w in zip(slopes, weights, strict=True)]
    moves = _answered(slot, model, launches, clips)
    if not slot.ball:
        return moves
    mine = [c.ball == int(c.striker == slot.ball) for c in clips]  # a law of one ball moves no other
    return [np.where(own[:, None, None], m, 0.0) for own, m in zip(mine, moves, strict=True)]


def _at_impact(slot: Slot, launches: Array) -> Array:
    """Where each clip's impact stands on the slot's axis: (clips,). A ball that rolls in meets at its own speed."""
    axis, oblique = slot.axes[0], np.abs(launches[:, 5])
    if axis.kind == "set":
        return np.arange(len(launches), dtype=float)
    if axis.kind == "circle":
        return np.asarray(launches[:, 4])
    if axis.name == "obliqueness":
        return oblique
    return np.asarray(launches[:, 3] * (np.sqrt(1 - oblique**2) if axis.name == "normal speed" else 1.0))


def _warped(slot: Slot, model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    out = []
    for clip, xy in zip(clips, forecast(model, launches, clips), strict=True):
        pixels = clip.camera.project(np.concatenate([xy, np.full((len(xy), 1), clip.camera.radius)], axis=1))
        slope, weights = clip.camera.unproject(pixels)[1], slot.basis(pixels[:, 0], pixels[:, 1])
        out.append((slope[..., None] * weights[:, None, None]).reshape(len(xy), 2, -1))
    return out


def _answered(slot: Slot, model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    """Of a law of motion, were it of both balls."""
    assert slot.bends
    law, name = slot.bends

    def change(leg: Leg) -> Array:
        what = leg.place if name == "position" else getattr(leg, name)
        weights = slot.basis(*slot.places(what))
        if law != "push" and slot.parts == 1:
            return weights
        ways, weights = slot.ways(what, leg.speed), weights[..., None, :] if law == "push" else weights
        return np.concatenate([ways[..., p, None] * weights for p in range(slot.parts)], axis=-1)

    return responses(model, launches, clips, {law: change}, slot.size)
