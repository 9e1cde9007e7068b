"""The model: a ball, the numbers of the base model, the effects on top; YAML <-> object."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import yaml
from pydantic import ConfigDict, Field, create_model, model_validator

from synthcam.effect import ActiveLaws, Effect
from synthcam.library import cache_until_effects_change, library
from synthcam.settings import read_yaml
from synthcam.tabulated_law import SEARCH_ONLY_LAWS, TabulatedLaw, kind_of, table_names
from synthcam_shared.arguments import check_arguments
from synthcam_shared.arrays import Array, Flags
from synthcam_shared.errors import InputError
from synthcam_shared.settings import Fraction, Positive, Settings, build_settings, did_you_mean

SOLID_BALL = 0.4  # I/(m R^2)
Body = tuple[Any, Any, Any]  # radius, m, mass, kg, and I/(m R^2)


class BallSettings(Settings):
    """`ball:` the paper's steel ball."""

    diameter: Positive = 2.38e-3
    density: Positive = 7800.0


MAX_FRICTION = 100.0  # coefficient of sliding friction; soft rubber has about 4

# The symbols of the literature, under which truth and results list three numbers of the base model.
SYMBOLS = {"r": "restitution", "mu_k": "sliding_friction", "C": "spin_transfer"}


def _list_symbols(schema: dict[str, Any]) -> None:
    """Add the symbols to the JSON Schema, each as another name of its parameter."""
    for symbol, name in SYMBOLS.items():
        rule = schema["properties"][name]
        rule["description"] = f"{symbol} in truth and results; a scene may use either name"
        schema["properties"][symbol] = {k: v for k, v in rule.items() if k != "default"} | {
            "title": symbol,
            "description": f"another name of {name}",
        }


class ModelSettings(Settings):
    """`model:` the paper's numbers; r, mu_k and C are other names of the three that SYMBOLS lists."""

    model_config = ConfigDict(json_schema_extra=_list_symbols)

    gravity: Annotated[float, Field(ge=1e-3, le=1e5)] = 9.81  # from asteroids to centrifuges
    restitution: Fraction = 0.903
    sliding_friction: Annotated[float, Field(gt=0, le=MAX_FRICTION)] = 0.232
    spin_transfer: Annotated[float, Field(ge=0, le=5 / 7)] = 0.347  # more would make energy
    rolling_drag: Annotated[float, Field(ge=0, le=1e4)] = 0.135
    rolling_decel: Annotated[float, Field(ge=0, le=1e5)] = 0.0103


class ModelFileSettings(ModelSettings):
    """A model file's `model:`; what a search is to discover may be zero."""

    sliding_friction: Annotated[float, Field(ge=0, le=MAX_FRICTION)] = 0.232


@cache_until_effects_change
def effect_settings() -> type[Settings]:
    """Define the key `effects:` of a model: a key for each effect of the library, its parameters below it."""
    kinds: dict[str, Any] = {}
    for name, effect in library().items():
        numbers: dict[str, Any] = {}
        for p in effect.parameters():
            limits: Any = {k: v for k, v in (("ge", p.low), ("le", p.high)) if math.isfinite(v)}
            numbers[p.name] = (Annotated[float, Field(**limits, description=f"{p.unit}")], p.default)
        settings = create_model(f"{effect.__name__}Settings", __base__=Settings, **numbers)
        kinds[name] = (settings | None, None)
    return create_model("EffectSettings", __base__=Settings, __doc__="`effects:` the library.", **kinds)


class TableSettings(Settings):
    """A law as a table; `docs/format.md` says what each is of."""

    x: list[float] | list[list[float]]
    y: list[float] | list[list[float]]
    law: ClassVar[str]

    @model_validator(mode="after")
    def _possible(self) -> Self:
        owners = dict.fromkeys((name for name, _ in kind_of(self.law)[0].owners), 0.0)
        TabulatedLaw.of(self.law, self.x, self.y, owners)
        return self


@cache
def table_settings() -> type[Settings]:
    """Define the key `free_laws:` of a model: a key for each law that it may hold as a table."""
    kinds: dict[str, Any] = {}
    for name in table_names():
        kind, ball = kind_of(name)
        about = f"{kind.law}, {kind.unit}, of {kind.what}, {kind.x_unit}{f', of ball {ball}' if ball else ''}"
        settings = create_model(f"{name}_table", __base__=TableSettings, __doc__=about)
        settings.law = name
        kinds[name] = (settings | None, None)
    return create_model("FreeLawSettings", __base__=Settings, __doc__="`free_laws:` laws as tables.", **kinds)


