"""The whole workflow: measured tracks and a model -> where they disagree, what is missing, the gap before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.answer import Answer
from discrepancy.claim import sigmas
from discrepancy.elsewhere import spread
from discrepancy.filled import Filled
from discrepancy.fit import Evidence, Fit, fit, settle
from discrepancy.gap import Shown, as_dict, show
from discrepancy.grow import grown
from discrepancy.locate import Place, locate
from discrepancy.measured import Measured, cannot_tell, split
from discrepancy.name import Search, search
from discrepancy.named import Named, determined
from discrepancy.noise import Noise, estimate
from discrepancy.odd import odd
from discrepancy.outside import Slots, unseen
from discrepancy.parameter import Suspect, fitted, limits_of, parameter_of, suspects_of
from discrepancy.parting import advice, designs
from discrepancy.rank import Contest
from discrepancy.refine import refined
from discrepancy.spike import without_spikes
from synthcam.effect import library
from synthcam.model import Model
from tracker.geometry import InputError

FEWEST = 6  # collisions: with fewer, some would not be left to show the gap on
ROUNDS = 4  # searches, at most: again without clips that are unlike all others, again with the noise read anew
ONE_BALL = 1e-3  # relative, between the camera file's diameter of the ball and the model's
POOR = 2.0  # chi^2 a degree of freedom of a fit that lacks more than what noise may
UNEXPLAINED = 5.0  # sigma of disagreement left after everything: something that no slot holds
Tick = Callable[[str], None]


@dataclass(frozen=True)
class Found:
    """The outcome. verdict: none, named, ambiguous or outside_library. where: before; left: after all that was found.

    slot: the law left free that explains what no effect of the library does; answer: its curve and formula. alike: what
    no such clips can tell, because they are all alike in it. left_out: why clips, or some of their
    places, had no part in it.
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
        return self.slot.plain if self.slot else self.search.best.model

    def sentence(self) -> str:
        """The outcome in one sentence."""
        gap = self.shown.gap
        if self.verdict == "none":
            return "Nothing is missing: simulation and measurement agree to within the noise."
        closed = (
            f"On collisions kept out, the gap {_moved(gap.before, gap.after)} in chi^2 a point; noise alone leaves "
            f"{gap.floor:.3g}."
        )
        base = self.search.base.model
        parts = [said(n, base) for n in self.named if not _held(n, base)]
        wrong = [said(n, base) for n in self.named if _held(n, base)]
        if self.slot and self.answer:
            parts.insert(0, f"{self.answer.law}, which no effect of the library makes ({self.slot.sigma:.0f} sigma)")
            closed = f"Proposed: {self.answer.formula}. model.yaml cannot hold it. {closed}"
        elif self.verdict == "outside_library":
            what = f"{self.left[0]} ({self.left[0].sigma:.0f} sigma)"
            closed = f"Something else is missing that neither the library nor a free law holds: {what}. {closed}"
        told = [f"{word}: {'; '.join(lines)}." for word, lines in (("Missing", parts), ("Wrong", wrong)) if lines]
        return " ".join([*told, closed])

    def document(self) -> dict[str, Any]:
        """The contract's discrepancy.json."""
        return {
            "verdict": self.verdict,
            "named": [
                {
                    "effect": n.effect,
                    "parameters": n.values | n.shapes,
                    "std": {k: np.nan if at_limit(n, k) else std for k, std in (n.std | n.shape_std).items()},
                    "at_limit": [k for k in n.values if at_limit(n, k)],
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


def _moved(before: float, after: float) -> str:
    one, other = f"{before:.3g}", f"{after:.3g}"
    if one == other:
        return f"stays at {one}"
    return f"{'falls' if after < before else 'does not fall but goes'} from {one} to {other}"


def at_limit(n: Named, name: str) -> bool:
    """Whether a strength stands at the end of what its effect allows: it might lie beyond, so it has no error."""
    if name not in n.values:
        return False
    value, p = n.values[name], parameter_of(Model(), name)
    return any(abs(value - end) < 1e-6 * max(abs(end), p.scale) for end in limits_of(Model(), name))


def _held(n: Named, base: Model) -> bool:
    """Whether the base model has this effect, with another strength."""
    return any(base.value(k) != 0 for k in n.values)


def said(n: Named, base: Model) -> str:
    """An effect with its numbers; where the base model holds a strength, that it is another."""
    rivals = f" or {' or '.join(n.aliases[1:])}" if len(n.aliases) > 1 else ""
    errors = {k: "at its limit" if at_limit(n, k) else f"+- {n.std[k]:.1g}" for k in n.values}
    shapes = [
        f"{k.rpartition('.')[2]} = {v:.3g} +- {n.shape_std[k]:.1g}"
        if np.isfinite(n.shape_std[k])
        else f"{k.rpartition('.')[2]} undetermined"
        for k, v in n.shapes.items()
    ]
    if _held(n, base):
        strengths = [f"{k} is not {base.value(k):.3g} but {v:.3g} {errors[k]}" for k, v in n.values.items()]
        return f"{', '.join([*strengths, *shapes])} ({n.sigma:.0f} sigma){rivals}"
    strengths = [f"{k.rpartition('.')[2]} = {v:.3g} {errors[k]}" for k, v in n.values.items()]
    return f"{n.effect}{rivals} ({', '.join([*strengths, *shapes])}; {n.sigma:.0f} sigma)"


def find(clips: Sequence[Measured], model: Model, tick: Tick = lambda stage: None) -> Found:
    """Search for what `model` lacks. Its base parameters that are not zero and those in `model.free` are fitted.

    tick: told the stage, many times. Raises InputError with fewer than FEWEST collisions, or what _one_setup refuses.
    """
    if len(clips) < FEWEST:
        raise InputError(f"{len(clips)} measured collisions: expected {FEWEST} or more, some to fit, some to keep out")
    _one_setup(clips, model)
    tick("noise")
    clips, left_out = without_spikes(clips)
    some, kept_out = split(clips)
    noise = _noise(some)
    # read without any claim first: one made with too little noise could explain the rest of the noise away
    noise = refined(some, _base(some, model, noise, tick), noise, explained=False)
    gone, former = 0, None
    for turn in range(ROUNDS):
        hunt, slot, nearly = _hunt(some, model, noise, tick, former)
        best, cleaned = (slot.whole, slot.evidence.clips) if slot else (hunt.best, some)
        if turn == ROUNDS - 1:
            break
        strange = odd(cleaned, hunt.base, best, gone)
        if strange:
            gone += len(strange)
            left_out += strange.values()
            some, former = [c for k, c in enumerate(some) if k not in strange], None
            continue
        better = refined(cleaned, best, noise)
        if better is noise and nearly:  # the library's model may lack what the slot has, and call it noise
            better = refined(nearly.evidence.clips, nearly.whole, noise)
        if better is noise:
            break
        noise, former = better, hunt
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
    clips: Sequence[Measured], model: Model, noise: Noise, tick: Tick, former: Search | None
) -> tuple[Search, Filled | None, Filled | None]:
    """What the library names; the slot that explains more, if one does; one that explains nearly as much.

    former: the search of the same clips with another noise.
    """
    base = _base(clips, model, noise, tick)
    free = Slots(Evidence.of(clips, noise), base, lambda: tick("slots"))
    found = search(clips, base, noise, lambda: tick("search"), free.beat, former)
    slot = free.outcome(found.best)
    beside = slot.beside(base) if slot else {}
    again = found.from_here(beside, slot.plain) if slot and beside else None
    if again:  # the slot led to effects that the library's search has not begun with
        free.beat(again.best, again.rivals)
        found, slot = again, free.outcome(again.best)
    return found, slot, None if slot else free.nearly(found.best)


def _after(slot: Filled | None, clips: Sequence[Measured], noise: Noise) -> Callable[[Fit], Fit] | None:
    return None if slot is None else lambda before: unseen(slot, clips, before, noise)


def _beside(slot: Filled, hunt: Search) -> tuple[Named, ...]:
    """The library's effects that are claimed beside a slot."""
    now, known = slot.whole, suspects_of(slot.plain, hunt.base.model, hunt.base.names)
    return tuple(_named(known[effect], now, now.std, sigma) for effect, sigma in slot.beside(hunt.base).items())


def _named(suspect: Suspect, now: Fit, std: Mapping[str, float], sigma: float) -> Named:
    """A suspect with the numbers that a fit gives it."""
    values, shapes = ({k: now.model.value(k) for k in names} for names in (suspect.strengths, suspect.shapes))
    own, bent = {k: std.get(k, np.inf) for k in values}, {k: determined(now, k, std.get(k, 0.0)) for k in shapes}
    return Named(suspect.name, values, own, sigma, (suspect.name,), shapes, bent)


def _verdict(slot: Filled | None, named: Sequence[Named], left: Sequence[Place]) -> str:
    if slot or (left and left[0].sigma > UNEXPLAINED):
        return "outside_library"
    if not named:
        return "none"
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


def _noise(clips: Sequence[Measured]) -> Noise:
    try:
        return estimate(clips)
    except ValueError as e:
        raise InputError(f"the tracks: {e}") from None


def _one_setup(clips: Sequence[Measured], model: Model) -> None:
    """All clips are of one camera, and the ball that they are measured by is the model's.

    What the balls differ by would pass for a discovery.
    """
    first, held = clips[0].camera, 2 * model.ball.radius
    for c in clips:
        if abs(c.camera.ball_diameter / held - 1) > ONE_BALL:
            raise InputError(
                f"the ball of camera.json is {1e3 * c.camera.ball_diameter:.6g} mm wide (clip {c.clip}), that of the "
                f"model {1e3 * held:.6g} mm; expected the same"
            )
        if other := c.camera.differs(first):
            raise InputError(
                f"camera.json: {other} of clip {c.clip} is not that of clip {clips[0].clip}; expected clips of one "
                "camera; search those of each by themselves"
            )


@dataclass(frozen=True)
class Added:
    """A suspect fitted with everything else. before, now: the fits without and with it, all clips in both.

    left_out: a line for each clip of which some places had no part in them.
    """

    before: Fit
    now: Fit
    named: Named
    left_out: tuple[str, ...] = ()

    @property
    def chi2(self) -> tuple[float, float]:
        """A degree of freedom: without and with it."""
        one, other = (f.chi2 / (f.points - f.parameters) for f in (self.before, self.now))
        return one, other

    def sentence(self) -> str:
        """Its strength, and how far chi^2 falls."""
        one, other = self.chi2
        poor = "; more is missing, and its error holds only if nothing is" if other > POOR else ""
        return (
            f"{said(self.named, self.before.model)}; chi^2 a degree of freedom goes from {one:.4g} to {other:.4g} on "
            f"the collisions fitted{poor}"
        )

    def document(self) -> dict[str, Any]:
        """For other programs; parameters by their own names. std: None where there is none to give."""
        n = self.named
        std = {k: None if at_limit(n, k) or not np.isfinite(x) else x for k, x in (n.std | n.shape_std).items()}
        return {
            "effect": n.effect,
            "parameters": {k.rpartition(".")[2]: x for k, x in (n.values | n.shapes).items()},
            "std": {k.rpartition(".")[2]: x for k, x in std.items()},
            "sigma": n.sigma,
            "chi2": dict(zip(("before", "after"), self.chi2, strict=True)),
        }


def add(clips: Sequence[Measured], model: Model, effect: str, tick: Tick = lambda stage: None) -> Added:
    """`effect` added to the model and fitted to all clips with everything else.

    Raises InputError: no such effect, too few collisions, what _one_setup refuses, or these collisions cannot tell it.
    """
    if effect not in library():
        raise InputError(f"{effect}: no such effect; there are {', '.join(library())}")
    if len(clips) < FEWEST:
        raise InputError(f"{len(clips)} measured collisions: expected {FEWEST} or more")
    _one_setup(clips, model)
    tick("noise")
    clips, left_out = without_spikes(clips)
    noise = _noise(clips)
    evidence, base = Evidence.of(clips, noise), _base(clips, model, noise, tick)
    if any(n.startswith(f"{effect}.") for n in base.names):
        raise InputError(f"{effect}: the model calls it free, so that every fit has it; `discrepancy find` shows it")
    contest = Contest.of(evidence, base, lambda: tick("search"))
    candidate = next((c for c in contest.ranking() if c.effect == effect), None)
    if candidate is None or not candidate.telling:
        far = base.chi2 / (base.points - base.parameters)
        why = f"; without it chi^2 is {far:.3g} a degree of freedom: something larger is missing" if far > POOR else ""
        raise InputError(f"{effect}: these collisions cannot tell it: the fit absorbs it, or it hardly shows{why}")
    suspect, best = candidate.suspect, contest.sharper(evidence, candidate)
    now = settle(evidence, grown(evidence, base, best, lambda: tick("search")), lambda: tick("search"), fresh=False)
    sigma = sigmas(base.chi2 - now.chi2, len(suspect.strengths), contest.looks[effect])
    std = now.std | spread(evidence, base, now, suspect)
    return Added(base, now, _named(suspect, now, std, sigma), tuple(left_out))
