"""The whole workflow: measured tracks and a model -> where they disagree, what is missing, the gap before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy import policy
from discrepancy.data.collisions import Measured, cannot_tell, split
from discrepancy.data.outlier_points import taken_out, without_spikes
from discrepancy.diagnostics.claims import Trial
from discrepancy.diagnostics.gap import Shown, as_dict, show
from discrepancy.diagnostics.held_out import Claim
from discrepancy.diagnostics.outlier_clips import odd
from discrepancy.diagnostics.residual_map import Place, locate
from discrepancy.fitting.base_fit import Tick, base_fit, check, noise_of, smoothed
from discrepancy.fitting.gauss_newton import Evidence, Fit
from discrepancy.fitting.noise_refit import refined
from discrepancy.fitting.parameters import suspects_of
from discrepancy.free_laws.answer import Answer
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.noise.model import Noise
from discrepancy.selection.experiment_design import advice, designs
from discrepancy.selection.free_law_contest import FreeLawContest, unseen
from discrepancy.selection.named import Named
from discrepancy.selection.stepwise import Search, search
from synthcam.model import Model
from tracker.camera.camera import InputError

ROUNDS = 4  # searches, at most: again without clips that are unlike all others, again with the noise read anew


@dataclass(frozen=True)
class Found:
    """The outcome. verdict: none, named, ambiguous, outside_library or inadequate. where: before; left: after all that
    was found. claims: those that stand; withdrawn: those that collisions which had no part in them did not bear.

    free_law: the law left free that explains what no effect of the library does; answer: its curve and formula. alike:
    what no such clips can tell, because they are all alike in it. left_out: why clips, or some of their places, had no
    part in it.
    """

    verdict: str
    noise: Noise
    clips: tuple[Measured, ...]
    kept_out: tuple[Measured, ...]
    search: Search
    free_law: FittedLaw | None
    answer: Answer | None
    named: tuple[Named, ...]
    where: tuple[Place, ...]
    left: tuple[Place, ...]
    shown: Shown
    experiment: str
    alike: tuple[str, ...]
    left_out: tuple[str, ...]
    claims: tuple[Claim, ...] = ()
    withdrawn: tuple[Claim, ...] = ()

    @property
    def best(self) -> Fit:
        """The fit with everything that was found."""
        return self.free_law.now if self.free_law else self.search.best

    @property
    def model(self) -> Model:
        """The model with the named effects, refitted. A free law is no effect: no file can hold it."""
        return self.free_law.plain if self.free_law else self.search.best.model

    @property
    def sound(self) -> bool:
        """Whether nothing more is missing: only then do errors of the strengths hold."""
        return not _more(self.left, self.withdrawn)

    def sentence(self) -> str:
        """The outcome in one sentence."""
        gap = self.shown.gap
        dropped = f" Withdrawn: {'; '.join(f'{c.name} ({c.why})' for c in self.withdrawn)}." if self.withdrawn else ""
        if self.verdict == "none":
            return f"Nothing is missing: simulation and measurement agree to within the noise.{dropped}"
        if self.verdict == "inadequate":
            most = f", most of all {self.left[0]} ({self.left[0].sigma:.0f} sigma)" if _unexplained(self.left) else ""
            return f"Something is missing{most}, and nothing that was tried bears the collisions kept out.{dropped}"
        closed = (
            f"On collisions kept out, the gap {_moved(gap.before, gap.after)} in chi^2 a point; noise alone leaves "
            f"{gap.floor:.3g}."
        )
        base = self.search.base.model
        parts = [n.said(base) for n in self.named if not n.held(base)]
        wrong = [n.said(base) for n in self.named if n.held(base)]
        if self.free_law and self.answer:
            parts.insert(
                0, f"{self.answer.said}, which no effect of the library makes ({self.free_law.sigma:.0f} sigma)"
            )
            closed = f"Proposed: {self.answer.formula}. model.yaml cannot hold it. {closed}"
        elif self.verdict == "outside_library":
            what = f": {self.left[0]} ({self.left[0].sigma:.0f} sigma)" if _unexplained(self.left) else ""
            closed = f"Something else is missing that neither the library nor a free law holds{what}. {closed}"
        told = [f"{word}: {'; '.join(lines)}." for word, lines in (("Missing", parts), ("Wrong", wrong)) if lines]
        return " ".join([*told, closed]) + dropped

    def document(self) -> dict[str, Any]:
        """The contract's discrepancy.json."""
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
            "outside": [self.answer.document()] if self.answer else [],
            "where": [vars(p) for p in self.where],
            "left": [vars(p) for p in self.left],
            "ranking": [{"effect": c.effect, "sigma": c.sigma} for c in self.search.ranking],
            "claim": self.search.claim,
            "untold": list(self.search.untold),
            "alike": list(self.alike),
            "withdrawn": [c.document() for c in self.withdrawn],
            "gap": as_dict(self.shown.gap) | {"by_claim": {c.name: c.gap() for c in self.claims}},
            "experiment": self.experiment,
            "noise": {"scale": self.noise.scale, "correlation": self.noise.correlation, "shake": self.noise.shake},
            "clips": {"fitted": len(self.clips), "kept_out": len(self.kept_out), "left_out": list(self.left_out)},
        }


