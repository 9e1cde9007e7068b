"""The whole workflow: measured tracks and a model -> where they disagree, what is missing, the gap before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.answer import Answer
from discrepancy.fit import Evidence, Fit, fit, settle
from discrepancy.gap import Shown, as_dict, show
from discrepancy.locate import Place, locate
from discrepancy.measured import Measured, cannot_tell, split
from discrepancy.name import Named, Search, added, search
from discrepancy.noise import Noise, estimate
from discrepancy.odd import odd
from discrepancy.outside import Filled, Slots, unseen
from discrepancy.parameter import fitted
from discrepancy.parting import advice, designs
from discrepancy.rank import Contest
from discrepancy.refine import refined
from synthcam.effect import library
from synthcam.model import Model
from tracker.geometry import InputError

FEWEST = 6  # collisions: with fewer, some would not be left to show the gap on
ROUNDS = 4  # searches, at most: again without clips that are unlike all others, again with the noise read anew
UNEXPLAINED = 5.0  # sigma of disagreement left after everything: something that no slot holds
Tick = Callable[[str], None]


@dataclass(frozen=True)
class Found:
    """The outcome. verdict: none, named, ambiguous or outside_library. where: before; left: after all that was found.

    slot: the law left free that explains what no effect of the library does; answer: its curve and formula. alike: what
    no such clips can tell, because they are all alike in it. left_out: why clips had no part in it.
    """

    verdict: str
    noise: Noise
    clips: tuple[Measured, ...]
    kept_out: tuple[Measured, ...]
    search: Search
    slot: Filled | None
    answer: Answer | None
    named: tuple[Named, ...]
    where: tuple[Place, ...]
    left: tuple[Place, ...]
    shown: Shown
    experiment: str
    alike: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def best(self) -> Fit:
        """The fit with everything that was found."""
        return self.slot.now if self.slot else self.search.best

    @property
    def model(self) -> Model:
        """The model with the named effects, refitted. A slot is no effect: no file can hold it."""
        return self.slot.library if self.slot else self.search.best.model

    def sentence(self) -> str:
        """The outcome in one sentence."""
        gap = self.shown.gap
        if self.verdict == "none":
            return "Nothing is missing: simulation and measurement agree to within the noise."
        closed = (
            f"On collisions kept out, the gap falls from {gap.before:.3g} to {gap.after:.3g} in chi^2 a point; "
            f"noise alone leaves {gap.floor:.3g}."
        )
        parts = [_said(n) for n in self.named]
        if self.slot and self.answer:
            parts.insert(0, f"{self.answer.law}, which no effect of the library makes ({self.slot.sigma:.0f} sigma)")
            closed = f"Proposed: {self.answer.formula}. model.yaml cannot hold it. {closed}"
        elif self.verdict == "outside_library":
            what = f"{self.left[0]} ({self.left[0].sigma:.0f} sigma)"
            closed = f"Something else is missing that neither the library nor a free law holds: {what}. {closed}"
        return (f"Missing: {'; '.join(parts)}. " if parts else "") + closed

    def document(self) -> dict[str, Any]:
        """The contract's discrepancy.json."""
        return {
            "verdict": self.verdict,
            "named": [
                {
                    "effect": n.effect,
                    "parameters": n.values | n.shapes,
                    "std": n.std | n.shape_std,
                    "sigma": n.sigma,
                    "limit": n.limit,
                    "naming_limit": n.naming,
                    "alike": [{"effects": list(names), "cosine": cosine} for names, cosine in n.alike],
                }
                for n in self.named
            ],
            "aliases": [list(n.aliases) for n in self.named if len(n.aliases) > 1],
            "outside": [self.answer.document()] if self.answer else [],
            "where": [vars(p) for p in self.where],
            "left": [vars(p) for p in self.left],
            "ranking": [{"effect": c.effect, "sigma": c.sigma} for c in self.search.ranking],
            "claim": self.search.claim,
            "untold": list(self.search.untold),
            "alike": list(self.alike),
            "gap": as_dict(self.shown.gap),
            "experiment": self.experiment,
            "noise": {"scale": self.noise.scale, "correlation": self.noise.correlation, "shake": self.noise.shake},
            "clips": {"fitted": len(self.clips), "kept_out": len(self.kept_out), "left_out": list(self.left_out)},
        }


def _said(n: Named) -> str:
    values = [f"{k.rpartition('.')[2]} = {v:.3g} +- {n.std[k]:.1g}" for k, v in n.values.items()]
    values += [
        f"{k.rpartition('.')[2]} = {v:.3g} +- {n.shape_std[k]:.1g}"
        if np.isfinite(n.shape_std[k])
        else f"{k.rpartition('.')[2]} undetermined"
        for k, v in n.shapes.items()
    ]
    rivals = f" or {' or '.join(n.aliases[1:])}" if len(n.aliases) > 1 else ""
    return f"{n.effect}{rivals} ({', '.join(values)}; {n.sigma:.0f} sigma)"