@dataclass(frozen=True)
class Ball:
    """A solid sphere; by default the paper's steel ball.

    Attributes
    ----------
    diameter : float
        m.
    density : float
        kg/m^3.

    Examples
    --------
    >>> import synthcam
    >>> round(1e6 * synthcam.Ball().mass, 2)
    55.06
    """

    diameter: float = 2.38e-3
    density: float = 7800.0

    @property
    def radius(self) -> float:
        """m."""
        return self.diameter / 2

    @property
    def mass(self) -> float:
        """kg."""
        return self.density * math.pi * self.diameter**3 / 6


@dataclass(frozen=True)
class Bodies:
    """Balls in a row: radius (n,) m, mass (n,) kg, of_a (n,): 1 for the experimenter's ball a, 0 for ball b.

    inertia: I/(m R^2), (n,); 2/5 of solid balls. base: friction and rolling loss of each, (n,) by their names in
    `Model`, where they differ from the model's.
    """

    radius: Array
    mass: Array
    of_a: Array
    inertia: Array
    base: Mapping[str, Array] = field(default_factory=dict)

    @property
    def labels(self) -> tuple[str, ...]:
        """a or b, for each body."""
        return tuple("a" if of_a else "b" for of_a in self.of_a)

    def __getitem__(self, which: Any) -> Bodies:
        base = {name: values[which] for name, values in self.base.items()}
        return Bodies(self.radius[which], self.mass[which], self.of_a[which], self.inertia[which], base)

    @classmethod
    def join(cls, *parts: Bodies) -> Bodies:
        base = {name: np.concatenate([p.base[name] for p in parts]) for name in parts[0].base}
        names = "radius", "mass", "of_a", "inertia"
        radius, mass, of_a, inertia = (np.concatenate([getattr(p, name) for p in parts]) for name in names)
        return cls(radius, mass, of_a, inertia, base)

    def base_value(self, model: Model, name: str) -> Any:
        """A parameter of the base model, by its name there: one number for all, or (n,) where `base` has it."""
        return self.base.get(name, getattr(model, name))


