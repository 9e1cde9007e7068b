"""Plan an experiment: from a scene to the effects that its films could detect; the public `plan`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from discrepancy.fitting.parameters import list_candidates
from discrepancy.planning import compare
from discrepancy.planning.changes import CHANGES
from discrepancy.planning.experiment import SceneExperiment, design_experiment
from discrepancy.planning.limits import Signatures, StrengthLimits, count_draws, median_limits
from discrepancy.planning.plan_result import IndistinguishablePair, PlanResult
from discrepancy.report import plan_page
from synthcam.library import library
from synthcam.scene.scene import Scene
from synthcam_shared.arguments import check_arguments
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import replace_folder
from synthcam_shared.settings import did_you_mean

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The effects that an experiment could detect, before a recording is made.

    Attributes
    ----------
    outcome : PlanResult
        All values: limits, rivals, pairs and changes.
    """

    outcome: PlanResult

    @property
    def table(self) -> pd.DataFrame:
        """A row for each strength of each effect, those with the best limits first.

        The columns are

        - effect, strength, unit, and typical: a realistic size;
        - limit: the strength that half of such experiments detect at 5 sigma, the median over several draws;
        - naming_limit: the strength from which it is distinguished from its most similar rival;
        - shows: whether it is detectable; rival, cosine: the most similar effect;
        - alike: all effects that it could not be distinguished from;
        - best_change, limit_then, naming_then: the change that lowers its naming limit most, and the limits with it;
        - shapes, limit_over_shapes, limit_over_draws.
        """
        return pd.DataFrame(self.outcome.rows())

    @property
    def changes(self) -> pd.DataFrame:
        """A row for each change of the experiment, the best first.

        The columns are name and words, and:

        - limit, naming: the factors by which these limits fall;
        - parts, joins: the pairs of effects that it makes distinguishable and indistinguishable.
        """
        names = ["name", "words", "limit", "naming", "parts", "joins"]
        return pd.DataFrame([[getattr(g, n) for n in names] for g in self.outcome.gains], columns=names)

    @property
    def wanted(self) -> tuple[compare.CollisionsNeeded, ...]:
        """For each wanted limit, how many collisions it takes."""
        return self.outcome.wanted

    def sentence(self) -> str:
        """The plan in a sentence or two.

        Returns
        -------
        str
        """
        return self.outcome.sentence()

    def document(self) -> dict[str, Any]:
        """The contents of ``plan.json``.

        Returns
        -------
        dict
            docs/format.md lists the keys.
        """
        return plan_page.make_plan_document(self.outcome)

    def __repr__(self) -> str:
        return self.sentence()

    def _repr_html_(self) -> str:
        columns = ["strength", "limit", "naming_limit", "unit", "rival", "cosine"]
        return f"<p>{self!r}</p>" + self.table[columns].to_html(index=False, float_format="{:.3g}".format)

    def report(self, folder: str | Path) -> Path:
        """Write the report: ``plan.json`` and a self-contained ``index.html``.

        Parameters
        ----------
        folder : str or Path
            It is made, or replaced if it holds an earlier plan.

        Returns
        -------
        Path
            Of ``index.html``.

        Raises
        ------
        InputError
            If the folder holds something else, or cannot be written.
        """
        with replace_folder(Path(folder), plan_page.FILES, "an earlier plan") as place:
            plan_page.write_plan(self.outcome, place)
        return Path(folder) / "index.html"


@check_arguments
def plan(
    scene: Scene | str | Path,
    effects: Sequence[str] | None = None,
    clips: int = 30,
    noise: float | None = None,
    limits: Mapping[str, float] | None = None,
    seed: int = 0,
    changes: bool = True,
    progress: Progress = lambda done, total: None,
) -> Plan:
    """Plan an experiment: predict which effects its films could detect and name, before a recording is made.

    Parameters
    ----------
    scene : Scene, str or Path
        The experiment: a scene, its file, or the name of one that comes with synthcam.
    effects : sequence of str, optional
        Effects of interest; default: all of the library. All effects are their rivals.
    clips : int
        Collisions to record, of which a search holds out a quarter.
    noise : float, optional
        Error of a position, each axis, px; default: the Cramer-Rao bound of the scene's camera and lamp, which the
        tracker attains.
    limits : mapping of str to float, optional
        Wanted limits, by effect or by dotted strength, for which the number of collisions is estimated.
    seed : int
        Of all random numbers.
    changes : bool
        Whether to try changes of the experiment, which takes most of the time.
    progress : callable
        Takes the experiments that are done, and their number.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        The scene or an effect does not exist, or the scene has no collisions.

    Examples
    --------
    >>> import discrepancy
    >>> planned = discrepancy.plan("oblique", effects=["hop", "viscous_friction"], clips=8, changes=False)
    >>> planned.table[["strength", "shows", "alike"]]
                 strength  shows       alike
    0           hop.share   True          []
    1  viscous_friction.k   True  [stribeck]
    """
    given = scene if isinstance(scene, Scene) else Scene.read(Path(scene))
    designed = design_experiment(given, clips, noise, seed)
    known = [c.name for c in list_candidates(designed.experiment.model, designed.experiment.names)]
    chosen, wished = _choose_effects(effects, known), _parse_wanted(limits or {}, known)
    total, done = count_draws(clips) + changes * (len(CHANGES) + 2) + 2 * len(wished), itertools.count(1)

    def tick() -> None:
        progress(next(done), total)

    found = _typical_limits(given, clips, noise, seed, tick)
    before, after = compare.limits_with_changes(designed.experiment, tick) if changes else (found, ())
    gains = [compare.compute_gain_of_change(before, change, chosen) for change in after]
    repeat = partial(_typical_limits, given, noise=noise, seed=seed)
    outcome = PlanResult(
        name=given.name,
        designed=designed,
        limits=tuple(x for x in found if x.effect in chosen),
        pairs=_pairs_with_advice(found, before, after, chosen, designed),
        before=before,
        tried=after,
        gains=tuple(sorted(gains, key=lambda gain: -gain.naming)),
        wanted=_count_wanted_collisions(wished, found, clips, repeat, tick),
    )
    progress(total, total)
    return Plan(outcome)


