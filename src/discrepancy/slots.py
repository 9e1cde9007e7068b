"""Slots: laws left free. A series over the range that the data cover bends one law inside the forward model.

Each slot knows its derivative at any model: what one unit of each of its coefficients moves the tracks by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from discrepancy.axis import Axis
from discrepancy.derivative import derivative
from discrepancy.forecast import forecast, velocities
from discrepancy.measured import Measured
from discrepancy.response import Leg, responses
from synthcam.batch import collisions
from synthcam.effect import Effect, Parameter
from synthcam.kinematics import contact_velocity
from synthcam.model import Model

Array = NDArray[np.float64]

CURVE, TURN, MAP, FIELD = 20, 9, 12, 8  # coefficients: of a curve, of one of angles, a side of a map, and of a field
MEAN = 200  # places on each axis, to take a mean over
EACH = 120  # clips: of more, no number of each is fitted
SLIPS = 1e-5  # m/s: a ball whose contact is slower rolls
SAMPLES = 300  # instants at which the base fit's motion is looked at for the ranges that it covers


@dataclass(frozen=True)
class Slot:
    """A law left free: `symbol`, in `unit`, over its axes (two for a map of places). parts: of a vector.

    owners: the base parameters that make the law, each times the axis to a power; what the slot adds to. centred: a
    constant means nothing, since the launches absorb it, but for what their derivatives are wrong by: there is none.
    """

    name: str
    symbol: str
    unit: str
    axes: tuple[Axis, ...]
    parts: int = 1
    owners: tuple[tuple[str, int], ...] = ()
    centred: bool = False

    @property
    def size(self) -> int:
        """How many coefficients; those of the second part follow those of the first."""
        return self.parts * int(np.prod([a.count for a in self.axes]))

    @cached_property
    def _middle(self) -> Array | float:
        """What is taken out of the series where it is centred: its mean over the range, (coefficients of one part,)."""
        if not self.centred:
            return 0.0
        means = [a.basis(a.grid(MEAN)).mean(axis=0) for a in self.axes]
        return np.asarray(means[0] if len(means) == 1 else np.outer(*means).ravel())

    def basis(self, *x: Any) -> Array:
        """(..., coefficients of one part) at x, one array for each axis."""
        if len(self.axes) == 1:
            return self.axes[0].basis(x[0]) - self._middle
        first, second = (a.basis(v) for a, v in zip(self.axes, x, strict=True))
        return np.asarray((first[..., :, None] * second[..., None, :]).reshape(*first.shape[:-1], -1)) - self._middle

    def values(self, coefs: Array, *x: Any) -> Array:
        """What the slot adds to the law: (...), or (..., 2) of a vector."""
        parts = np.reshape(coefs, (self.parts, -1))
        if len(self.axes) == 2:
            first, second = (a.basis(v) for a, v in zip(self.axes, x, strict=True))
            grid = parts.reshape(self.parts, self.axes[0].count, -1)
            out = np.einsum("...i,...j,pij->...p", first, second, grid, optimize=True)
        else:
            out = self.axes[0].basis(x[0]) @ parts.T
        if self.centred:
            out = out - parts @ self._middle
        return np.asarray(out[..., 0] if self.parts == 1 else out)

    def spread(self, *lengths: float) -> Array:
        """Prior variances of all coefficients, (size,), of a law that changes over a length, or one of each axis."""
        out = np.ones(1)
        for axis, length in zip(self.axes, lengths * (len(self.axes) // len(lengths)), strict=True):
            out = np.outer(out, axis.spread(length)).ravel()
        return np.tile(out, self.parts)

    def undone(self, clips: Sequence[Measured], model: Model, launches: Array, coefs: Array) -> list[Measured]:
        """The clips with what the slot moved taken out of them, where no effect can hold the slot."""
        if self.name in _EFFECTS or not np.any(coefs):
            return list(clips)
        if self.name == "lag_speed":
            moved = [m @ coefs for m in lagging(self, model, launches, clips)]
        else:
            owner = self.owners[0][0]
            moved = []
            for k, clip in enumerate(clips):
                own, start = self.basis(np.array(k)) @ coefs, launches[k : k + 1]
                bent = forecast(model.replace({owner: model.value(owner) + float(own)}), start, [clip])
                moved.append(bent[0] - forecast(model, start, [clip])[0])
        return [replace(c, xy=c.xy - m) for c, m in zip(clips, moved, strict=True)]

    def bent(self, model: Model, coefs: Array) -> Model:
        """The model with the slot filled; as it was where the slot is none of a model's laws."""
        if self.name not in _EFFECTS:
            return model
        others = tuple(e for e in model.effects if e.name() != _EFFECTS[self.name].name())
        filled = _EFFECTS[self.name](self, tuple(np.asarray(coefs, dtype=float).tolist()))
        return replace(model, effects=(*others, filled))


@dataclass(frozen=True)
class Free(Effect):
    """A filled slot as an effect: it has no parameters in the library's sense, since no file can hold it."""

    slot: Slot
    coefs: tuple[float, ...]

    @classmethod
    def name(cls) -> str:
        return f"slot {cls.__name__}"

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        return ()

    @property
    def active(self) -> bool:
        return any(self.coefs)

    def _at(self, *x: Any) -> Array:
        return self.slot.values(np.array(self.coefs), *x)


