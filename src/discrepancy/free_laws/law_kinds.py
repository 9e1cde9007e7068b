"""Define a free law: a law of the model that a search leaves free as a smooth curve or map, instead of a formula.

`laws/table.py` lists most laws. Each is an instance of one of these kinds:

- `MotionLaw` acts all along the motion, as friction does.
- `ImpactLaw` acts once in each collision, as restitution does.
- `ClipNumber` is a number of its own for each clip.
- A subclass of `FreeLaw` brings its own derivatives (`laws/lag_speed.py`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.jacobian import differentiate_tracks
from discrepancy.fitting.predict import predict_tracks
from discrepancy.fitting.response import ResponseSegment, compute_responses
from discrepancy.free_laws.ranges import Axis, CoveredRanges, over_clips
from synthcam.effect import LAWS, VECTOR_INPUTS
from synthcam.model import Model
from synthcam.tabulated_law import REFERENCE_SPEED_M_S, AddedLaw, TabulatedLaw
from synthcam_shared.arrays import Array
from synthcam_shared.errors import PluginError


@dataclass(frozen=True)
class FreeLaw(ABC):
    """A law as a series over one or two axes, of both balls or of one ball.

    Raises PluginError where `bends` names an unknown law or argument, or the kind of law needs something that is
    missing.
    """

    base_name: str  # the law and what it depends on: "friction_speed"
    description: str  # the same in words
    symbol: str  # for formulas and figures, as is the unit
    _: KW_ONLY
    # Takes the ranges that the tracks cover, and returns the law's axes. There is one for a curve, two for a map, and
    # none where the tracks cover nothing of it.
    over: Callable[[CoveredRanges], tuple[Axis, ...]] = field(repr=False)
    unit: str = "1"
    # The law that it changes and the argument that it depends on, both as in `synthcam.effect.LAWS`. None for a law
    # that no effect can express.
    bends: tuple[str, str] | None = None
    # The base parameters that make the law, each times the axis to a power. The series adds to them.
    owners: tuple[tuple[str, int], ...] = ()
    # The components of a vector, or the terms of a law that is a sum of two; one empty name for a plain number.
    part_names: tuple[str, ...] = ("",)
    # The series has mean zero over its range, since launches or base parameters absorb a constant.
    centred: bool = False
    one_ball: bool = False  # a search also tries it for ball a alone and for ball b alone
    frees: str = ""  # the parameter that a model can declare free instead, so that every fit has these numbers
    axes: tuple[Axis, ...] = ()  # empty until `library.free_laws_over` sets them
    ball: str = ""  # "a" or "b" for a law of one ball

    def __post_init__(self) -> None:
        law, what = self.bends or ("", "")
        if law and law not in LAWS:
            raise PluginError(f"free law {self.base_name}: bends {law!r}; expected one of {', '.join(LAWS)}")
        if what and what not in LAWS[law]:
            known = ", ".join(LAWS[law]) or "nothing"
            raise PluginError(f"free law {self.base_name}: bends {law} by {what!r}; {law} depends on {known}")

    @abstractmethod
    def derivatives(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        """Differentiate tracks by the coefficients, (n_k, 2, size) a clip; the model may hold the law already."""

    @property
    def name(self) -> str:
        """The base name, with the ball where it is a law of one ball: "friction_speed_a"."""
        return self.base_name + (f"_{self.ball}" if self.ball else "")

    @property
    def title(self) -> str:
        """The symbol, with the ball where it is a law of one ball."""
        return self.symbol + (f" of ball {self.ball}" if self.ball else "")

    @property
    def parts(self) -> int:
        """How many components or terms it has, 1 or 2."""
        return len(self.part_names)

    @property
    def has_speed_term(self) -> bool:
        """True for a rolling loss of a constant term and a term proportional to the speed."""
        return self.parts == 2 and self.bends is not None and self.bends[0] == "rolling"

    @property
    def is_per_clip(self) -> bool:
        """True for a number for each clip."""
        return self.axes[0].kind == "set"

    @property
    def size(self) -> int:
        """The number of coefficients. Those of the second part follow those of the first."""
        return self.parts * int(np.prod([a.count for a in self.axes]))

    def grid(self, count: int, side: int) -> tuple[Array, ...]:
        """Coordinates (n,) for each axis, of `count` points on a line, or of `side` x `side` points of a map."""
        if len(self.axes) == 1:
            return (self.axes[0].grid(count),)
        return tuple(x.ravel() for x in np.meshgrid(*(a.grid(side) for a in self.axes), indexing="ij"))

    @cached_property
    def _mean_of_basis(self) -> Array | float:
        """The mean of each term of a centred series over its range, (coefficients of one part,); 0 for others."""
        if not self.centred:
            return 0.0
        means = [a.basis(a.grid(200)).mean(axis=0) for a in self.axes]  # 200 points: exact enough for 20 cosines
        return np.asarray(means[0] if len(means) == 1 else np.outer(*means).ravel())

    def basis(self, *x: Any) -> Array:
        """Evaluate the terms of the series, (..., coefficients of one part), at x, one array for each axis."""
        if len(self.axes) == 1:
            return self.axes[0].basis(x[0]) - self._mean_of_basis
        first, second = (a.basis(v) for a, v in zip(self.axes, x, strict=True))
        products = first[..., :, None] * second[..., None, :]
        return np.asarray(products.reshape(*first.shape[:-1], -1)) - self._mean_of_basis

    def values(self, coefs: Array, *x: Any) -> Array:
        """Evaluate what the series adds to the law: (...), or (..., 2) for two parts."""
        parts = np.reshape(coefs, (self.parts, -1))
        if len(self.axes) == 2:
            first, second = (a.basis(v) for a, v in zip(self.axes, x, strict=True))
            grid = parts.reshape(self.parts, self.axes[0].count, -1)
            out = np.einsum("...pj,...j->...p", np.tensordot(first, grid, (-1, 1)), second)
        else:
            out = self.axes[0].basis(x[0]) @ parts.T
        if self.centred:
            out = out - parts @ self._mean_of_basis
        return np.asarray(out[..., 0] if self.parts == 1 else out)

    def value_in_model(self, model: Model, *x: Any) -> Array:
        """Evaluate the law as the model has it, (n, parts): base parameters, and a table of this law if it has one."""
        out = np.zeros((len(x[0]), self.parts))
        for name, power in self.owners:
            out += (model.value(name) * x[0] ** power)[:, None]
        for effect in model.effects:
            if isinstance(effect, TabulatedLaw) and effect.law == self.name:
                out += effect.beyond(*x).reshape(out.shape)
        return out

    def prior_variances(self, *lengths: float) -> Array:
        """Prior variances of all coefficients, (size,), for one length of change, or one for each axis."""
        out = np.ones(1)
        for axis, length in zip(self.axes, lengths * (len(self.axes) // len(lengths)), strict=True):
            out = np.outer(out, axis.prior_variances(length)).ravel()
        return np.tile(out, self.parts)

    def coordinates(self, what: Any) -> tuple[Array, ...]:
        """Map what the law depends on, (...) or a vector (..., 2), to its axes: (...) for each.

        A vector gives its two components on two axes, its direction on a circle and its length on a line. A subclass
        whose axis is something else overrides this.
        """
        if len(self.axes) == 2:
            return what[..., 0], what[..., 1]
        if self.axes[0].kind == "circle":
            return (np.asarray(np.arctan2(what[..., 1], what[..., 0])),)
        is_vector = self.bends is not None and self.bends[1] in VECTOR_INPUTS
        return (np.asarray(np.hypot(what[..., 0], what[..., 1])) if is_vector else what,)

    def factors(self, what: Any, speed: Any) -> Array | None:
        """The factor of each part, as for the tables of a model (`synthcam.tabulated_law.Kind.parts`).

        - Of a force, (..., 2, parts): the unit vectors of a map; over an angle, the velocity and its normal, so that a
          ball at rest feels none; else the direction of motion.
        - Of a rolling loss of two terms, (..., parts): 1 and the speed over REFERENCE_SPEED_M_S.
        - None for any other law.
        """
        if self.has_speed_term:
            return np.stack([np.ones_like(speed), speed / REFERENCE_SPEED_M_S], axis=-1)
        if self.bends is None or self.bends[0] != "push":
            return None
        if len(self.axes) == 2:
            return np.broadcast_to(np.eye(2), (*what.shape, 2))
        if self.axes[0].kind == "circle":
            return np.stack([what, np.stack([-what[..., 1], what[..., 0]], axis=-1)], axis=-1)
        size = np.maximum(np.hypot(what[..., 0], what[..., 1]), 1e-9)
        return np.asarray((what / size[..., None])[..., None])

    def subtract_from(
        self, clips: Sequence[MeasuredCollision], model: Model, launches: Array, coefs: Array
    ) -> list[MeasuredCollision]:
        """Subtract from the tracks what the law moves them by, if no effect can express it; else return them as is."""
        if self.bends or not np.any(coefs):
            return list(clips)
        moved = self._displacements(clips, model, launches, coefs)
        return [replace(c, xy=c.xy - m) for c, m in zip(clips, moved, strict=True)]

    def _displacements(
        self, clips: Sequence[MeasuredCollision], model: Model, launches: Array, coefs: Array
    ) -> list[Array]:
        """By how much the law moves the tracks, (n_k, 2) for each clip."""
        return [m @ coefs for m in self.derivatives(model, launches, clips)]

    def add_to(self, model: Model, coefs: Array) -> Model:
        """The model with the law as an effect; unchanged if no effect can express it."""
        if not self.bends:
            return model
        others = tuple(e for e in model.effects if not (isinstance(e, SeriesEffect) and e.law.name == self.name))
        return replace(model, effects=(*others, SeriesEffect(self, tuple(np.asarray(coefs, dtype=float).tolist()))))


@dataclass(frozen=True)
class MotionLaw(FreeLaw):
    """A law that acts all along the motion. Its derivatives are integrals over the motion (`fitting.response`)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.bends:
            expected = 'expected a law, as bends=("friction", "slip_speed")'
            raise PluginError(f"free law {self.base_name}: no bends; {expected}")

    def derivatives(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        assert self.bends
        law, name = self.bends

        def change(leg: ResponseSegment) -> Array:
            what = leg.place if name == "position" else getattr(leg, name)
            weights = self.basis(*self.coordinates(what))
            factors = self.factors(what, leg.speed)
            if factors is None:
                return weights
            weights = weights[..., None, :] if law == "push" else weights
            return np.concatenate([factors[..., p, None] * weights for p in range(self.parts)], axis=-1)

        moves = compute_responses(model, launches, clips, {law: change}, self.size)
        if not self.ball:
            return moves
        mine = [c.ball == int(c.striker == self.ball) for c in clips]  # a law of one ball does not move the other
        return [np.where(own[:, None, None], m, 0.0) for own, m in zip(mine, moves, strict=True)]


@dataclass(frozen=True)
class ImpactLaw(FreeLaw):
    """A law of one base parameter that acts once in each collision. Its derivatives are those by that parameter.

    at_impact: takes launches (clips, p) and returns each collision's coordinate on the axis, (clips,). A rolling
    striker meets the other ball at its own speed.
    """

    _: KW_ONLY
    at_impact: Callable[[Array], Array] = field(repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.owners) != 1:
            raise PluginError(
                f'free law {self.base_name}: expected one base parameter, as owners=(("restitution", 0),); '
                f"found {len(self.owners)}"
            )

    def derivatives(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        slopes = differentiate_tracks(model, launches, clips, self.owners[0][0])
        weights = self.basis(self.at_impact(launches))
        return [s[..., None] * w for s, w in zip(slopes, weights, strict=True)]


@dataclass(frozen=True)
class ClipNumber(ImpactLaw):
    """A value of one base parameter for each clip. No effect can express it, since all clips share one model."""

    _: KW_ONLY
    over: Callable[..., tuple[Axis, ...]] = field(default=lambda covered: over_clips(len(covered.clips)), repr=False)
    at_impact: Callable[..., Array] = field(default=lambda launches: np.arange(len(launches), dtype=float), repr=False)

    def _displacements(
        self, clips: Sequence[MeasuredCollision], model: Model, launches: Array, coefs: Array
    ) -> list[Array]:
        owner, moved = self.owners[0][0], []
        for k, (clip, here) in enumerate(zip(clips, predict_tracks(model, launches, clips), strict=True)):
            own, start = self.basis(np.array(k)) @ coefs, launches[k : k + 1]
            changed = predict_tracks(model.replace({owner: model.value(owner) + float(own)}), start, [clip])
            moved.append(changed[0] - here)
        return moved


@dataclass(frozen=True)
class SeriesEffect(AddedLaw):
    """A free law with its coefficients as an effect. It has no parameters, and no file holds it in this form."""

    law: FreeLaw
    coefs: tuple[float, ...]

    @classmethod
    def name(cls) -> str:
        return "series"

    @property
    def active(self) -> bool:
        return any(self.coefs)

    @property
    def target(self) -> tuple[str, str, str] | None:
        return (*self.law.bends, self.law.ball) if self.law.bends else None

    def _addition(self, what: Any, speed: Any) -> Array:
        out = self.law.values(np.array(self.coefs), *self.law.coordinates(what))
        factors = self.law.factors(what, speed)
        if factors is None:
            return out
        parts = out if self.law.parts > 1 else out[..., None]
        push = self.law.bends is not None and self.law.bends[0] == "push"
        return np.asarray((factors * (parts[..., None, :] if push else parts)).sum(axis=-1))