def _typical_limits(
    scene: Scene,
    count: int,
    noise: float | None,
    seed: int,
    tick: Callable[[], None] = lambda: None,
    only: Sequence[str] = (),
) -> tuple[StrengthLimits, ...]:
    """The median limits over several draws of a scene's experiment."""
    draws = []
    for k in range(count_draws(count)):
        draws.append(Signatures.of(design_experiment(scene, count, noise, seed + k).experiment, only).limits())
        tick()
    return median_limits(draws)


def _count_wanted_collisions(
    wished: Mapping[str, float],
    found: Sequence[StrengthLimits],
    clips: int,
    repeat: Callable[..., Sequence[StrengthLimits]],
    tick: Callable[[], None],
) -> tuple[compare.CollisionsNeeded, ...]:
    """For each wished strength, how many collisions it takes. repeat: the limits of so many collisions as `count`."""

    def limit_at(strength: str, count: int) -> float:
        there = repeat(count=count, only=[strength.partition(".")[0]])
        tick()
        return _limit_of(there, strength).limit

    return tuple(
        compare.count_collisions_needed(one, size, _limit_of(found, one), clips, partial(limit_at, one))
        for one, size in wished.items()
    )


def _limit_of(limits: Sequence[StrengthLimits], strength: str) -> StrengthLimits:
    return next(x for x in limits if x.strength == strength)


def _choose_effects(effects: Sequence[str] | None, known: Sequence[str]) -> list[str]:
    if isinstance(effects, str) or effects == []:
        raise InputError(f"effects: expected a list of names, found {effects!r}")
    for name in effects or ():
        _check_effect(name, known)
    return list(effects or known)


def _check_effect(name: str, known: Sequence[str]) -> None:
    if name in known:
        return
    if name in library():
        raise InputError(f"{name}: free in this scene, so that every fit has it; expected another effect")
    near = did_you_mean(name, known) or f"; there are {', '.join(known)}"
    raise InputError(f"{name}: no such effect{near}")


def _parse_wanted(limits: Mapping[str, float], known: Sequence[str]) -> dict[str, float]:
    """The wanted limits by dotted strength. Raises InputError."""
    found: dict[str, float] = {}
    for key, size in limits.items():
        effect = key if key in known else key.partition(".")[0]
        _check_effect(effect, known)
        strengths = [f"{effect}.{p.name}" for p in library()[effect].strengths()] if effect in library() else [effect]
        if key not in (effect, *strengths):
            raise InputError(f"limit {key}: no such strength; {effect} has {', '.join(strengths)}")
        if not 0 < size < math.inf:
            raise InputError(f"limit {key}: expected a strength over 0, found {size:g}")
        found |= dict.fromkeys(strengths if key == effect else [key], size)
    return found


def _pairs_with_advice(
    found: tuple[StrengthLimits, ...],
    before: tuple[StrengthLimits, ...],
    after: Sequence[compare.ChangeLimits],
    chosen: Sequence[str],
    here: SceneExperiment,
) -> tuple[IndistinguishablePair, ...]:
    """The indistinguishable pairs, each with the advice how to distinguish it."""
    known = {c.name: c for c in list_candidates(here.experiment.model, here.experiment.names)}
    out = []
    for pair in compare.indistinguishable_pairs(found, chosen):
        tries = [
            compare.ComparedDesign(compare.AS_FILMED, compare.cosine_of_pair(before, pair)),
            *(compare.ComparedDesign(t.words, compare.cosine_of_pair(t.limits, pair)) for t in after),
        ]
        advice = compare.advise_on_pair(known[pair[0]], known[pair[1]], tries) if after else ""
        out.append(IndistinguishablePair(pair, compare.cosine_of_pair(found, pair), advice))
    return tuple(out)