def _angle(vector: Any) -> Array:
    return np.asarray(np.arctan2(vector[..., 1], vector[..., 0]))


def _turned(vector: Array) -> Array:
    """A quarter turn on."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)


class FrictionSpeed(Free):
    def friction(self, mu: Any, slip_speed: Any) -> Any:
        return mu + self._at(slip_speed)


class FrictionPlace(Free):
    def friction(self, mu: Any, position: Any) -> Any:
        return mu + self._at(position[..., 0], position[..., 1])


class FrictionHeading(Free):
    def friction(self, mu: Any, slip: Any) -> Any:
        return mu + self._at(_angle(slip))


class RestitutionSpeed(Free):
    def restitution(self, r: Any, normal_speed: Any) -> Any:
        return r + self._at(normal_speed)


class RestitutionHeading(Free):
    def restitution(self, r: Any, heading: Any) -> Any:
        return r + self._at(_angle(heading))


class SpinTransferSpeed(Free):
    def spin_transfer(self, c: Any, contact_speed: Any) -> Any:
        return c + self._at(contact_speed)


class RollingSpeed(Free):
    def rolling(self, loss: Any, speed: Any) -> Any:
        return loss + self._at(speed)


class ForceSpeed(Free):
    def push(self, acceleration: Any, velocity: Any) -> Any:
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        along = velocity / np.maximum(speed, 1e-9)[..., None]
        return acceleration + self._at(speed)[..., None] * along


class ForceHeading(Free):
    """Along the velocity and a quarter turn from it, in proportion to it: a ball that stops feels none."""

    def push(self, acceleration: Any, velocity: Any) -> Any:
        own = self._at(_angle(velocity))[..., None]
        return acceleration + own[..., 0, :] * velocity + own[..., 1, :] * _turned(velocity)


class ForcePlace(Free):
    def push(self, acceleration: Any, position: Any) -> Any:
        return acceleration + self._at(position[..., 0], position[..., 1])


class WarpPlace(Free):
    def measure(self, pixels: Any) -> Any:
        return pixels + self._at(pixels[..., 0], pixels[..., 1])


_EFFECTS: dict[str, type[Free]] = {
    "friction_speed": FrictionSpeed,
    "friction_place": FrictionPlace,
    "friction_heading": FrictionHeading,
    "restitution_speed": RestitutionSpeed,
    "restitution_heading": RestitutionHeading,
    "spin_transfer_speed": SpinTransferSpeed,
    "rolling_speed": RollingSpeed,
    "force_speed": ForceSpeed,
    "force_heading": ForceHeading,
    "force_place": ForcePlace,
    "warp_place": WarpPlace,
}
_NO_EFFECTS = ("lag_speed", "restitution_clip", "spin_transfer_clip")
SLOTS = len(_EFFECTS) + len(_NO_EFFECTS)


@dataclass(frozen=True)
class Track:
    """The motion of a fit, sampled: what ranges it covers. All flattened over balls and instants.

    slips (m,): contact speeds while sliding; skids (m, 2): places there; places (p, 2) and speeds (p,) of moving balls;
    rolls (q,): speeds while rolling.
    """

    slips: Array
    skids: Array
    places: Array
    speeds: Array
    rolls: Array

    @classmethod
    def of(cls, model: Model, launches: Array, clips: Sequence[Measured]) -> Track:
        first, last = min(int(c.frame.min()) for c in clips), max(int(c.frame.max()) for c in clips)
        times = np.linspace(min(first / clips[0].fps, launches[:, 2].min()), (last + 1) / clips[0].fps, SAMPLES)
        states = collisions(model, launches, times[0], times[-1], [c.striker == "a" for c in clips]).at(times)
        slip = np.hypot(*np.moveaxis(contact_velocity(states, model.ball.radius), -1, 0))
        speed = np.hypot(states[..., 3], states[..., 4])
        skids, moves = slip > SLIPS, speed > SLIPS
        places = states[..., :2]
        return cls(slip[skids], places[skids], places[moves], speed[moves], speed[moves & ~skids])


def slots(model: Model, launches: Array, clips: Sequence[Measured]) -> tuple[Slot, ...]:
    """Every slot, each over the range that these clips cover."""
    track = Track.of(model, launches, clips)
    mu, r, c = ((("sliding_friction", 0),), (("restitution", 0),), (("spin_transfer", 0),))
    loss = (("rolling_decel", 0), ("rolling_drag", 1))
    speed, normal = launches[:, 3], launches[:, 3] * np.sqrt(1 - launches[:, 5] ** 2)
    turn = Axis("heading", "rad", -np.pi, np.pi, TURN, "circle")
    each = Axis("clip", "1", 0.0, len(clips) - 1.0, len(clips), "set")

    def over(name: str, values: Array, low: float | None = None) -> Axis:
        return Axis(name, "m/s", float(values.min()) if low is None else low, float(values.max()), CURVE)

    def plate(values: Array, count: int, unit: str = "m") -> tuple[Axis, Axis]:
        ends = zip("xy", values.min(axis=0).tolist(), values.max(axis=0).tolist(), strict=True)
        one, two = (Axis(name, unit, low, high, count) for name, low, high in ends)
        return one, two

    camera = clips[0].camera
    seen = np.concatenate([c.xy for c in clips])  # a ball may move where no camera looks
    spatial = np.concatenate([seen, np.full((len(seen), 1), camera.radius)], axis=1)
    found = [
        Slot("restitution_speed", "r", "1", (over("normal speed", normal),), owners=r),
        Slot("restitution_heading", "r", "1", (turn,), owners=r),
        Slot("spin_transfer_speed", "C", "1", (over("contact speed", speed),), owners=c),
        Slot("force_speed", "force over mass along the motion", "m/s^2", (over("speed", track.speeds, 0.0),)),
        Slot("force_heading", "force over mass and speed", "1/s", (turn,), parts=2),
        Slot("force_place", "force over mass", "m/s^2", plate(track.places, FIELD), parts=2),
        Slot("lag_speed", "lag of the picture", "s", (over("speed", track.speeds, 0.0),), centred=True),
        Slot("warp_place", "shift of the picture", "px", plate(camera.project(spatial), FIELD, "px"), 2, centred=True),
    ]
    if len(clips) <= EACH:
        found += [
            Slot("restitution_clip", "r", "1", (each,), owners=r),
            Slot("spin_transfer_clip", "C", "1", (each,), owners=c),
        ]
    if len(track.slips):
        found += [
            Slot("friction_speed", "mu", "1", (over("slip speed", track.slips, 0.0),), owners=mu),
            Slot("friction_place", "mu", "1", plate(track.skids, MAP), owners=mu),
            Slot("friction_heading", "mu", "1", (turn,), owners=mu),
        ]
    if len(track.rolls):
        found.append(Slot("rolling_speed", "rolling loss", "m/s^2", (over("speed", track.rolls, 0.0),), owners=loss))
    return tuple(sorted(found, key=lambda s: s.name))


def columns(slot: Slot, model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    """d forecast / d each coefficient, (n_k, 2, size), about a model that may have the slot filled."""
    if slot.name == "lag_speed":
        return lagging(slot, model, launches, clips)
    if slot.name == "warp_place":
        return _warped(slot, model, launches, clips)
    if slot.name.startswith(("restitution", "spin_transfer")):
        slopes = derivative(model, launches, clips, slot.owners[0][0])
        weights = slot.basis(_at_impact(slot, launches))
        return [s[..., None] * w for s, w in zip(slopes, weights, strict=True)]
    return _answered(slot, model, launches, clips)


def _at_impact(slot: Slot, launches: Array) -> Array:
    """Where each clip's impact stands on the slot's axis: (clips,). A ball that rolls in meets at its own speed."""
    axis = slot.axes[0]
    if axis.kind == "set":
        return np.arange(len(launches), dtype=float)
    if axis.kind == "circle":
        return np.asarray(launches[:, 4])
    return np.asarray(launches[:, 3] * (np.sqrt(1 - launches[:, 5] ** 2) if axis.name == "normal speed" else 1.0))


def lagging(slot: Slot, model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    """Of a picture that lags behind the motion by so many seconds: -v times each cosine at |v|."""
    seen = velocities(model, launches, clips)
    return [-v[..., None] * slot.basis(np.hypot(v[:, 0], v[:, 1]))[:, None] for v in seen]


def _warped(slot: Slot, model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    out = []
    for clip, xy in zip(clips, forecast(model, launches, clips), strict=True):
        pixels = clip.camera.project(np.concatenate([xy, np.full((len(xy), 1), clip.camera.radius)], axis=1))
        slope, weights = clip.camera.unproject(pixels)[1], slot.basis(pixels[:, 0], pixels[:, 1])
        out.append((slope[..., None] * weights[:, None, None]).reshape(len(xy), 2, -1))
    return out


def _answered(slot: Slot, model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    """Of a law of motion."""
    law = next(iter(_EFFECTS[slot.name].laws))

    def change(leg: Leg) -> Array:
        x = {
            "friction_speed": (leg.slip_speed,),
            "friction_heading": (_angle(leg.slip),),
            "rolling_speed": (leg.speed,),
            "force_speed": (leg.speed,),
            "force_heading": (_angle(leg.velocity),),
        }.get(slot.name, (leg.place[..., 0], leg.place[..., 1]))
        weights = slot.basis(*x)[..., None, :]
        if law != "push":
            return np.asarray(weights[..., 0, :])
        if slot.name == "force_speed":
            return np.asarray(leg.way[..., None] * weights)
        ways = np.broadcast_to(np.eye(2), (*leg.velocity.shape, 2))
        if slot.name == "force_heading":
            ways = np.stack([leg.velocity, _turned(leg.velocity)], axis=-1)
        return np.concatenate([ways[..., :1] * weights, ways[..., 1:] * weights], axis=-1)

    return responses(model, launches, clips, {law: change}, slot.size)
