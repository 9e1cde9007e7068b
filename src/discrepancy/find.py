"""The whole workflow: measured tracks and a model -> where they disagree, what is missing, the gap before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from discrepancy.fit import BASE, fit
from discrepancy.gap import Shown, as_dict, show
from discrepancy.locate import Place, locate
from discrepancy.measured import Measured, split
from discrepancy.name import Search, search, strengths_of
from discrepancy.noise import Noise, estimate
from synthcam.effect import library
from synthcam.model import Model
from tracker.geometry import InputError

FEWEST = 6  # collisions: with fewer, some would not be left to show the gap on
UNEXPLAINED = 5.0  # sigma of disagreement left after the library: something outside it


@dataclass(frozen=True)
class Found:
    """The outcome. verdict: none, named, ambiguous or outside_library. where: before; left: after the named effects."""

    verdict: str
    noise: Noise
    clips: tuple[Measured, ...]
    kept_out: tuple[Measured, ...]
    search: Search
    where: tuple[Place, ...]
    left: tuple[Place, ...]
    shown: Shown

    @property
    def model(self) -> Model:
        """The model with the named effects, refitted."""
        return self.search.best.model

    def sentence(self) -> str:
        """The outcome in one sentence."""
        gap = self.shown.gap
        if self.verdict == "none":
            return "Nothing is missing: simulation and measurement agree to within the noise."
        if self.verdict == "outside_library":
            place = self.left[0]
            return (
                f"Something is missing that the library does not hold: {place.ball} {place.phase}, {place.observable} "
                f"its motion, disagrees by {place.sigma:.0f} sigma."
            )
        parts = []
        for n in self.search.named:
            values = ", ".join(f"{k.rpartition('.')[2]} = {v:.3g} +- {n.std[k]:.1g}" for k, v in n.values.items())
            rivals = f" or {' or '.join(n.aliases[1:])}" if len(n.aliases) > 1 else ""
            parts.append(f"{n.effect}{rivals} ({values}; {n.sigma:.0f} sigma)")
        return (
            f"Missing: {'; '.join(parts)}. On collisions kept out, the gap falls from {gap.before:.3g} to "
            f"{gap.after:.3g} in chi^2 a point; noise alone leaves {gap.floor:.3g}."
        )

    def document(self) -> dict[str, Any]:
        """The contract's discrepancy.json."""
        return {
            "verdict": self.verdict,
            "named": [
                {"effect": n.effect, "parameters": n.values, "std": n.std, "sigma": n.sigma} for n in self.search.named
            ],
            "aliases": [list(n.aliases) for n in self.search.named if len(n.aliases) > 1],
            "outside": [],
            "where": [vars(p) for p in self.where],
            "ranking": [{"effect": c.effect, "sigma": c.sigma} for c in self.search.ranking],
            "gap": as_dict(self.shown.gap),
            "experiment": self._experiment(),
            "noise": {"scale": self.noise.scale, "correlation": self.noise.correlation},
            "clips": {"fitted": len(self.clips), "kept_out": len(self.kept_out)},
        }

    def _experiment(self) -> str:
        if self.verdict != "ambiguous":
            return ""
        return (
            "Collisions with |b| up to 0.6, speeds from 0.1 to 0.6 m/s in all directions, and the two balls exchanged "
            "in half of them give these effects their most different signatures."
        )


def find(clips: Sequence[Measured], model: Model, tick: Callable[[str], None] = lambda stage: None) -> Found:
    """Search for what `model` lacks. Its base parameters and those in `model.free` are fitted.

    Raises InputError with fewer than FEWEST collisions.
    """
    if len(clips) < FEWEST:
        raise InputError(f"{len(clips)} measured collisions: expected {FEWEST} or more, some to fit, some to keep out")
    noise = _noise(clips)
    fitted, kept_out = split(clips)
    names = list(dict.fromkeys([*BASE, *model.free]))
    base = fit(fitted, model, names, noise, tick=lambda: tick("fit"))
    where = locate(fitted, base, noise)
    outcome = search(fitted, base, noise, lambda: tick("search"))
    left = locate(fitted, outcome.best, noise) if outcome.named else where
    if outcome.named and _unexplained(left):
        outcome = outcome.trusted()
        left = locate(fitted, outcome.best, noise) if outcome.named else where
    shown = show(kept_out, base, outcome.best, noise, lambda: tick("gap"))
    return Found(_verdict(outcome, left), noise, tuple(fitted), tuple(kept_out), outcome, where, left, shown)


def _unexplained(left: Sequence[Place]) -> bool:
    return bool(left) and left[0].sigma > UNEXPLAINED


def _verdict(outcome: Search, left: Sequence[Place]) -> str:
    if _unexplained(left):
        return "outside_library"
    if not outcome.named:
        return "none"
    return "ambiguous" if any(len(n.aliases) > 1 for n in outcome.named) else "named"


def _noise(clips: Sequence[Measured]) -> Noise:
    try:
        return estimate(stretch for clip in clips for stretch in clip.stretches())
    except ValueError as e:
        raise InputError(f"the tracks: {e}") from None


def add(clips: Sequence[Measured], model: Model, effect: str, tick: Callable[[], None] = lambda: None) -> Model:
    """The model with `effect` added and refitted to all clips with everything else. Raises InputError."""
    if effect not in library():
        raise InputError(f"{effect}: no such effect; there are {', '.join(library())}")
    noise = _noise(clips)
    strengths = strengths_of(library()[effect])
    names = list(dict.fromkeys([*BASE, *model.free, *strengths]))
    return fit(clips, model, names, noise, tick=tick).model