def find(clips: Sequence[Measured], model: Model, tick: Tick = lambda stage: None) -> Found:
    """Search for what `model` lacks. Its base parameters that are not zero and those in `model.free` are fitted.

    Raises InputError with fewer than FEWEST collisions.
    """
    if len(clips) < FEWEST:
        raise InputError(f"{len(clips)} measured collisions: expected {FEWEST} or more, some to fit, some to keep out")
    noise = _noise(clips)
    some, kept_out = split(clips)
    # read without any claim first: one made with too little noise could explain the rest of the noise away
    noise = refined(some, _base(some, model, noise, tick), noise, explained=False)
    left_out: list[str] = []
    for turn in range(ROUNDS):
        hunt, slot, nearly = _hunt(some, model, noise, tick)
        best, cleaned = (slot.whole, slot.evidence.clips) if slot else (hunt.best, some)
        if turn == ROUNDS - 1:
            break
        strange = odd(cleaned, hunt.base, best)
        if strange:
            left_out += strange.values()
            some = [c for k, c in enumerate(some) if k not in strange]
            continue
        better = refined(cleaned, best, noise)
        if better is noise and nearly:  # the library's model may lack what the slot has, and call it noise
            better = refined(nearly.evidence.clips, nearly.whole, noise)
        if better is noise:
            break
        noise = better
    tick("where")
    where = locate(some, hunt.base, noise)
    left = locate(cleaned, best, noise) if best is not hunt.base else where
    tick("gap")
    shown = _shown(kept_out, hunt, slot, noise, tick)
    strange = odd(kept_out, shown.before, shown.after)
    if strange:
        left_out += [f"{line} (kept out)" for line in strange.values()]
        kept_out = [c for k, c in enumerate(kept_out) if k not in strange]
        shown = _shown(kept_out, hunt, slot, noise, tick)
    named = _beside(slot, hunt) if slot else hunt.named
    verdict = _verdict(slot, named, left)
    experiment = _experiment(hunt, some, noise) if verdict == "ambiguous" else ""
    answer = Answer.of(slot) if slot else None
    return Found(
        verdict,
        noise,
        tuple(some),
        tuple(kept_out),
        hunt,
        slot,
        answer,
        named,
        where,
        left,
        shown,
        experiment,
        tuple(cannot_tell(clips)),
        tuple(left_out),
    )


def _base(clips: Sequence[Measured], model: Model, noise: Noise, tick: Tick) -> Fit:
    try:
        return fit(clips, model, fitted(model), noise, tick=lambda: tick("fit"))
    except ValueError as e:
        raise InputError(f"the model has no motion for these collisions: {e}") from None


def _shown(clips: Sequence[Measured], hunt: Search, slot: Filled | None, noise: Noise, tick: Tick) -> Shown:
    try:
        return show(clips, hunt.base, hunt.best, noise, lambda: tick("gap"), _after(slot, clips, noise))
    except ValueError as e:
        raise InputError(f"the fitted base model has no motion for the collisions kept out: {e}") from None


def _hunt(
    clips: Sequence[Measured], model: Model, noise: Noise, tick: Tick
) -> tuple[Search, Filled | None, Filled | None]:
    """What the library names; the slot that explains more, if one does; one that explains nearly as much."""
    base = _base(clips, model, noise, tick)
    free = Slots(Evidence.of(clips, noise), base, lambda: tick("slots"))
    found = search(clips, base, noise, lambda: tick("search"), free.beat)
    slot = free.outcome(found.best)
    return found, slot, None if slot else free.nearly(found.best)


def _after(
    slot: Filled | None, clips: Sequence[Measured], noise: Noise
) -> Callable[[Fit], tuple[Sequence[Measured], Fit]] | None:
    return None if slot is None else lambda before: unseen(slot, clips, before, noise)


def _beside(slot: Filled, hunt: Search) -> tuple[Named, ...]:
    """The library's effects that are claimed beside a slot."""
    now, known = slot.whole, {c.effect: c.suspect for c in hunt.ranking}
    found = []
    for effect, sigma in slot.beside(hunt.base).items():
        suspect = known[effect]
        values = {s: now.model.value(s) for s in suspect.strengths}
        shapes = {s: now.model.value(s) for s in suspect.shapes}
        std = {s: now.std.get(s, np.inf) for s in (*values, *shapes)}
        own = {s: std[s] for s in values}
        found.append(Named(effect, values, own, sigma, (effect,), shapes, {s: std[s] for s in shapes}))
    return tuple(found)


def _verdict(slot: Filled | None, named: Sequence[Named], left: Sequence[Place]) -> str:
    if slot or (left and left[0].sigma > UNEXPLAINED):
        return "outside_library"
    if not named:
        return "none"
    return "ambiguous" if any(len(n.aliases) > 1 for n in named) else "named"


def _experiment(hunt: Search, clips: Sequence[Measured], noise: Noise) -> str:
    """What would part each class's effect from its nearest alias."""
    known = {c.effect: c for c in hunt.ranking}
    said = []
    for n in hunt.named:
        for rival in n.aliases[1:2]:
            one, other = known[n.effect], known[rival]
            pair = (one.suspect, n.shapes), (other.suspect, other.shapes)
            said.append(advice(one.suspect, other.suspect, designs(clips, noise, hunt.best, *pair)))
    return " ".join(said)


def _noise(clips: Sequence[Measured]) -> Noise:
    try:
        return estimate(clips)
    except ValueError as e:
        raise InputError(f"the tracks: {e}") from None


def add(clips: Sequence[Measured], model: Model, effect: str, tick: Callable[[], None] = lambda: None) -> Model:
    """The model with `effect` added and refitted to all clips with everything else. Raises InputError."""
    if effect not in library():
        raise InputError(f"{effect}: no such effect; there are {', '.join(library())}")
    noise = _noise(clips)
    evidence, base = Evidence.of(clips, noise), _base(clips, model, noise, lambda stage: tick())
    contest = Contest.of(evidence, base, tick)
    candidate = next((c for c in contest.ranking() if c.effect == effect), None)
    if candidate is None:  # it is fitted already, or bends a friction that is not there
        return base.model
    return settle(evidence, added(evidence, base, contest.sharper(evidence, candidate), tick), tick, fresh=False).model
