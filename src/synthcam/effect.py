"""The base class of effects: a few parameters, and the laws of motion or of the picture that they change.

A law is a quantity of the base model at one instant, such as a restitution, a friction coefficient or a force. An
effect changes a law by a method of that name. The method takes the value so far and then, by name, the quantities that
it needs of that instant, and returns the new value::

    def friction(self, mu, slip_speed):
        return mu * (1 + self.rise * np.exp(-slip_speed / self.slip))

`LAWS` lists the laws and the inputs that each may ask for. Several effects on one law are applied in the order of
their names, after the model's tables (`tabulated_law.py`).
"""

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

from synthcam_shared.errors import PluginError

# Inputs hold all balls, or all nodes of an integration, at once. Numbers are arrays (balls, n) or broadcast with them.
# Vectors have a last axis of two. The "slip" is the unit vector of the contact velocity, the "heading" that of the
# approach, and "other" the position of the other ball relative to this one. Ball a of the experimenter has 1 as "of_a",
# and ball b has 0. The "ball" is that of the model, with the radius and mass before any effect.
LAWS: dict[str, tuple[str, ...]] = {
    # the balls, once a run: radius and mass of ball a
    "mass": (),
    "radius": (),
    # impact, once a collision. Speeds are in m/s; approach_speed is that of the centres, and normal_impulse the impulse
    # over twice the reduced mass. The obliqueness of the approach is |b|, the sine of its angle with the normal.
    # inertia: I/(m R^2)
    "restitution": ("normal_speed", "heading", "obliqueness"),
    "spin_transfer": ("contact_speed", "normal_impulse", "approach_speed", "heading", "obliqueness", "inertia"),
    "loft": (),  # share of the vertical impulse that the plate does not hold back
    "rebound": (),  # the plate's restitution
    # sliding: mu; the load on the plate over the mass, m/s^2; the torque about the vertical, as dwz/dt
    "friction": ("slip_speed", "slip", "position", "velocity", "spin", "radius", "of_a"),
    "normal_load": ("gravity", "position", "velocity", "of_a"),
    "drilling": ("spin", "slip_speed", "friction", "load", "radius", "of_a"),  # of the friction with all effects
    # rolling loss, m/s^2 against the motion
    "rolling": ("speed", "position", "velocity", "gravity", "radius", "of_a"),
    # force over mass on the centre, m/s^2
    "push": ("position", "velocity", "gravity", "radius", "mass", "of_a", "other", "ball"),
    # the picture: the true camera; the true time of a moment of the film; how long the shutter was open
    "camera": (),
    "clock": ("fps", "row"),
    "exposure": ("fps",),
    # a defect of the tracker, which a scene cannot have: the measured position of a centre that is at (x, y) px. Two
    # inputs are functions of such pixels. "glint" gives the position of the glint; "mirrored" gives it for a lamp at
    # (x, y, z) m, or the pixels themselves where camera.json has a lamp
    "measure": ("glint", "mirrored"),
}
VECTOR_INPUTS = {"slip", "position", "velocity", "other", "glint", "mirrored"}  # inputs that are vectors


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
    meaning: tuple[str, str] = ("", ""),
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
        A shape parameter, meaningless while the strengths are zero: a search scans it. All others are strengths: the
        effect is absent when every one of them is zero.
    given : bool
        A shape parameter that tracks cannot separate from the others: a search does not change it.
    default : float, optional
        Default: `typical` for a shape parameter, 0 for a strength.
    tries : iterable of float
        Values of a shape parameter at which a search starts, close enough together to miss nothing; default: a few
        about `typical`.
    meaning : tuple of str
        In words, what a positive value of a strength means, and what a negative value means. "{}" stands for its size,
        as in ("ball a is heavier by {}", "ball a is lighter by {}"). Reports write it where the sign is open to doubt.

    Returns
    -------
    dataclasses.Field
    """
    value = default if default is not None else (typical if fixed else 0.0)
    declared = {"unit": unit, "typical": typical, "low": low, "high": high, "fixed": fixed, "given": given}
    return field(default=value, metadata=declared | {"tries": tuple(map(float, tries)), "meaning": meaning})


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
    meaning: tuple[str, str] = ("", "")


@dataclass(frozen=True)
class Effect:
    """Base of all effects. A subclass holds parameters and the laws that it changes, in a file of its own name."""

    laws: ClassVar[dict[str, tuple[str, ...]]] = {}
    first: ClassVar[bool] = False  # whether it acts before all others

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.laws = {}
        for name, member in vars(cls).items():
            if name.startswith("_") or not inspect.isfunction(member):
                continue
            if name not in LAWS:
                raise PluginError(f"{cls.__name__}.{name}: no such law; there are {', '.join(LAWS)}")
            asks = tuple(inspect.signature(member).parameters)[2:]
            if unknown := [a for a in asks if a not in LAWS[name]]:
                allowed = f"{name} may ask for {', '.join(LAWS[name])}"
                raise PluginError(f"{cls.__name__}.{name} asks for {', '.join(unknown)}; {allowed}")
            cls.laws[name] = asks

    def __post_init__(self) -> None:
        for p in self.parameters():
            value = getattr(self, p.name)
            if not (math.isfinite(value) and p.low <= value <= p.high):
                allowed = f"expected a number from {p.low:g} to {p.high:g} {p.unit}"
                raise ValueError(f"{self.name()}.{p.name} = {value:g}: {allowed}")

    @classmethod
    def name(cls) -> str:
        """The name in YAML: that of the file."""
        return cls.__module__.rpartition(".")[2]

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return the parameters in the order of declaration."""
        return tuple(Parameter(name=f.name, default=f.default, **f.metadata) for f in fields(cls))  # type: ignore[arg-type]

    @classmethod
    def strengths(cls) -> tuple[Parameter, ...]:
        """Return the parameters that are zero when the effect is absent."""
        return tuple(p for p in cls.parameters() if not p.fixed)

    @classmethod
    def absent(cls) -> Self:
        """Return the effect with every strength zero and every shape parameter at its default."""
        return cls(**{p.name: 0.0 for p in cls.strengths()})

    @property
    def bends(self) -> Iterator[tuple[str, Callable[..., Any], tuple[str, ...]]]:
        """Each law that the effect changes, the method that changes it, and the inputs of that method."""
        return ((law, getattr(self, law), asks) for law, asks in self.laws.items())

    @property
    def active(self) -> bool:
        """False when every strength is exactly zero: results are then those without the effect, bit for bit."""
        return any(getattr(self, p.name) != 0.0 for p in self.strengths())


