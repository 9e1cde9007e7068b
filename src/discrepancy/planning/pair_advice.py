"""The experiment that would part two effects: how alike their signatures are in collisions yet to be filmed."""

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
from discrepancy.planning.experiment import Experiment
from discrepancy.planning.position_errors import StatedErrors
from discrepancy.policy import current_policy
from discrepancy.select.score_test import ScoreTests, derive_trial, largest_cosine

Shaped = tuple[Candidate, dict[str, float]]  # an effect, with values of its shape parameters

MOST = 24  # collisions in a design
AS_FILMED = "these collisions"
OUTSIDE: dict[str, str] = {
    "camera": "film a plate of known lengths with the same camera",
    "measure": "film balls at rest at known places, or move the lamp",
    "clock": "film a clock with the same camera",
    "exposure": "film a flashing light with the same camera",
    "mass": "weigh the balls",
    "radius": "measure the balls' diameters",
}


@dataclass(frozen=True)
class ComparedDesign:
    """Collisions that could be filmed. cosine: between the two effects' signatures in them."""

    words: str
    cosine: float


def compare_designs(
    clips: Sequence[MeasuredCollision],
    noise: Noise,
    fit: ModelFit,
    one: Shaped,
    other: Shaped,
) -> tuple[ComparedDesign, ...]:
    """How alike the signatures of two effects are, in the collisions filmed and in others that could be filmed.

    Both are taken at zero strength, everything else as it was fitted.

    Parameters
    ----------
    clips : sequence of Measured
        The collisions filmed, of which at most MOST are taken and changed.
    noise : Noise
    fit : Fit
        Of these clips.
    one, other : (Candidate, dict of str to float)
        The effects, each with values of its shape parameters.

    Returns
    -------
    tuple of Design
        The collisions as they are; changed in each of `changes.CHANGES` that is possible; changed in all launches.
    """
    for candidate, _ in (one, other):
        fit = fit.drop(candidate.remove_from(fit.model), candidate.strengths + candidate.shapes)
    claimed = np.concatenate([c.claimed_std() for c in clips])
    error_px = float(np.sqrt((claimed**2).mean())) / clips[0].camera.scale
    filmed = Experiment(
        fit.model,
        fit.names,
        tuple(clips),
        fit.launches,
        tuple(range(int(c.frame.min()), int(c.frame.max()) + 1) for c in clips),
        StatedErrors(error_px),
        noise,
    )
    filmed = thin_out(filmed)
    found = [ComparedDesign(AS_FILMED, _cosine(filmed, one, other))]
    for change in (*changes.CHANGES, changes.TOGETHER):
        try:
            changed = changes.apply_change(change, filmed)
        except ValueError:  # no motion
            continue
        if changed is not None:
            found.append(ComparedDesign(changed[0], _cosine(changed[1], one, other)))
    return tuple(found)


def thin_out(experiment: Experiment) -> Experiment:
    """At most MOST of its collisions, to change and compare."""
    count = len(experiment.clips)
    return experiment.select(np.unique(np.linspace(0, count - 1, min(MOST, count)).astype(int)).tolist())


def _cosine(experiment: Experiment, one: Shaped, other: Shaped) -> float:
    """The cosine between two effects' signatures; 1 where there is no motion, or the fit absorbs one of the two."""
    evidence, launches = experiment.evidence, experiment.launches
    try:
        here = experiment.fit()
        expected = predict_tracks(here.model, launches, evidence.clips)
        trials = tuple(
            derive_trial(evidence, here.model, launches, candidate, shapes, expected)
            for candidate, shapes in (one, other)
        )
    except ValueError:
        return 1.0
    first, second = ScoreTests(here, trials).ranking()  # what is absorbed comes last
    return 1.0 if second.absorbed else largest_cosine(first.signature, second.signature)


def advise(one: Candidate, other: Candidate, found: Sequence[ComparedDesign]) -> str:
    """The experiment that parts two effects best, in a sentence; found: as of `designs`."""
    fit, *proposed = found
    best = min(proposed, key=lambda d: d.cosine)
    single = min(proposed[:-1], key=lambda d: d.cosine)
    best = (
        single
        if single.cosine < current_policy().separated_cosine
        or single.cosine < best.cosine + current_policy().min_cosine_gain
        else best
    )
    pair = f"{one.name} and {other.name}"
    if best.cosine < min(current_policy().separated_cosine, fit.cosine):
        falls = f"the cosine of their signatures falls from {fit.cosine:.3f} to {best.cosine:.3f}"
        return f"To part {pair}: {best.words}; {falls}."
    laws = [law for s in (one, other) if s.kind is not None for law in s.kind.laws]
    means = list(dict.fromkeys(OUTSIDE[law] for law in laws if law in OUTSIDE))
    otherwise = "; ".join(means) if means else "one of the two must be measured by other means"
    return f"No collisions of two balls part {pair} (cosine {best.cosine:.3f} at best): {otherwise}."
