"""A free law: a law left free as a series over the range that the data cover, in place of a formula.

Each file of `laws` holds one, found by its being there. `MotionLaw` bends a law that acts all along the motion,
`ImpactLaw` one that is asked once a collision, `ClipNumber` gives each clip a number of its own; what is none of these
brings its own derivatives.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.jacobian import differentiate
from discrepancy.fitting.predict import predict_tracks
from discrepancy.fitting.response import ResponseSegment, compute_responses
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.ranges import CoveredRanges, over_clips
from synthcam.effect import LAWS, VECTOR_INPUTS
from synthcam.model import Model
from synthcam.tabulated_law import REFERENCE_SPEED_M_S, AddedLaw, TabulatedLaw
from synthcam_shared.errors import PluginError

MEAN = 200  # places on each axis, to take a mean over


@dataclass(frozen=True)
class FreeLaw(ABC):
    """A law left free over its axes (two for a map of places), of both balls alike or of one alone.

    Attributes
    ----------
    axes : tuple of Axis
        What it depends on, over the ranges that the tracks cover.
    ball : str
        "a" or "b" where the law is that of one ball alone.
    symbol, unit : str
        What it is, for people.
    parts : int
        2 for a vector, or for a law that is the sum of two.
    part_names : tuple of str
        For people; one empty name of a law of one part.
    owners : tuple of (str, int)
        The base parameters that make the law, each times the axis to a power; what the free law adds to.
    centred : bool
        A constant means nothing, since launches or base parameters absorb it, but for what their derivatives are wrong
        by: there is none.
    one_ball : bool
        Whether balls may differ in it: it is then left free for ball a and for ball b alone, too.
    bends : (str, str) or None
        The law that an effect of it bends, and what that depends on, as an effect asks for it; None where no effect can
        hold it.
    frees : str
        What a model may call free instead, so that every fit has these numbers.
    """

    axes: tuple[Axis, ...]
    ball: str = ""

    symbol: ClassVar[str]
    unit: ClassVar[str] = "1"
    parts: ClassVar[int] = 1
    part_names: ClassVar[tuple[str, ...]] = ("",)
    owners: ClassVar[tuple[tuple[str, int], ...]] = ()
    centred: ClassVar[bool] = False
    one_ball: ClassVar[bool] = False
    paced: ClassVar[bool] = False
    bends: ClassVar[tuple[str, str] | None] = None
    frees: ClassVar[str] = ""
    needs: ClassVar[dict[str, str]] = {"symbol": 'symbol = "mu"'}  # what a file must give, and an example

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if cls.__module__ == __name__:
            return  # the kinds of free laws, which leave this to the laws themselves
        for name, example in cls.needs.items():
            if not getattr(cls, name, None):
                raise PluginError(f"{cls.__module__}.{cls.__name__}: no {name}; expected it, as {example}")
        law, what = cls.bends or ("", "")
        if law and law not in LAWS:
            raise PluginError(f"{cls.__module__}.{cls.__name__}: bends {law!r}, expected one of {', '.join(LAWS)}")
        if what and what not in LAWS[law]:
            known = ", ".join(LAWS[law]) or "nothing"
            raise PluginError(f"{cls.__module__}.{cls.__name__}: bends {law} by {what!r}, which depends on {known}")

    def __post_init__(self) -> None:
        what = self.bends[1] if self.bends else ""
        straight = len(self.axes) == 1 and self.axes[0].kind == "line"
        if what in VECTOR_INPUTS and straight and type(self).places is FreeLaw.places:
            name = f"{type(self).__module__}.{type(self).__name__}"
            raise PluginError(
                f"{name}: one axis, but {what} is a vector; expected two axes, or places, which makes it one"
            )

    @staticmethod
    @abstractmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        """Its axes over what the tracks cover; none where they show nothing of it."""

    @abstractmethod
    def columns(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        """d forecast / d each coefficient, (n_k, 2, size) of each clip, about a model that may hold the law."""

    @property
    def name(self) -> str:
        """The name of its file, and of the ball that it is of."""
        return type(self).__module__.rpartition(".")[2] + (f"_{self.ball}" if self.ball else "")

    @property
    def ball_suffix(self) -> str:
        """ " of ball a", or nothing."""
        return f" of ball {self.ball}" if self.ball else ""

    @property
    def title(self) -> str:
        """Its symbol, and whose it is."""
        return self.symbol + self.ball_suffix

    @property
    def is_per_clip(self) -> bool:
        """Whether it is a number of each clip."""
        return self.axes[0].kind == "set"

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
        """What the series adds to the law: (...), or (..., 2) of two parts."""
        parts = np.reshape(coefs, (self.parts, -1))
        if len(self.axes) == 2:
            first, second = (a.basis(v) for a, v in zip(self.axes, x, strict=True))
            grid = parts.reshape(self.parts, self.axes[0].count, -1)
            out = np.einsum("...pj,...j->...p", np.tensordot(first, grid, (-1, 1)), second)
        else:
            out = self.axes[0].basis(x[0]) @ parts.T
        if self.centred:
            out = out - parts @ self._middle
        return np.asarray(out[..., 0] if self.parts == 1 else out)

    def value_in_model(self, model: Model, *x: Any) -> Array:
        """What the model has of the law at x already, (n, parts): its base parameters, and a table of this very law."""
        out = np.zeros((len(x[0]), self.parts))
        for name, power in self.owners:
            out += (model.value(name) * x[0] ** power)[:, None]
        for held in model.effects:
            if isinstance(held, TabulatedLaw) and held.law == self.name:
                out += held.beyond(*x).reshape(out.shape)
        return out

    def prior_variances(self, *lengths: float) -> Array:
        """Prior variances of all coefficients, (size,), of a law that changes over a length, or one of each axis."""
        out = np.ones(1)
        for axis, length in zip(self.axes, lengths * (len(self.axes) // len(lengths)), strict=True):
            out = np.outer(out, axis.prior_variances(length)).ravel()
        return np.tile(out, self.parts)

    def places(self, what: Any) -> tuple[Array, ...]:
        """Where on its axes an instant is: an array for each. what: what its law depends on, (...) or (..., 2)."""
        if len(self.axes) == 2:
            return what[..., 0], what[..., 1]
        return (np.asarray(np.arctan2(what[..., 1], what[..., 0])) if self.axes[0].kind == "circle" else what,)

    def factors(self, what: Any, speed: Any) -> Array | None:
        """What its parts are factors of: (..., parts) of a number, (..., 2, parts) of a force. None: of nothing."""
        return None

    def undone(
        self, clips: Sequence[MeasuredCollision], model: Model, launches: Array, coefs: Array
    ) -> list[MeasuredCollision]:
        """The clips less what the law moved in them, where no effect can hold it; else as they are."""
        if self.bends or not np.any(coefs):
            return list(clips)
        moved = self._moved(clips, model, launches, coefs)
        return [replace(c, xy=c.xy - m) for c, m in zip(clips, moved, strict=True)]

    def _moved(self, clips: Sequence[MeasuredCollision], model: Model, launches: Array, coefs: Array) -> list[Array]:
        """What the law moves the tracks by, (n_k, 2), where no effect can hold it."""
        return [m @ coefs for m in self.columns(model, launches, clips)]

    def bent(self, model: Model, coefs: Array) -> Model:
        """The model with the law, given its coefficients, as an effect; unchanged where no effect can hold it."""
        if not self.bends:
            return model
        others = tuple(e for e in model.effects if not (isinstance(e, SeriesEffect) and e.law.name == self.name))
        return replace(model, effects=(*others, SeriesEffect(self, tuple(np.asarray(coefs, dtype=float).tolist()))))


class MotionLaw(FreeLaw):
    """A law that acts all along the motion; its derivatives are integrals over the motion."""

    needs = FreeLaw.needs | {"bends": 'bends = ("friction", "slip_speed")'}

    def columns(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        assert self.bends
        law, name = self.bends

        def change(leg: ResponseSegment) -> Array:
            what = leg.place if name == "position" else getattr(leg, name)
            weights = self.basis(*self.places(what))
            factors = self.factors(what, leg.speed)
            if factors is None:
                return weights
            weights = weights[..., None, :] if law == "push" else weights
            return np.concatenate([factors[..., p, None] * weights for p in range(self.parts)], axis=-1)

        moves = compute_responses(model, launches, clips, {law: change}, self.size)
        if not self.ball:
            return moves
        mine = [c.ball == int(c.striker == self.ball) for c in clips]  # a law of one ball moves no other
        return [np.where(own[:, None, None], m, 0.0) for own, m in zip(mine, moves, strict=True)]


class PacedLaw(MotionLaw):
    """A rolling loss of two parts: a constant, and one proportional to the speed (its value at REFERENCE_SPEED_M_S)."""

    symbol = "added rolling loss"
    unit = "m/s^2"
    parts = 2
    part_names = ("constant", f"with the speed, at {REFERENCE_SPEED_M_S:g} m/s")
    centred = True
    paced = True

    def factors(self, what: Any, speed: Any) -> Array:
        return np.stack([np.ones_like(speed), speed / REFERENCE_SPEED_M_S], axis=-1)


class ImpactLaw(FreeLaw):
    """A law of its one owner that is asked once a collision; its derivatives are the owner's."""

    needs = FreeLaw.needs | {"owners": 'owners = (("restitution", 0),)'}

    @abstractmethod
    def at_impact(self, launches: Array) -> Array:
        """Where each clip's impact stands on the axis: (clips,). A ball that rolls in meets at its own speed."""

    def columns(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        slopes = differentiate(model, launches, clips, self.owners[0][0])
        weights = self.basis(self.at_impact(launches))
        return [s[..., None] * w for s, w in zip(slopes, weights, strict=True)]


class ClipNumber(ImpactLaw):
    """A number of its one owner for each clip. No effect can hold it, since a model is that of all clips."""

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_clips(len(covered.clips))

    def at_impact(self, launches: Array) -> Array:
        return np.arange(len(launches), dtype=float)

    def _moved(self, clips: Sequence[MeasuredCollision], model: Model, launches: Array, coefs: Array) -> list[Array]:
        owner, moved = self.owners[0][0], []
        for k, clip in enumerate(clips):
            own, start = self.basis(np.array(k)) @ coefs, launches[k : k + 1]
            bent = predict_tracks(model.replace({owner: model.value(owner) + float(own)}), start, [clip])
            moved.append(bent[0] - predict_tracks(model, start, [clip])[0])
        return moved


@dataclass(frozen=True)
class SeriesEffect(AddedLaw):
    """A free law with its coefficients as an effect: it has no parameters, and no file holds it in this form."""

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
        out = self.law.values(np.array(self.coefs), *self.law.places(what))
        factors = self.law.factors(what, speed)
        if factors is None:
            return out
        parts = out if self.law.parts > 1 else out[..., None]
        push = self.law.bends is not None and self.law.bends[0] == "push"
        return np.asarray((factors * (parts[..., None, :] if push else parts)).sum(axis=-1))