def _moved(before: float, after: float) -> str:
    one, other = f"{before:.3g}", f"{after:.3g}"
    if one == other:
        return f"stays at {one}"
    return f"{'falls' if after < before else 'does not fall but goes'} from {one} to {other}"


def find(clips: Sequence[Measured], model: Model, tick: Tick = lambda stage: None) -> Found:
    """Search for what `model` lacks. Its base parameters that are not zero and those in `model.free` are fitted.

    tick: told the stage, many times. Raises InputError as `check` does.
    """
    check(clips, model)
    tick("noise")
    some, kept_out = smoothed(*split(without_spikes(clips)), model, tick)
    left_out = taken_out(clips, [*some, *kept_out])
    noise = noise_of(some)
    # read without any claim first: one made with too little noise could explain the rest of the noise away
    noise = refined(some, base_fit(some, model, noise, tick), noise, explained=False)
    gone, former = 0, None
    for turn in range(ROUNDS):
        hunt, free_law, nearly = _hunt(some, model, noise, tick, former)
        best, cleaned = (free_law.whole, free_law.evidence.clips) if free_law else (hunt.best, some)
        if turn == ROUNDS - 1:
            break
        strange = odd(cleaned, hunt.base, best, gone)
        if strange:
            gone += len(strange)
            left_out += strange.values()
            some, former = [c for k, c in enumerate(some) if k not in strange], None
            continue
        better = refined(cleaned, best, noise)
        if better is noise and nearly:  # the library's model may lack what the free law has, and call it noise
            better = refined(nearly.evidence.clips, nearly.whole, noise)
        if better is noise:
            break
        noise, former = better, hunt
    tick("gap")
    shown = _shown(kept_out, hunt, free_law, noise, tick)
    strange = odd(kept_out, shown.before, shown.after)
    if strange:
        left_out += [f"{line} (kept out)" for line in strange.values()]
        kept_out = [c for k, c in enumerate(kept_out) if k not in strange]
        shown = _shown(kept_out, hunt, free_law, noise, tick)
    trial = Trial(Evidence.of(some, noise), kept_out, shown.before, noise, lambda: tick("gap"))
    stands = trial.standing(hunt, free_law)
    if stands.withdrawn:
        hunt, free_law = stands.search, stands.free_law
        shown = _shown(kept_out, hunt, free_law, noise, tick)
    tick("where")
    best, cleaned = (free_law.whole, free_law.evidence.clips) if free_law else (hunt.best, tuple(some))
    where = locate(some, hunt.base, noise)
    left = locate(cleaned, best, noise) if best is not hunt.base else where
    named = tuple(n.unsure() for n in stands.named) if _more(left, stands.withdrawn) else stands.named
    verdict = _verdict(free_law, named, left, stands.withdrawn)
    experiment = _experiment(hunt, some, noise) if verdict == "ambiguous" else ""
    answer = Answer.of(free_law) if free_law else None
    return Found(
        verdict,
        noise,
        tuple(some),
        tuple(kept_out),
        hunt,
        free_law,
        answer,
        named,
        where,
        left,
        shown,
        experiment,
        tuple(cannot_tell(clips)),
        tuple(left_out),
        stands.claims,
        stands.withdrawn,
    )


