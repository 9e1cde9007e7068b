"""Fisher information of an experiment: detection limits, and the similarity of effects.

The model is linear about the base model, with free launches and base parameters. An effect changes the tracks. The part
of this change that they cannot absorb, whitened by the true noise, is its signature. Its length is the expected |z|.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import find_free_launch_columns as launch_numbers
from discrepancy.fitting.predict import predict_tracks
from synthcam.effect import Effect
from synthcam.library import library
from synthcam.model import Model
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera

from . import outsiders

Array = NDArray[np.float64]

LIMIT = 5.0  # expected |z| at the detection limit
CLASS = 0.9  # of the cosine: beyond it two effects are a class
FREE = ("restitution", "sliding_friction", "spin_transfer", "rolling_drag", "rolling_decel")
NUDGES = np.array([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5])  # of a launch
SPUN = np.append(NUDGES, [1e-5, 1e-5, 1e-5])  # of one whose striker does not roll
PART = 5e-4  # of a signature's length: less is the second order, and rounding, of one that the base model absorbs
BENT = 8.0  # times the length at four times the strength: 4 of the first order, 16 of the second


@dataclass(frozen=True)
class Rows:
    """The measured rows of one collision: frame (n,), and ball (n,), 0 for the target."""

    striker: str
    camera: Camera
    frame: Any
    ball: Any
    launch: Array
    clip: int = 0


@dataclass(frozen=True)
class Noise:
    """Noise of one axis, m: std with correlation rho^lag in each ball, and shake, rho .9, common to both."""

    std: float
    rho: float = 0.0
    shake: float = 0.0

    def covariance(self, rows: Rows) -> Array:
        lag = np.abs(np.subtract.outer(rows.frame, rows.frame))
        own = np.equal.outer(rows.ball, rows.ball) * self.std**2 * np.where(lag == 0, 1.0, self.rho**lag)
        return np.asarray(own + self.shake**2 * 0.9**lag)


def predict_positions(model: Model, launches: Array, rows: Sequence[Rows]) -> list[Array]:
    """Positions of the balls at these rows, m: (n_k, 2). The search's forecast asks for no more than rows have."""
    return predict_tracks(model, launches, cast(Sequence[MeasuredCollision], rows))


