"""The experiment that would part two effects: how alike their signatures are in collisions yet to be filmed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy import policy
from discrepancy.arrays import Array
from discrepancy.data.collisions import Measured
from discrepancy.data.launch import HEADING, T_C, V0, B
from discrepancy.fitting.gauss_newton import linearised
from discrepancy.fitting.model_fit import Evidence, Fit
from discrepancy.fitting.parameters import Candidate
from discrepancy.fitting.predict import forecast
from discrepancy.noise.model import Noise
from discrepancy.selection.score_test import ScoreTests, likeness, tried

Shaped = tuple[Candidate, dict[str, float]]  # an effect, with values of its shape parameters

MOST = 24  # collisions in a design
ASIDE = 0.25  # of the picture's size, from its middle
OUTSIDE: dict[str, str] = {
    "camera": "film a plate of known lengths with the same camera",
    "measure": "film balls at rest at known places, or move the lamp",
    "clock": "film a clock with the same camera",
    "exposure": "film a flashing light with the same camera",
    "mass": "weigh the balls",
    "radius": "measure the balls' diameters",
}


@dataclass(frozen=True)
class Design:
    """Collisions that could be filmed. cosine: between the two effects' signatures in them."""

    words: str
    cosine: float


@dataclass(frozen=True)
class _Way:
    words: str
    change: Callable[[Measured, Array, float, int], tuple[Measured, Array]]  # clip, launch, share from 0 to 1, number


def _exchanged(clip: Measured, launch: Array, share: float, number: int) -> tuple[Measured, Array]:
    return dataclasses.replace(clip, striker="ab"[number % 2]), launch


def _put(column: int, low: float, high: float) -> Callable[[Measured, Array, float, int], tuple[Measured, Array]]:
    def change(clip: Measured, launch: Array, share: float, number: int) -> tuple[Measured, Array]:
        new = launch.copy()
        new[column] = low + (high - low) * share
        return clip, new

    return change


def _longer(clip: Measured, launch: Array, share: float, number: int) -> tuple[Measured, Array]:
    first, last = int(clip.frame.min()), int(clip.frame.max())
    count = 2 * (last - first + 1)
    spread = np.tile(clip.covariance.mean(axis=0), (2 * count, 1, 1))
    frame, ball = np.tile(np.arange(first, first + count), 2), np.repeat([0, 1], count)
    new = dataclasses.replace(clip, frame=frame, ball=ball, xy=np.zeros((2 * count, 2)), covariance=spread)
    return new, launch


def _aside(clip: Measured, launch: Array, share: float, number: int) -> tuple[Measured, Array]:
    corner = np.array([1 if number & 1 else -1, 1 if number & 2 else -1]) * ASIDE
    pixel = (0.5 + corner) * np.array(clip.camera.size)
    return clip, np.concatenate([clip.camera.unproject(pixel)[0], launch[T_C:]])


WAYS = (
    _Way("the balls exchanged in half of the collisions", _exchanged),
    _Way("oblique collisions, |b| up to 0.6", _put(B, -0.6, 0.6)),
    _Way("speeds from 0.1 to 0.6 m/s", _put(V0, 0.1, 0.6)),
    _Way("headings all round", _put(HEADING, 0.0, 2 * np.pi)),
    _Way("films twice as long", _longer),
    _Way("collisions spread over the picture", _aside),
)


def designs(
    clips: Sequence[Measured],
    noise: Noise,
    fit: Fit,
    one: Shaped,
    other: Shaped,
) -> tuple[Design, ...]:
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
        The collisions as they are; changed in each of WAYS; changed in all of these together.
    """
    chosen = np.unique(np.linspace(0, len(clips) - 1, min(MOST, len(clips))).astype(int))
    for candidate, _ in (one, other):
        fit = fit.reduced(candidate.without(fit.model), candidate.strengths + candidate.shapes)
    mixed = np.random.default_rng(0)
    found = []
    for words, ways in (
        ("these collisions", ()),
        *((w.words, (w,)) for w in WAYS),
        ("all of that together", WAYS),
    ):
        shares = [mixed.permutation(len(chosen)) / max(len(chosen) - 1, 1) for _ in ways]
        some, launches = [], []
        for number, k in enumerate(chosen):
            clip, launch = clips[k], fit.launches[k]
            for way, share in zip(ways, shares, strict=True):
                clip, launch = way.change(clip, launch, float(share[number]), number)
            some.append(clip)
            launches.append(launch)
        found.append(Design(words, _cosine(Evidence.of(some, noise), fit, np.array(launches), one, other)))
    return tuple(found)


def _cosine(
    evidence: Evidence,
    fit: Fit,
    launches: Array,
    one: Shaped,
    other: Shaped,
) -> float:
    """The cosine between two effects' signatures; 1 where there is no motion, or the fit absorbs one of the two."""
    try:
        here = linearised(evidence, fit.model, fit.names, launches)
        expected = forecast(here.model, launches, evidence.clips)
        trials = tuple(
            tried(evidence, here.model, launches, candidate, shapes, expected) for candidate, shapes in (one, other)
        )
    except ValueError:
        return 1.0
    first, second = ScoreTests(here, trials).ranking()  # what is absorbed comes last
    return 1.0 if second.absorbed else likeness(first.signature, second.signature)


def advice(one: Candidate, other: Candidate, found: Sequence[Design]) -> str:
    """The experiment that parts two effects best, in a sentence; found: as of `designs`."""
    fit, *proposed = found
    best = min(proposed, key=lambda d: d.cosine)
    single = min(proposed[:-1], key=lambda d: d.cosine)
    best = (
        single
        if single.cosine < policy.PARTED_COSINE or single.cosine < best.cosine + policy.PARTED_BETTER_BY
        else best
    )
    pair = f"{one.name} and {other.name}"
    if best.cosine < min(policy.PARTED_COSINE, fit.cosine):
        falls = f"the cosine of their signatures falls from {fit.cosine:.3f} to {best.cosine:.3f}"
        return f"To part {pair}: {best.words}; {falls}."
    laws = [law for s in (one, other) if s.kind is not None for law in s.kind.laws]
    means = list(dict.fromkeys(OUTSIDE[law] for law in laws if law in OUTSIDE))
    otherwise = "; ".join(means) if means else "one of the two must be measured by other means"
    return f"No collisions of two balls part {pair} (cosine {best.cosine:.3f} at best): {otherwise}."