@dataclass(frozen=True)
class Model:
    """Everything that decides how balls move: the base model's numbers, by default the paper's, and effects on top.

    Attributes
    ----------
    ball : Ball
    gravity : float
        m/s^2.
    restitution, sliding_friction, spin_transfer : float
        r, mu_k and C.
    rolling_drag, rolling_decel : float
        Rolling loss, drag v + decel: 1/s and m/s^2.
    effects : tuple of Effect
        With the laws that are tables, `free_laws` of a file, among them.
    free : tuple of str
        What a fit may change, by dotted name: "restitution", "plate_tilt.x".

    References
    ----------
    Painter & Behringer, Phys. Rev. E 62 (2000) 2380.

    Examples
    --------
    >>> import synthcam
    >>> model = synthcam.Model().replace({"restitution": 0.95, "plate_tilt.x": 1e-3})
    >>> model.value("plate_tilt.x"), model.value("plate_tilt.y")
    (0.001, 0.0)
    """

    ball: Ball = field(default_factory=Ball)
    gravity: float = 9.81
    restitution: float = 0.903
    sliding_friction: float = 0.232
    spin_transfer: float = 0.347
    rolling_drag: float = 0.135
    rolling_decel: float = 0.0103
    effects: tuple[Effect, ...] = ()
    free: tuple[str, ...] = ()

    @classmethod
    @check_arguments
    def read(cls, path: str | Path) -> Model:
        """Read a model file, or a scene whose physics are numbers; scenes that come with synthcam by name.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Model

        Raises
        ------
        InputError
            One line, with file and key.

        Examples
        --------
        >>> import synthcam
        >>> synthcam.Model.read("painter_behringer").restitution
        0.903
        """
        return read_model(Path(path))

    def write(self, path: str | Path) -> None:
        """Write a model file that `read` gives back and ``synthcam generate`` takes.

        Parameters
        ----------
        path : str or Path
        """
        write_model(self, Path(path))

    @cached_property
    def laws(self) -> ActiveLaws:
        """The laws with the active effects applied."""
        return ActiveLaws(self.effects)

    def bodies(self, labels: Sequence[str]) -> Bodies:
        """Radii and masses of balls, with the active effects on them.

        Parameters
        ----------
        labels : sequence of {"a", "b"}

        Returns
        -------
        Bodies
            In the order of `labels`.
        """
        return self.bodies_where(np.array([label == "a" for label in labels], dtype=bool))

    def bodies_where(self, is_a: Flags) -> Bodies:
        """Radii and masses of balls a and b, as `bodies` gives them, for many balls quickly.

        Parameters
        ----------
        is_a : array of bool
            True for balls a, false for balls b.

        Returns
        -------
        Bodies
            In the order of `is_a`.
        """
        a = self.laws("radius", self.ball.radius, {}), self.laws("mass", self.ball.mass, {})
        b = self.ball.radius, self.ball.mass
        radius, mass = (np.where(is_a, x, y) for x, y in zip(a, b, strict=True))
        return Bodies(radius, mass, is_a.astype(float), np.full(len(is_a), SOLID_BALL))

    def value(self, name: str) -> float:
        """The value of a parameter.

        Parameters
        ----------
        name : str
            Dotted: "restitution" or "r", "plate_tilt.x".

        Returns
        -------
        float
            Of an effect that is not in the model: 0 for a strength, its default for a shape parameter.
        """
        effect, dot, parameter = name.rpartition(".")
        if not dot:
            return float(getattr(self, SYMBOLS.get(name, name)))
        present = next((e for e in self.effects if e.name() == effect), None) or library()[effect].absent()
        return float(getattr(present, parameter))

    def replace(self, values: Mapping[str, float]) -> Model:
        """A copy with other values.

        Parameters
        ----------
        values : dict
            By dotted name. An effect that is not in the model is added.

        Returns
        -------
        Model
        """
        base = {SYMBOLS.get(k, k): v for k, v in values.items() if "." not in k}
        effects = {e.name(): e for e in self.effects}
        for name, value in values.items():
            effect, dot, parameter = name.rpartition(".")
            if dot:
                here = effects.get(effect) or library()[effect].absent()
                effects[effect] = dataclasses.replace(here, **{parameter: value})
        return dataclasses.replace(self, effects=tuple(effects.values()), **base)  # type: ignore[arg-type]


BASE_PARAMETERS = tuple(ModelSettings.model_fields)
LAUNCH_SPIN = "launch.spin"  # what `free` may hold beside parameters: the spin about the vertical of each launch


def build_model(settings: Mapping[str, Any], free: tuple[str, ...] = ()) -> Model:
    """Build the model of checked plain settings with the keys ball, model, effects and free_laws."""

    def given(section: str) -> dict[str, Any]:
        return {name: values for name, values in (settings.get(section) or {}).items() if values is not None}

    effects = tuple(library()[name](**values) for name, values in given("effects").items())
    numbers = settings["model"]
    tables = tuple(TabulatedLaw.of(name, v["x"], v["y"], numbers) for name, v in given("free_laws").items())
    return Model(ball=Ball(**settings["ball"]), effects=(*effects, *tables), free=free, **settings["model"])


def list_model_settings(model: Model) -> dict[str, Any]:
    """Return the plain settings of a model: ball, model, effects (and free_laws and free, when there are any)."""
    numbers = {k: getattr(model, k) for k in BASE_PARAMETERS}
    plain: dict[str, Any] = {
        "ball": dataclasses.asdict(model.ball),
        "model": numbers,
        "effects": {e.name(): dataclasses.asdict(e) for e in model.effects if not isinstance(e, TabulatedLaw)},
    }
    tables = {e.law: e.to_settings(numbers) for e in model.effects if isinstance(e, TabulatedLaw)}
    return plain | ({"free_laws": tables} if tables else {}) | ({"free": list(model.free)} if model.free else {})


@cache_until_effects_change
def model_file() -> type[Settings]:
    """Define a model file: a scene's ball, model, effects and free laws, and `free`."""
    return create_model(
        "ModelFile",
        __base__=Settings,
        ball=(BallSettings, BallSettings()),
        model=(ModelFileSettings, ModelFileSettings()),
        effects=(effect_settings(), effect_settings()()),
        free_laws=(table_settings(), table_settings()()),
        free=(list[str], []),
    )