class ActiveLaws:
    """The laws of a model with its active effects: call it with a law, its value and the inputs of the instant."""

    def __init__(self, effects: Iterable[Effect]) -> None:
        active = sorted((e for e in effects if e.active), key=lambda e: (not e.first, e.name()))
        self._bends: dict[str, list[tuple[Callable[..., Any], tuple[str, ...]]]] = {law: [] for law in LAWS}
        for effect in active:
            for law, bend, asks in effect.bends:
                self._bends[law].append((bend, asks))
        self._bent = frozenset(law for law, bends in self._bends.items() if bends)

    def has_effect_on(self, *laws: str) -> bool:
        """Tell whether an active effect changes any of these laws."""
        return not self._bent.isdisjoint(laws)

    def inputs_of(self, law: str) -> set[str]:
        """Return the inputs that the active effects on `law` need."""
        return {what for _, asks in self._bends[law] for what in asks}

    def needs(self, law: str, what: str) -> bool:
        """Tell whether an active effect on `law` needs the input `what`."""
        return law in self._bent and any(what in asks for _, asks in self._bends[law])

    def __call__(self, law: str, value: Any, instant: Mapping[str, Any]) -> Any:
        """Return `value` after every effect on `law`; `instant` maps the inputs of LAWS[law] to their values."""
        for bend, asks in self._bends[law]:
            value = bend(value, *[instant[a] for a in asks])
        return value


def with_typical_values(kind: type[Effect]) -> Effect:
    """Make the effect with every parameter at its typical value."""
    return kind(**{p.name: p.typical for p in kind.parameters()})