def _shown(clips: Sequence[Measured], hunt: Search, free_law: FittedLaw | None, noise: Noise, tick: Tick) -> Shown:
    try:
        return show(clips, hunt.base, hunt.best, noise, lambda: tick("gap"), _after(free_law, clips, noise))
    except ValueError as e:
        raise InputError(f"the fitted base model has no motion for the collisions kept out: {e}") from None


def _hunt(
    clips: Sequence[Measured], model: Model, noise: Noise, tick: Tick, former: Search | None
) -> tuple[Search, FittedLaw | None, FittedLaw | None]:
    """What the library names; the free law that explains more, if one does; one that explains nearly as much.

    former: the search of the same clips with another noise.
    """
    base = base_fit(clips, model, noise, tick)
    free = FreeLawContest(Evidence.of(clips, noise), base, lambda: tick("free laws"))
    found = search(clips, base, noise, lambda: tick("search"), free.beat, former)
    free_law = free.outcome(found.best)
    beside = free_law.beside(base) if free_law else {}
    again = found.from_here(beside, free_law.plain) if free_law and beside else None
    if again:  # the free law led to effects that the library's search has not begun with
        free.beat(again.best, again.rivals)
        found, free_law = again, free.outcome(again.best)
    return found, free_law, None if free_law else free.nearly(found.best)


def _after(free_law: FittedLaw | None, clips: Sequence[Measured], noise: Noise) -> Callable[[Fit], Fit] | None:
    return None if free_law is None else lambda before: unseen(free_law, clips, before, noise)


def _unexplained(left: Sequence[Place]) -> bool:
    return bool(left) and left[0].sigma > policy.UNEXPLAINED_SIGMA


def _more(left: Sequence[Place], withdrawn: Sequence[Claim]) -> bool:
    """Whether something is missing beside all that was found: a law left free that was not borne is a sign of it."""
    return _unexplained(left) or any(c.free and c.own > policy.UNEXPLAINED_SIGMA for c in withdrawn)


def _verdict(
    free_law: FittedLaw | None, named: Sequence[Named], left: Sequence[Place], withdrawn: Sequence[Claim]
) -> str:
    if free_law or (named and _more(left, withdrawn)):
        return "outside_library"
    if not named:
        # what chance or a bad clip may do is no claim, and no sign that something is missing
        return (
            "inadequate" if _unexplained(left) or any(c.own > policy.UNEXPLAINED_SIGMA for c in withdrawn) else "none"
        )
    return "ambiguous" if any(len(n.aliases) > 1 for n in named) else "named"


def _experiment(hunt: Search, clips: Sequence[Measured], noise: Noise) -> str:
    """What would part each class's effect from its nearest alias."""
    known = suspects_of(hunt.best.model, hunt.base.model, hunt.base.names)
    shapes = {c.effect: c.shapes for c in hunt.ranking}
    said = []
    for n in hunt.named:
        for rival in n.aliases[1:2]:
            one, other = known[n.effect], known[rival]
            pair = (one, n.shapes), (other, shapes.get(rival, {}))
            said.append(advice(one, other, designs(clips, noise, hunt.best, *pair)))
    return " ".join(said)
