"""Advise which experiment would distinguish two effects, by the cosine of their signatures in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.parameters import Candidate
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise
from discrepancy.planning import changes
from discrepancy.planning.experiment import PlannedExperiment, StatedErrors
from discrepancy.policy import current_policy
from discrepancy.select.score_test import ScoreTests, largest_cosine, prepare_trial

Shaped = tuple[Candidate, dict[str, float]]  # an effect, with values of its shape parameters

AS_FILMED = "these collisions"


@dataclass(frozen=True)
class ComparedDesign:
    """Collisions that could be filmed, in words, and the cosine of the two effects' signatures in them."""

    words: str
    cosine: float


def compare_designs(
    clips: Sequence[MeasuredCollision], noise: Noise, fit: ModelFit, one: Shaped, other: Shaped
) -> tuple[ComparedDesign, ...]:
    """Compute the cosine of two effects' signatures in the filmed collisions and in others that could be filmed.

    Both effects have zero strength; all other parameters have their fitted values. First come the collisions as they
    are (`PlannedExperiment.thin_out` selects some). Then come those with each possible change of `changes.CHANGES`, and
    last those with all changes of launches at once.
    """
    for candidate, _ in (one, other):
        fit = fit.drop(candidate.remove_from(fit.model), candidate.strengths + candidate.shapes)
    claimed = np.concatenate([c.claimed_std() for c in clips])
    error_px = float(np.sqrt((claimed**2).mean())) / clips[0].camera.scale
    filmed = PlannedExperiment(
        model=fit.model,
        names=fit.names,
        clips=tuple(clips),
        launches=fit.launches,
        films=tuple(range(int(c.frame.min()), int(c.frame.max()) + 1) for c in clips),
        errors=StatedErrors(error_px),
        noise=noise,
    ).thin_out()
    found = [ComparedDesign(AS_FILMED, _cosine(filmed, one, other))]
    for change in (*changes.CHANGES, changes.TOGETHER):
        try:
            changed = changes.apply_change(change, filmed)
        except ValueError:  # no motion
            continue
        if changed is not None:
            found.append(ComparedDesign(changed[0], _cosine(changed[1], one, other)))
    return tuple(found)


def _cosine(experiment: PlannedExperiment, one: Shaped, other: Shaped) -> float:
    """The cosine between two effects' signatures; 1 without a motion, or if the fit absorbs one of the two."""
    evidence, launches = experiment.evidence, experiment.launches
    try:
        here = experiment.fit()
        expected = predict_tracks(here.model, launches, evidence.clips)
        trials = tuple(
            prepare_trial(evidence, here.model, launches, candidate, shapes, expected)
            for candidate, shapes in (one, other)
        )
    except ValueError:
        return 1.0
    first, second = ScoreTests(here, trials).ranking()  # what is absorbed comes last
    return 1.0 if second.absorbed else largest_cosine(first.signature, second.signature)


def advise_on_pair(one: Candidate, other: Candidate, found: Sequence[ComparedDesign]) -> str:
    """Advise, in a sentence, on the design that distinguishes two effects best.

    A single change is preferred to all changes at once, unless these lower the cosine much more. found: from
    `compare_designs`.
    """
    as_filmed, *proposed = found
    policy = current_policy()
    best = min(proposed, key=lambda d: d.cosine, default=as_filmed)
    single = min(proposed[:-1], key=lambda d: d.cosine, default=as_filmed)
    if single.cosine < policy.separated_cosine or single.cosine < best.cosine + policy.min_cosine_gain:
        best = single
    pair = f"{one.name} and {other.name}"
    if best.cosine < min(policy.separated_cosine, as_filmed.cosine):
        falls = f"the cosine of their signatures falls from {as_filmed.cosine:.3f} to {best.cosine:.3f}"
        return f"To distinguish {pair}: {best.words}; {falls}."
    other_measurements = {  # by the law that an effect bends
        "camera": "film a plate of known lengths with the same camera",
        "measure": "film balls at rest at known positions, or move the lamp",
        "clock": "film a clock with the same camera",
        "exposure": "film a flashing light with the same camera",
        "mass": "weigh the balls",
        "radius": "measure the balls' diameters",
    }
    laws = dict.fromkeys(law for c in (one, other) if c.kind is not None for law in c.kind.laws)
    means = list(dict.fromkeys(other_measurements[law] for law in laws if law in other_measurements))
    otherwise = "; ".join(means) if means else "one of the two must be measured by other means"
    return f"No collisions of two balls distinguish {pair} (cosine {best.cosine:.3f} at best): {otherwise}."
