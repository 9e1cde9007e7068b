"""The values of a plan: limits of effects, indistinguishable pairs, and gains of changes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.data.launch import V0, B
from discrepancy.planning.compare import ChangeGain, ChangeLimits, CollisionsNeeded
from discrepancy.planning.experiment import SceneExperiment
from discrepancy.planning.limits import StrengthLimits

MIN_USEFUL_GAIN = 1.05  # a change that lowers limits by a smaller factor is not recommended


@dataclass(frozen=True)
class IndistinguishablePair:
    """Two indistinguishable effects, the cosine of their signatures, and the advice how to distinguish them."""

    effects: tuple[str, str]
    cosine: float
    advice: str


@dataclass(frozen=True)
class BestChange:
    """A change, in words, and a strength's limits with it."""

    words: str
    limit: float
    naming_limit: float


@dataclass(frozen=True)
class PlanResult:
    """The effects that an experiment could detect and name, and the changes that help."""

    name: str  # of the scene
    designed: SceneExperiment  # the collisions, and the errors that their positions would have
    limits: tuple[StrengthLimits, ...]  # of the requested effects
    pairs: tuple[IndistinguishablePair, ...]  # of effects that the experiment could not distinguish
    before: tuple[StrengthLimits, ...]  # of all effects, for the collisions that changes were applied to
    tried: tuple[ChangeLimits, ...]  # each change of these collisions, with the limits of all effects
    gains: tuple[ChangeGain, ...]  # of each change, the best first
    wanted: tuple[CollisionsNeeded, ...]

    @property
    def detectable(self) -> tuple[StrengthLimits, ...]:
        """The limits of the detectable strengths, the best first."""
        return tuple(sorted((x for x in self.limits if x.shows), key=lambda x: x.limit / x.typical))

    @property
    def undetectable(self) -> tuple[StrengthLimits, ...]:
        """The limits of the undetectable strengths."""
        return tuple(x for x in self.limits if not x.shows)

    def best_change(self, limit: StrengthLimits) -> BestChange | None:
        """The change that lowers a strength's naming limit most."""
        now = next((x for x in self.before if x.strength == limit.strength), None)
        then = ((t.words, x) for t in self.tried for x in t.limits if x.strength == limit.strength and x.shows)
        best = min(then, key=lambda pair: pair[1].naming_limit, default=None)
        if now is None or best is None or not math.isfinite(now.naming_limit):
            return None
        words, x = best
        falls = now.naming_limit / x.naming_limit
        if falls <= MIN_USEFUL_GAIN:
            return None
        return BestChange(words, limit.limit * x.limit / now.limit, limit.naming_limit / falls)

    def rows(self) -> list[dict[str, Any]]:
        """A row for each strength, as of `discrepancy.Plan.table`."""
        return [self._row(x) for x in (*self.detectable, *self.undetectable)]

    def _row(self, x: StrengthLimits) -> dict[str, Any]:
        rival, best = x.rivals[0] if x.rivals else None, self.best_change(x)
        return {
            "effect": x.effect,
            "strength": x.strength,
            "unit": x.unit,
            "typical": x.typical,
            "shapes": x.shapes,
            "limit": x.limit,
            "limit_over_shapes": [x.best, x.worst],
            "limit_over_draws": list(x.scatter),
            "naming_limit": x.naming_limit,
            "shows": x.shows,
            "rival": rival.effect if rival else None,
            "cosine": rival.cosine if rival else math.nan,
            "alike": list(x.indistinguishable),
            "best_change": best.words if best else None,
            "limit_then": best.limit if best else math.nan,
            "naming_then": best.naming_limit if best else math.nan,
        }

    @property
    def error_um(self) -> float:
        """Error of a position, rms, each axis, um."""
        return 1e6 * self.designed.experiment.error_px * self.designed.experiment.camera.scale

    def sentence(self) -> str:
        """The plan in a sentence or two: how many effects it detects, and the most useful change."""
        here = self.designed
        effects = {x.effect for x in self.limits}
        shows = {x.effect for x in self.detectable if x.limit <= x.typical}
        text = (
            f"{here.drawn} collisions of {self.name}, positions to {here.experiment.error_px:.2g} px "
            f"({self.error_um:.2g} um): {len(shows)} of {len(effects)} effects would be detected at a realistic size"
        )
        alike = f"; {len(self.pairs)} pairs could not be distinguished."
        text += alike if self.pairs else ", each distinguishable from all."
        useful = [g for g in self.gains if g.naming > MIN_USEFUL_GAIN]
        if useful:
            text += f" The best change: {useful[0].words}; naming limits fall by a factor of {useful[0].naming:.2g}."
        return text

    def experiment(self) -> dict[str, Any]:
        """The planned experiment in numbers."""
        here, speeds = self.designed, self.designed.experiment.launches[:, V0]
        camera = here.experiment.camera
        return {
            "scene": self.name,
            "clips": {"recorded": here.drawn, "usable": here.usable, "fitted": len(here.experiment.clips)},
            "v0": [float(speeds.min()), float(speeds.max())],
            "b": float(np.abs(here.experiment.launches[:, B]).max()),
            "fps": camera.fps,
            "exposure": camera.exposure,
            "scale": camera.scale,
            "error_px": here.experiment.error_px,
            "error_um": self.error_um,
            "fitted": list(here.experiment.names),
            "notes": list(here.notes),
        }