class Fisher:
    """The design of a box: launches (n, 6) in `rows`, a base model, noise."""

    def __init__(self, model: Model, rows: Sequence[Rows], noise: Noise, each: Sequence[str] = ()) -> None:
        """each: base parameters that are another number in each clip."""
        self.model, self.rows = model, rows
        self._columns: dict[Effect, Array] = {}  # signatures, each of an effect with one small strength
        self.launches = np.array([r.launch for r in rows])
        self.roots = [np.linalg.inv(np.linalg.cholesky(noise.covariance(r))) for r in rows]
        self.plain = self._tracks(model)
        own = [self._slope(name) for name in each]
        slopes = [[*s, *(o[k] for o in own)] for k, s in enumerate(self._launch_slopes())]
        self.own = [np.linalg.qr(self._white(k, np.stack(s, axis=-1)))[0] for k, s in enumerate(slopes)]
        base = np.stack([self._cleaned(self._slope(name)) for name in FREE if name not in each], axis=-1)
        self.base = np.linalg.qr(base)[0]

    def _launch_slopes(self) -> list[list[Array]]:
        """Derivatives (n_k, 2) by the numbers of each clip's launch that are free."""
        nudges, n = SPUN[: self.launches.shape[1]], len(self.rows)
        free = launch_numbers(self.launches)
        out: list[list[Array]] = [[] for _ in range(n)]
        for j, nudge in enumerate(nudges):
            step = np.where(free[:, j], nudge, 0.0)[:, None] * np.eye(len(nudges))[j]
            ahead, behind = (predict_positions(self.model, self.launches + way * step, self.rows) for way in (1, -1))
            for k in np.flatnonzero(free[:, j]):
                out[k].append((ahead[k] - behind[k]) / (2 * nudge))
        return out

    @staticmethod
    def places(model: Model, rows: Sequence[Rows]) -> list[Array]:
        """Positions of the balls, m: (n_k, 2)."""
        return predict_positions(model, np.array([r.launch for r in rows]), rows)

    def _tracks(self, model: Model) -> list[Array]:
        """Places (n_k, 2) of every clip, with what an outsider does to one clip or to the picture."""
        places = self._places(model)
        if not any(hasattr(e, "_moved") for e in model.effects):
            return places
        out = []
        for r, xy in zip(self.rows, places, strict=True):
            velocity = np.zeros_like(xy)
            for b in (0, 1):
                velocity[r.ball == b] = np.gradient(xy[r.ball == b], axis=0) * r.camera.fps
            out.append(xy + outsiders.moved(model.effects, xy, velocity, (r.ball == 1) == (r.striker == "a")))
        return out

    def _places(self, model: Model) -> list[Array]:
        """Predict positions; clips with the same model are solved together."""
        alike: dict[Model, list[int]] = {}
        for k, r in enumerate(self.rows):
            alike.setdefault(outsiders.in_clip(model, r.clip, r.striker == "a", r.launch), []).append(k)
        out: dict[int, Array] = {}
        for own, which in alike.items():
            found = predict_positions(own, self.launches[which], [self.rows[k] for k in which])
            out |= dict(zip(which, found, strict=True))
        return [out[k] for k in range(len(self.rows))]

    def _white(self, k: int, columns: Array) -> Array:
        white = np.tensordot(self.roots[k], columns, axes=1)
        return np.asarray(white.reshape(-1, *columns.shape[2:]))

    def _cleaned(self, tracks: Sequence[Array]) -> Array:
        parts = []
        for k, own in enumerate(self.own):
            white = self._white(k, tracks[k])
            parts.append(white - own @ (own.T @ white))
        return np.concatenate(parts)

    def _slope(self, name: str) -> list[Array]:
        step = 1e-4 * max(abs(self.model.value(name)), 0.1)
        ahead = self._tracks(self.model.replace({name: self.model.value(name) + step}))
        return [(a - p) / step for a, p in zip(ahead, self.plain, strict=True)]

    def signature(self, model: Model) -> Array:
        """The change of the tracks by `model` from this base model, whitened, less all that is absorbed: (points,).

        Raises ValueError when that model has no motion for these launches.
        """
        raw = [a - p for a, p in zip(self._tracks(model), self.plain, strict=True)]
        cleaned = self._cleaned(raw)
        left = cleaned - self.base @ (self.base.T @ cleaned)
        whole = np.linalg.norm(np.concatenate([self._white(k, x) for k, x in enumerate(raw)]))
        return left if np.linalg.norm(left) > PART * whole else 0 * left

    def limit(self, hidden: Callable[[float], Model], first: float, most: float) -> float | None:
        """The strength seen with |z| = LIMIT; None beyond `most`, or where the base model absorbs it."""
        strength = first
        try:
            lengths = [float(np.linalg.norm(self.signature(hidden(part * first)))) for part in (0.25, 1.0)]
        except ValueError:
            return None
        if lengths[1] > BENT * lengths[0]:  # only the second order shows: a larger base parameter would hide that too
            return None
        for _ in range(4):
            try:
                length = float(np.linalg.norm(self.signature(hidden(strength))))
            except ValueError:
                return None
            if not length > 0:
                return None
            last, strength = strength, strength * LIMIT / length
            if strength > most:
                return None
            if abs(strength / last - 1) < 1e-3:
                break
        return strength

    def likeness(self, signature: Array, but: str, shapes: dict[str, float]) -> dict[str, float]:
        """|cos| of a signature with each other effect of the library, all its strengths free."""
        out = {}
        for name, effect in library().items():
            if name == but:
                continue
            columns = [self._along(effect, p.name, p.typical, shapes) for p in effect.strengths()]
            seen = [c / np.linalg.norm(c) for c in columns if np.any(c)]
            if seen:
                q = np.linalg.qr(np.stack(seen, axis=-1))[0]
                out[name] = float(np.linalg.norm(q.T @ signature) / np.linalg.norm(signature))
        return out

    def _along(self, effect: type[Effect], strength: str, scale: float, shapes: dict[str, float]) -> Array:
        """The signature of one strength of an effect; it is computed once for all effects that are compared with it."""
        own = {k.rpartition(".")[2]: v for k, v in shapes.items() if k.startswith(effect.name() + ".")}
        nudged = dataclasses.replace(effect.absent(), **own | {strength: 0.01 * scale})
        if nudged not in self._columns:
            try:
                column = self.signature(dataclasses.replace(self.model, effects=(*self.model.effects, nudged)))
            except (ValueError, InputError):  # no motion; or a camera file without a lamp
                column = np.zeros(1)
            self._columns[nudged] = column
        return self._columns[nudged]
