"""A law left free: a series over the range that the data cover, of both balls alike or of one alone, as an effect.

Every slot is a law, what that may depend on, and whose it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from discrepancy.data.collisions import Measured
from discrepancy.fitting.predict import forecast, velocities
from discrepancy.free_laws.basis import Axis
from synthcam.effect import Effect, Parameter
from synthcam.model import Model

Array = NDArray[np.float64]

MEAN = 200  # places on each axis, to take a mean over
PACE = 0.1  # m/s: at this speed a rolling loss's part in proportion to the speed counts as its constant part does

# Of each slot: the law that it bends, and what that depends on, as an effect asks for it.
BENDS = {
    "friction_speed": ("friction", "slip_speed"),
    "friction_place": ("friction", "position"),
    "friction_heading": ("friction", "slip"),
    "restitution_speed": ("restitution", "normal_speed"),
    "restitution_heading": ("restitution", "heading"),
    "restitution_obliqueness": ("restitution", "obliqueness"),
    "spin_transfer_speed": ("spin_transfer", "contact_speed"),
    "spin_transfer_heading": ("spin_transfer", "heading"),
    "spin_transfer_obliqueness": ("spin_transfer", "obliqueness"),
    "rolling_speed": ("rolling", "speed"),
    "rolling_place": ("rolling", "position"),
    "rolling_heading": ("rolling", "velocity"),
    "force_speed": ("push", "velocity"),
    "force_heading": ("push", "velocity"),
    "force_place": ("push", "position"),
    "warp_place": ("measure", ""),
}
ALONE = ("friction_speed", "rolling_speed", "force_speed", "force_place")  # of ball a alone, or of ball b alone, too
UNBENT = ("lag_speed", "restitution_clip", "spin_transfer_clip", "friction_clip", "rolling_clip")  # in no effect
SLOTS = len(BENDS) + 2 * len(ALONE) + len(UNBENT)


@dataclass(frozen=True)
class Slot:
    """A law left free: `symbol`, in `unit`, over its axes (two for a map of places). parts: of a vector.

    owners: the base parameters that make the law, each times the axis to a power; what the slot adds to. centred: a
    constant means nothing, since launches or base parameters absorb it, but for what their derivatives are wrong by:
    there is none. ball: "a" or "b" where the law is that of one ball alone. A rolling loss over a heading or a place
    has two parts: a constant one, and one in proportion to the speed, as it is at PACE.
    """

    name: str
    symbol: str
    unit: str
    axes: tuple[Axis, ...]
    parts: int = 1
    owners: tuple[tuple[str, int], ...] = ()
    centred: bool = False
    ball: str = ""

    @property
    def bends(self) -> tuple[str, str] | None:
        """The law that it bends, and what that depends on; None where no effect can hold it."""
        return BENDS.get(self.name.removesuffix(f"_{self.ball}"))

    @property
    def paced(self) -> bool:
        """Has it a part in proportion to the speed beside a constant one?"""
        return self.parts > 1 and self.name.startswith("rolling")

    @property
    def part_names(self) -> tuple[str, ...]:
        """For people; of a law of one part empty."""
        if self.parts == 1:
            return ("",)
        if self.paced:
            return "constant", f"with the speed, at {PACE:g} m/s"
        return ("x", "y") if len(self.axes) == 2 else ("along", "across")

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
        if self.bends or not np.any(coefs):
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
        if not self.bends:
            return model
        others = tuple(e for e in model.effects if not (isinstance(e, Free) and e.slot.name == self.name))
        return replace(model, effects=(*others, Free(self, tuple(np.asarray(coefs, dtype=float).tolist()))))

    def places(self, what: Any) -> tuple[Array, ...]:
        """Where on its axes an instant is: an array for each. what: what its law depends on, (...) or (..., 2)."""
        if len(self.axes) == 2:
            return what[..., 0], what[..., 1]
        if self.axes[0].kind == "circle":
            return (np.asarray(np.arctan2(what[..., 1], what[..., 0])),)
        return (np.hypot(what[..., 0], what[..., 1]) if self.bends == ("push", "velocity") else what,)

    def ways(self, what: Any, speed: Any) -> Array:
        """What its parts are factors of: (..., parts) of a number, (..., 2, parts) of a force. speed: of a roll."""
        if self.paced:
            return np.stack([np.ones_like(speed), speed / PACE], axis=-1)
        if len(self.axes) == 2:
            return np.broadcast_to(np.eye(2), (*what.shape, 2))
        if self.axes[0].kind == "circle":  # in proportion to the velocity: a ball that stops feels none
            return np.stack([what, np.stack([-what[..., 1], what[..., 0]], axis=-1)], axis=-1)
        return np.asarray((what / np.maximum(np.hypot(what[..., 0], what[..., 1]), 1e-9)[..., None])[..., None])


@dataclass(frozen=True)
class Free(Effect):
    """A filled slot as an effect: it has no parameters in the library's sense, since no file can hold it."""

    slot: Slot
    coefs: tuple[float, ...]

    @classmethod
    def name(cls) -> str:
        return "slot"

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        return ()

    @property
    def active(self) -> bool:
        return any(self.coefs)

    @property
    def bends(self) -> Iterator[tuple[str, Callable[..., Any], tuple[str, ...]]]:
        slot = self.slot
        if slot.bends:
            law, what = slot.bends
            asks = dict.fromkeys([what] * bool(what) + ["speed"] * (law == "rolling") + ["of_a"] * bool(slot.ball))
            yield law, lambda value, *known: self._added(value, dict(zip(asks, known, strict=True))), tuple(asks)

    def _added(self, value: Any, instant: Mapping[str, Any]) -> Any:
        """The law's value, bent."""
        slot = self.slot
        assert slot.bends
        law, name = slot.bends
        what = instant[name] if name else value
        out = slot.values(np.array(self.coefs), *slot.places(what))
        if law == "push":
            out = (slot.ways(what, None) * (out if slot.parts > 1 else out[..., None])[..., None, :]).sum(axis=-1)
        elif slot.paced:
            out = (slot.ways(what, instant["speed"]) * out).sum(axis=-1)
        if slot.ball:
            share = instant["of_a"] if slot.ball == "a" else 1 - instant["of_a"]
            out = out * (np.asarray(share)[..., None] if law == "push" else share)
        return value + out


def lagging(slot: Slot, model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    """Of a picture that lags behind the motion by so many seconds: -v times each cosine at |v|."""
    seen = velocities(model, launches, clips)
    return [-v[..., None] * slot.basis(np.hypot(v[:, 0], v[:, 1]))[:, None] for v in seen]
