"""The outcome of a search, as values: the collisions, what was found in them, what stands, and what is left."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.notes import Note, NoteKind
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_summary import LawSummary
from discrepancy.noise.model import Noise
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.library_search import Selection
from discrepancy.validate.gap import GapFits, as_dict
from discrepancy.validate.held_out import ClaimTest
from discrepancy.validate.residual_map import Disagreement, unexplained
from synthcam.model import Model


@dataclass(frozen=True)
class SearchData:
    """Collisions to fit and to keep out, their noise, and a line for each that has no part, or not all its places.

    smoothed: whether somebody has put the tracks through a filter.
    """

    clips: tuple[MeasuredCollision, ...]
    kept_out: tuple[MeasuredCollision, ...]
    noise: Noise
    left_out: tuple[str, ...]
    smoothed: bool = False

    def without(self, outliers: Mapping[int, str]) -> SearchData:
        """Without some of the clips to fit, by their place, each with a line that says why."""
        clips = tuple(c for k, c in enumerate(self.clips) if k not in outliers)
        return dataclasses.replace(self, clips=clips, left_out=(*self.left_out, *outliers.values()))


@dataclass(frozen=True)
class InterruptedSearch:
    """What a search had tried when its time, s, was over: the effects that fit best, and chi^2 a point with them."""

    effects: tuple[str, ...]
    chi2: float
    seconds: float


@dataclass(frozen=True)
class SearchResult:
    """The outcome of a search.

    Attributes
    ----------
    verdict : str
        none, named, ambiguous, outside_library or inadequate.
    data : SearchData
        The collisions, and what was taken for their noise.
    selected : Selection
        The effects that stand, and what they were chosen by.
    free_law, answer : FittedLaw and Answer, or None
        The law left free that explains what no effect of the library does; its curve and formula.
    named : tuple of EffectClaim
        The effects, with their numbers.
    where, left : tuple of Disagreement
        Where model and data disagree: before anything was found, and after all that was.
    shown : GapFits
        The gap on the collisions kept out.
    experiment : str
        What would part the effects of a class.
    alike : tuple of str
        What no such clips can tell, because they are all alike in it.
    unidentifiable : tuple of str
        Effects that these collisions could not show, however real.
    claims, withdrawn : tuple of ClaimTest
        Those that stand; those that collisions which had no part in them did not bear.
    held : Fit, optional
        With the free law as a table in the model, all else fitted again.
    processed : tuple of str
        What was done to the tracks before they came here.
    so_far : SoFar, optional
        Of a search that was cut short; it names nothing.
    """

    verdict: str
    data: SearchData
    selected: Selection
    free_law: FittedLaw | None
    answer: LawSummary | None
    named: tuple[EffectClaim, ...]
    where: tuple[Disagreement, ...]
    left: tuple[Disagreement, ...]
    shown: GapFits
    experiment: str
    alike: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    claims: tuple[ClaimTest, ...] = ()
    withdrawn: tuple[ClaimTest, ...] = ()
    held: ModelFit | None = None
    processed: tuple[str, ...] = ()
    so_far: InterruptedSearch | None = None

    @property
    def base(self) -> ModelFit:
        """The fit of the model as it was given."""
        return self.selected.base

    @property
    def best(self) -> ModelFit:
        """The fit with everything that was found."""
        return self.free_law.fit if self.free_law else self.selected.best

    @property
    def model(self) -> Model:
        """The model with the named effects, and the free law as a table where a model can hold it, refitted."""
        if self.held:
            return self.held.model
        if not self.free_law:
            return self.selected.best.model
        free = (*self.free_law.model_without_law.free, *filter(None, [self.free_law.law.frees]))
        return dataclasses.replace(self.free_law.model_without_law, free=tuple(dict.fromkeys(free)))

    @property
    def in_model(self) -> bool:
        """Whether that model has what the free law found."""
        return self.held is not None or bool(self.free_law and self.free_law.law.frees)

    @property
    def anything(self) -> bool:
        """Whether anything was found beside the base model."""
        return bool(self.selected.state or self.free_law)

    @property
    def sound(self) -> bool:
        """Whether nothing more is missing: only then do errors of the strengths hold."""
        return not more_missing(self.left, self.withdrawn)

    def slow_noise(self) -> str:
        """A sentence where much of what is taken for noise is slow, else nothing."""
        noise = self.data.noise
        if noise.whole_phase_scale:
            return (
                f" Noise is {noise.scale:.3g} times what the tracks claim within "
                f"{current_policy().min_short_stretch_positions} positions; over whole phases of motion it would be "
                f"{noise.whole_phase_scale:.3g} times, which is missing physics."
            )
        if not noise.is_slow:
            return ""
        return (
            f" Noise is {noise.scale:.3g} times what the tracks claim, {noise.innovation_scale:.3g} times of it new "
            "from frame to frame: what lasts may be missing physics."
        )

    def _cut_short(self, tried: InterruptedSearch) -> str:
        said = (
            f"Cut short after {tried.seconds / 60:.3g} minutes, so nothing is named: the model as given leaves "
            f"{self.base.chi2 / self.base.points:.3g} in chi^2 a point, "
        )
        if not tried.effects:
            return said + "and nothing that was tried leaves less."
        return f"{said}{tried.chi2:.3g} with {', '.join(tried.effects)}, not yet held to other collisions."

    def sentence(self) -> str:
        """The outcome in one sentence."""
        gap, slow = self.shown.gap, self.slow_noise()
        dropped = f" Withdrawn: {'; '.join(f'{c.name} ({c.why})' for c in self.withdrawn)}." if self.withdrawn else ""
        if self.so_far:
            return self._cut_short(self.so_far)
        if self.data.smoothed:
            agree = "" if self.verdict == "none" else f" They disagree most at {self.left[0]}."
            return f"Nothing is named, since {Note(NoteKind.SMOOTHED)}.{agree}{slow}"
        if self.verdict == "none":
            return f"Nothing is missing: simulation and measurement agree to within the noise.{dropped}{slow}"
        if self.verdict == "inadequate":
            most = f", most of all {self.left[0]} ({self.left[0].sigma:.0f} sigma)" if unexplained(self.left) else ""
            return (
                f"Something is missing{most}, and nothing that was tried bears the collisions kept out.{dropped}{slow}"
            )
        closed = (
            f"On collisions kept out, the gap {_moved(gap.before, gap.after)} in chi^2 a point; noise alone leaves "
            f"{gap.floor:.3g}."
        )
        base = self.base.model
        parts = [n.said(base) for n in self.named if not n.held(base)]
        wrong = [n.said(base) for n in self.named if n.held(base)]
        if self.free_law and self.answer:
            parts.insert(
                0, f"{self.answer.description}, which no effect of the library makes ({self.free_law.sigma:.0f} sigma)"
            )
            frees = self.free_law.law.frees
            beside = f"In model.yaml {frees} is free" if frees else "model.yaml cannot hold it"
            where = "model.yaml holds its curve" if self.held else beside
            closed = f"Proposed: {self.answer.formula}. {where}. {closed}"
        elif self.verdict == "outside_library":
            what = f": {self.left[0]} ({self.left[0].sigma:.0f} sigma)" if unexplained(self.left) else ""
            closed = f"Something else is missing that neither the library nor a free law holds{what}. {closed}"
        told = [f"{word}: {'; '.join(lines)}." for word, lines in (("Missing", parts), ("Wrong", wrong)) if lines]
        return " ".join([*told, closed]) + dropped + slow

    def document(self) -> dict[str, Any]:
        """The contract's discrepancy.json."""
        data, noise = self.data, self.data.noise
        return {
            "verdict": self.verdict,
            "named": [
                {
                    "effect": n.effect,
                    "parameters": n.values | n.shapes,
                    "std": {k: np.nan if n.at_limit(k) else std for k, std in (n.std | n.shape_std).items()},
                    "at_limit": [k for k in n.values if n.at_limit(k)],
                    "sigma": n.sigma,
                    "limit": n.limit,
                    "naming_limit": n.naming,
                    "alike": [{"effects": list(names), "cosine": cosine} for names, cosine in n.alike],
                }
                for n in self.named
            ],
            "aliases": [list(n.aliases) for n in self.named if len(n.aliases) > 1],
            "outside": [self.answer.document() | {"in_model": self.in_model}] if self.answer else [],
            "where": [vars(p) for p in self.where],
            "left": [vars(p) for p in self.left],
            "ranking": [{"effect": c.effect, "sigma": c.sigma} for c in self.selected.ranking],
            "claim": self.selected.claim,
            "undetectable": list(self.unidentifiable),
            "untold": list(self.unidentifiable),  # its former name, kept for one version
            "alike": list(self.alike),
            "processed": list(self.processed),
            "withdrawn": [c.document() for c in self.withdrawn],
            "gap": as_dict(self.shown.gap) | {"by_claim": {c.name: c.gap() for c in self.claims}},
            "experiment": self.experiment,
            "cut_short": None if self.so_far is None else vars(self.so_far) | {"effects": list(self.so_far.effects)},
            "noise": {"scale": noise.scale, "quick": noise.innovation_scale, "correlation": noise.correlation}
            | {"shake": noise.common_mode_rms}
            | ({"over_phases": noise.whole_phase_scale} if noise.whole_phase_scale else {}),
            "clips": {"fitted": len(data.clips), "kept_out": len(data.kept_out), "left_out": list(data.left_out)},
        }


def _moved(before: float, after: float) -> str:
    one, other = f"{before:.3g}", f"{after:.3g}"
    if one == other:
        return f"stays at {one}"
    return f"{'falls' if after < before else 'does not fall but goes'} from {one} to {other}"


def more_missing(left: Sequence[Disagreement], withdrawn: Sequence[ClaimTest]) -> bool:
    """Whether something is missing beside all that was found: a law left free that was not borne is a sign of it."""
    return unexplained(left) or any(c.free and c.own > current_policy().unexplained_sigma for c in withdrawn)
