"""What an effect is: a few parameters and the laws it bends.

A law is a number of the base model (a restitution, a friction coefficient, a force) at one instant. An effect
overrides a law by defining a method of that name, which takes the value so far, then whatever it needs to know of
that instant, by name, and returns the bent value::

    def friction(self, mu, slip_speed):
        return mu * (1 + self.rise * np.exp(-slip_speed / self.slip))

`LAWS` lists the laws and what each may ask for. Several effects on one law are applied in the order of their names,
after the model's tables (`free_law.py`).
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

from synthcam_shared.errors import PluginError

# All balls, or all nodes of an integration, come together: numbers are arrays (balls, n) or broadcast with them,
# vectors have a last axis of two. "slip" is the unit vector of the contact velocity; "of_a" is 1 for the experimenter's
# ball a, 0 for ball b; "other" is the position of the other ball relative to this one; "ball" is the model's,
# whose radius and mass no effect has bent.
LAWS: dict[str, tuple[str, ...]] = {
    # the balls, once a run; bends ball a's
    "mass": (),
    "radius": (),
    # impact, once a collision; speeds in m/s, approach_speed of the centres, normal_impulse over twice the reduced
    # mass, obliqueness of the approach: |b|, the sine of its angle with the normal
    "restitution": ("normal_speed", "heading", "obliqueness"),
    "spin_transfer": ("contact_speed", "normal_impulse", "approach_speed", "heading", "obliqueness"),
    "loft": (),  # the share of the vertical impulse that the plate does not hold back
    "rebound": (),  # the plate's restitution
    # sliding: mu; the load on the plate over the mass, m/s^2; the torque about the vertical, as dwz/dt
    "friction": ("slip_speed", "slip", "position", "velocity", "spin", "radius", "of_a"),
    "normal_load": ("gravity", "position", "velocity", "of_a"),
    "drilling": ("spin", "slip_speed", "friction", "load", "radius", "of_a"),  # of friction as it is bent
    # rolling loss, m/s^2 against the motion
    "rolling": ("speed", "position", "velocity", "gravity", "radius", "of_a"),
    # force over mass on the centre, m/s^2
    "push": ("position", "velocity", "gravity", "radius", "mass", "of_a", "other", "ball"),
    # the picture: the camera as it is; when a moment of the film really was; how long the shutter was open
    "camera": (),
    "clock": ("fps", "row"),
    "exposure": ("fps",),
    # a defect of the tracker, which no scene may have: where it puts a centre that is seen at (x, y) px. Two functions
    # of such pixels: "glint", where the glint is; "mirrored", where it would be, were the lamp at (x, y, z) m, which is
    # (x, y) itself where camera.json has a lamp
    "measure": ("glint", "mirrored"),
}
VECTOR_INPUTS = {"slip", "position", "velocity", "other", "glint", "mirrored"}  # of what laws ask for


def parameter(
    unit: str,
    *,
    typical: float,
    low: float = -math.inf,
    high: float = math.inf,
    fixed: bool = False,
    given: bool = False,
    default: float | None = None,
    tries: Iterable[float] = (),
) -> Any:
    """Declare a parameter of an effect, as the value of a dataclass field.

    Parameters
    ----------
    unit : str
        SI; "1" for a pure number.
    typical : float
        A realistic size.
    low, high : float
        Limits, inclusive.
    fixed : bool
        A shape parameter, meaningless while the strengths are zero: a search scans it and does not fit it. All others
        are strengths: the effect is absent when every one of them is zero.
    given : bool
        A shape parameter that tracks cannot separate from the others: a search leaves it as it is.
    default : float, optional
        Default: `typical` for a shape parameter, 0 for a strength.
    tries : iterable of float
        Values of a shape parameter at which a search starts, close enough together to overlook nothing; default: a
        few about `typical`.

    Returns
    -------
    dataclasses.Field
    """
    value = default if default is not None else (typical if fixed else 0.0)
    declared = {"unit": unit, "typical": typical, "low": low, "high": high, "fixed": fixed, "given": given}
    return field(default=value, metadata=declared | {"tries": tuple(map(float, tries))})


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect; the attributes are the arguments of `parameter`."""

    name: str
    unit: str
    typical: float
    low: float
    high: float
    fixed: bool
    default: float
    given: bool = False
    tries: tuple[float, ...] = ()


