"""Laws given as a table: a curve or a map that replaces numbers of the base model.

`free_laws: {friction_speed: {x: [0, 0.1, 0.2], y: [0.20, 0.23, 0.24]}}` in a model file gives mu at those slip speeds.
The names are those of the free laws of a search, which writes its results in this form.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, Literal, Self

import numpy as np

from synthcam.effect import LAWS, VECTOR_INPUTS, Effect, Parameter
from synthcam.table import SmoothTable, to_tuples
from synthcam_shared.arrays import Array

Owners = tuple[tuple[str, int], ...]

REFERENCE_SPEED_M_S = 0.1  # at which the proportional part of a rolling loss is given
TableAxis = Literal["line", "turn", "place"]  # over a number, the direction of a vector in rad, or the plate


@dataclass(frozen=True)
class TableKind:
    """One kind of table: the law that it gives and the quantity that this law depends on."""

    law: str  # of `LAWS`
    what: str  # the input that it depends on
    owners: Owners = ()  # the base model's numbers that it replaces, each times x to a power; none: it adds to the law
    axis: TableAxis = "line"  # of a vector over its size; "place": a map over both components
    unit: str = "1"
    x_unit: str = "m/s"
    # 2: of a force its parts along x and y, or, over an angle, along the motion and across it, over the speed; of a
    # rolling loss a constant part, and one in proportion to the speed, given at REFERENCE_SPEED_M_S.
    parts: int = 1
    low: float = -math.inf  # limits of the law
    high: float = math.inf
    one_ball: bool = False  # whether it may apply to ball a or b alone: NAME_a, NAME_b


_friction = partial(TableKind, "friction", owners=(("sliding_friction", 0),), low=0.0)
_restitution = partial(TableKind, "restitution", owners=(("restitution", 0),), low=0.0, high=1.0)
_spin_transfer = partial(TableKind, "spin_transfer", owners=(("spin_transfer", 0),), low=0.0, high=5 / 7)
_rolling = partial(TableKind, "rolling", unit="m/s^2")
_force = partial(TableKind, "push", unit="m/s^2")
_LOSS: Owners = (("rolling_decel", 0), ("rolling_drag", 1))
TABLE_KINDS: dict[str, TableKind] = {
    "friction_speed": _friction("slip_speed", one_ball=True),
    "friction_ball_speed": _friction("velocity"),
    "friction_heading": _friction("slip", axis="turn", x_unit="rad"),
    "friction_place": _friction("position", axis="place", x_unit="m"),
    "restitution_speed": _restitution("normal_speed"),
    "restitution_heading": _restitution("heading", axis="turn", x_unit="rad"),
    "restitution_obliqueness": _restitution("obliqueness", x_unit="1"),
    "spin_transfer_speed": _spin_transfer("contact_speed"),
    "spin_transfer_heading": _spin_transfer("heading", axis="turn", x_unit="rad"),
    "spin_transfer_obliqueness": _spin_transfer("obliqueness", x_unit="1"),
    "rolling_speed": _rolling("speed", owners=_LOSS, low=0.0, one_ball=True),
    "rolling_heading": _rolling("velocity", axis="turn", x_unit="rad", parts=2),
    "rolling_place": _rolling("position", axis="place", x_unit="m", parts=2),
    "force_speed": _force("velocity", one_ball=True),
    "force_velocity": _force("velocity", axis="place", parts=2, one_ball=True),
    "force_heading": _force("velocity", axis="turn", unit="1/s", x_unit="rad", parts=2),
    "force_place": _force("position", axis="place", x_unit="m", parts=2, one_ball=True),
}
SEARCH_ONLY_LAWS = {  # free laws of a search that a model cannot hold, and why
    **dict.fromkeys(("lag_speed", "warp_place"), "of the instrument; a model holds only laws of motion"),
    "side_spin_clip": "of the launches: `free: [launch.spin]` has it fitted in each, launch.side of a scene makes it",
    **dict.fromkeys(
        ("restitution_clip", "spin_transfer_clip", "friction_clip", "rolling_clip", "scale_clip", "clock_clip"),
        "another number in each clip; a scene has such as a distribution, as in restitution: {normal: [0.9, 0.01]}",
    ),
}


_kinds = {  # with the ball, by every name that a tabulated law may have
    name + end: (kind, end[1:])
    for name, kind in TABLE_KINDS.items()
    for end in (("", "_a", "_b") if kind.one_ball else ("",))
}


def kind_of(name: str) -> tuple[TableKind, str]:
    """Return the kind of a tabulated law by its name, and its ball: "a", "b" or "" for both. Raises KeyError."""
    return _kinds[name]


def table_names() -> Iterator[str]:
    """Iterate over every name that a tabulated law may have."""
    return iter(_kinds)


@dataclass(frozen=True)
class AddedLaw(Effect):
    """Base of a term added to one law: a function of one input, for both balls or for one of them.

    It has no parameters. It acts before all effects, which therefore multiply the law with this term.
    """

    first: ClassVar[bool] = True

    def __init_subclass__(cls) -> None:
        cls.laws = {}  # its methods are not laws

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        return ()

    @property
    @abstractmethod
    def target(self) -> tuple[str, str, str] | None:
        """The law, its input ("": the value itself) and its ball; None: not a law of a model."""

    @abstractmethod
    def _addition(self, what: Any, speed: Any) -> Array:
        """Return the term at the inputs `what`: (...), or (..., 2) for a push."""

    @property
    def bends(self) -> Iterator[tuple[str, Callable[..., Any], tuple[str, ...]]]:
        if self.target:
            law, what, ball = self.target
            asks = dict.fromkeys([what] * bool(what) + ["speed"] * (law == "rolling") + ["of_a"] * bool(ball))
            yield law, partial(self._bend, tuple(asks)), tuple(asks)

    def _bend(self, asks: tuple[str, ...], value: Any, *known: Any) -> Any:
        """Return the value of the law with the term; known: the inputs in the order of `asks`."""
        assert self.target
        law, what, ball = self.target
        instant = dict(zip(asks, known, strict=True))
        out = self._addition(instant[what] if what else value, instant.get("speed"))
        if ball:
            share = instant["of_a"] if ball == "a" else 1 - instant["of_a"]
            out = out * (np.asarray(share)[..., None] if law == "push" else share)
        return value + out


@dataclass(frozen=True)
class TabulatedLaw(AddedLaw):
    """A law from a table, which replaces numbers of the base model."""

    law: str  # one of `table_names()`
    table: SmoothTable  # its values beside `base_numbers`; beside others, they are shifted by the difference
    base_numbers: tuple[float, ...] = ()  # the values of `TableKind.owners`

    @classmethod
    def of(cls, law: str, x: Any, y: Any, numbers: Mapping[str, float]) -> Self:
        """Make the law beside these numbers of the base model. Raises ValueError with what was expected."""
        kind, _ = kind_of(law)
        table = SmoothTable(to_tuples(x), to_tuples(y), kind.axis == "turn")
        if table.plane != (kind.axis == "place"):
            raise ValueError(f"x: expected {'pairs' if kind.axis == 'place' else 'numbers'}, {kind.x_unit}")
        if table.parts != kind.parts:
            raise ValueError(f"y: expected {'pairs' if kind.parts == 2 else 'numbers'}, {kind.unit}")
        low, high = float(np.min(table.y)), float(np.max(table.y))
        if low < kind.low or high > kind.high:
            allowed = f"from {kind.low:g} to {kind.high:g}" if math.isfinite(kind.high) else f"of {kind.low:g} or more"
            raise ValueError(f"y: expected numbers {allowed}, found {low if low < kind.low else high:g}")
        return cls(law, table, tuple(float(numbers[name]) for name, _ in kind.owners))

    def name(self) -> str:  # type: ignore[override]
        """The name in YAML."""
        return self.law

    @property
    def active(self) -> bool:
        return True

    @cached_property
    def kind(self) -> TableKind:
        return kind_of(self.law)[0]

    @cached_property
    def target(self) -> tuple[str, str, str] | None:
        kind, ball = kind_of(self.law)
        return kind.law, kind.what, ball

    def beyond(self, *x: Any) -> Array:
        """Return the table minus the numbers that it replaces, at x: (...), or (..., 2) for two components."""
        out = self.table(*x)
        for (_, power), value in zip(self.kind.owners, self.base_numbers, strict=True):
            out = out - value * np.asarray(x[0]) ** power
        return np.asarray(out)

    def _addition(self, what: Any, speed: Any) -> Array:
        kind = self.kind
        what = np.asarray(what)
        if kind.axis == "place":
            out = self.beyond(what[..., 0], what[..., 1])
        elif kind.axis == "turn":
            out = self.beyond(np.arctan2(what[..., 1], what[..., 0]))
        elif kind.law == "push":
            size = np.hypot(what[..., 0], what[..., 1])
            return np.asarray((self.beyond(size) / np.maximum(size, 1e-9))[..., None] * what)
        else:
            out = self.beyond(np.hypot(what[..., 0], what[..., 1]) if kind.what in VECTOR_INPUTS else what)
        if kind.law == "rolling" and kind.parts == 2:
            return np.asarray(out[..., 0] + out[..., 1] * (speed / REFERENCE_SPEED_M_S))
        if kind.law == "push" and kind.axis == "turn":
            return np.asarray(out[..., :1] * what + out[..., 1:] * np.stack([-what[..., 1], what[..., 0]], axis=-1))
        return out

    def to_settings(self, numbers: Mapping[str, float]) -> dict[str, list[Any]]:
        """Return x and y as `of` takes them, beside these numbers of the base model."""
        x, y = np.array(self.table.x), np.array(self.table.y)
        for (name, power), value in zip(self.kind.owners, self.base_numbers, strict=True):
            if numbers[name] != value:
                first = x[:, 0] if self.table.plane else x
                y = np.clip(y + (numbers[name] - value) * first**power, self.kind.low, self.kind.high)
        return {"x": x.tolist(), "y": y.tolist()}


assert all(kind.law in LAWS and kind.what in LAWS[kind.law] for kind in TABLE_KINDS.values())