def resolve_symbols(loaded: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Give r, mu_k and C in the settings of a model, `model` and `free`, their long names.

    Raises InputError where a number is given under both names.
    """
    out = dict(loaded)
    numbers = out.get("model")
    if isinstance(numbers, Mapping):
        for symbol, name in SYMBOLS.items():
            if symbol in numbers and name in numbers:
                raise InputError(f"{where}: model.{symbol}: the same number as model.{name}; give one of the two")
        out["model"] = {SYMBOLS.get(key, key): value for key, value in numbers.items()}
    if isinstance(out.get("free"), list):
        out["free"] = [SYMBOLS.get(name, name) if isinstance(name, str) else name for name in out["free"]]
    return out


def refuse_search_only_laws(free_laws: Any, where: str) -> None:
    """Refuse settings with a free law that no model can hold: raise InputError, which says why."""
    for name in free_laws if isinstance(free_laws, Mapping) else ():
        if why := SEARCH_ONLY_LAWS.get(str(name)):
            raise InputError(f"{where}: free_laws.{name}: {why}")


def check_free(names: Iterable[str], where: str) -> tuple[str, ...]:
    """Check the names in a model's `free`. Raises InputError unless each is LAUNCH_SPIN or a parameter."""
    names = tuple(names)
    if not names:
        return ()
    known = {*BASE_PARAMETERS, LAUNCH_SPIN, *(f"{n}.{p.name}" for n, e in library().items() for p in e.parameters())}
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError(f"{where}: free: {name} is given twice; expected each parameter once")
        if name not in known:
            near = did_you_mean(name, known) or f"; there are {', '.join(sorted(known))}"
            raise InputError(f"{where}: free: {name} is no parameter{near}")
    return names


def read_model(path: Path) -> Model:
    """Read a model file. A scene's other keys are ignored: a scene whose physics are numbers is a model too.

    Raises InputError.
    """
    loaded = read_yaml(path)
    if not loaded:
        raise InputError(f"{path}: empty; expected a model: ball, model or effects (`model: {{}}` for all defaults)")
    sections = model_file().model_fields
    for key in (k for k in loaded if k not in (*sections, "name")):
        near = did_you_mean(str(key), sections)
        if near or not isinstance(loaded[key], dict | None):  # else a section of a scene
            raise InputError(f"{path}: {key}: unknown key{near}; expected a model or a scene")
    return _validate(loaded, str(path))


def _validate(loaded: Mapping[str, Any], where: str) -> Model:
    known = {k: v for k, v in resolve_symbols(loaded, where).items() if k in model_file().model_fields}
    refuse_search_only_laws(known.get("free_laws"), where)
    plain = build_settings(known, model_file(), where).model_dump()
    return build_model(plain, check_free(plain["free"], where))


def as_model(given: Model | Mapping[str, Any] | str | Path) -> Model:
    """Return a model, unchanged, or made from its settings or its file. Raises InputError."""
    if isinstance(given, Model):
        return given
    if isinstance(given, str | Path):
        return read_model(Path(given))
    if not isinstance(given, Mapping):
        raise InputError(f"model: of type {type(given).__name__}, expected a model, its settings, or a path")
    if unknown := [str(k) for k in given if k not in model_file().model_fields]:
        near = did_you_mean(unknown[0], model_file().model_fields)
        raise InputError(f"model: {unknown[0]}: unknown key{near}; there are {', '.join(model_file().model_fields)}")
    return _validate(given, "model")


def write_model(model: Model, path: Path) -> None:
    """Write a model file that `read_model` gives back and `synthcam generate` takes."""
    path.write_text(to_yaml(list_model_settings(model)), encoding="utf-8")


def to_yaml(settings: Mapping[str, Any]) -> str:
    """Write the settings of a model or a scene as the text of a YAML file."""
    return yaml.safe_dump(dict(settings), sort_keys=False, default_flow_style=None, width=120)


def without_mutual_push(model: Model) -> Model:
    """Return the model without the effects by which balls push each other."""
    return dataclasses.replace(model, effects=tuple(e for e in model.effects if "other" not in e.laws.get("push", ())))