@dataclass(frozen=True)
class Effect:
    """Base of all effects. A subclass holds parameters and the laws it bends, and lives in a file of its own name."""

    laws: ClassVar[dict[str, tuple[str, ...]]] = {}
    first: ClassVar[bool] = False  # does it act before all others, whatever its name?

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.laws = {}
        for name, member in vars(cls).items():
            if name.startswith("_") or not inspect.isfunction(member):
                continue
            if name not in LAWS:
                raise PluginError(f"{cls.__name__}.{name}: no such law; there are {', '.join(LAWS)}")
            asks = tuple(inspect.signature(member).parameters)[2:]
            unknown = [a for a in asks if a not in LAWS[name]]
            if unknown:
                raise PluginError(
                    f"{cls.__name__}.{name} asks for {', '.join(unknown)}; {name} may ask for {', '.join(LAWS[name])}"
                )
            cls.laws[name] = asks

    def __post_init__(self) -> None:
        for p in self.parameters():
            value = getattr(self, p.name)
            if not (math.isfinite(value) and p.low <= value <= p.high):
                raise ValueError(
                    f"{self.name()}.{p.name} = {value:g}: expected a number from {p.low:g} to {p.high:g} {p.unit}"
                )

    @classmethod
    def name(cls) -> str:
        """The name in YAML: that of the file."""
        return cls.__module__.rpartition(".")[2]

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The parameters in the order of declaration."""
        return tuple(Parameter(name=f.name, default=f.default, **f.metadata) for f in fields(cls))  # type: ignore[arg-type]

    @classmethod
    def strengths(cls) -> tuple[Parameter, ...]:
        """The parameters that are zero when the effect is absent."""
        return tuple(p for p in cls.parameters() if not p.fixed)

    @classmethod
    def absent(cls) -> Self:
        """The effect with every strength zero and every shape parameter at its default."""
        return cls(**{p.name: 0.0 for p in cls.strengths()})

    @property
    def bends(self) -> Iterator[tuple[str, Callable[..., Any], tuple[str, ...]]]:
        """The laws that it bends, the method of each, and what that asks to know."""
        return ((law, getattr(self, law), asks) for law, asks in self.laws.items())

    @property
    def active(self) -> bool:
        """False when every strength is exactly zero: the effect is then left out, bit for bit."""
        return any(getattr(self, p.name) != 0.0 for p in self.strengths())


class Laws:
    """The laws of a model with its active effects applied; one callable attribute for each law."""

    def __init__(self, effects: Iterable[Effect]) -> None:
        active = sorted((e for e in effects if e.active), key=lambda e: (not e.first, e.name()))
        self._bends: dict[str, list[tuple[Callable[..., Any], tuple[str, ...]]]] = {law: [] for law in LAWS}
        for effect in active:
            for law, bend, asks in effect.bends:
                self._bends[law].append((bend, asks))

    def has_effect_on(self, *laws: str) -> bool:
        """True when an active effect bends any of these laws."""
        return any(self._bends[law] for law in laws)

    def inputs_of(self, law: str) -> set[str]:
        """What the active effects on `law` want to know."""
        return {what for _, asks in self._bends[law] for what in asks}

    def needs(self, law: str, what: str) -> bool:
        """True when an active effect on `law` wants to know `what`."""
        return any(what in asks for _, asks in self._bends[law])

    def __call__(self, law: str, value: Any, instant: Mapping[str, Any]) -> Any:
        """`value` after every effect on `law`; `instant` maps the names in LAWS[law] to what they are now."""
        for bend, asks in self._bends[law]:
            value = bend(value, *[instant[a] for a in asks])
        return value
