"""Where simulation and measurement disagree, before any effect is named: phase, ball, observable, and against what.

Each phase starts anew from the measured state. In every clip, along and across each ball's motion, the residual is a
free polynomial of time in each stage: what lies at the contact is its offset and drift just after it, against the
launch as the frames before tell it; in sliding and in rolling only the bend counts, and what bends more. Each trial has
all others free beside it, and the shared parameters, which a wrong model bends: so a wrong contact is not blamed on
the rolling that follows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtri

from discrepancy.arrays import Array, Ints
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, V0, B
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.predict import predict_tracks
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.policy import current_policy
from discrepancy.validate.ripple import SAID as OF_RIPPLES
from discrepancy.validate.ripple import ripples
from discrepancy.validate.stages import BEFORE, ROLLING, SLIDING, directions, stages
from discrepancy.validate.trial import ClipAmplitudes, ClipSolution, results

Term = tuple[str, int, int]  # name, ball, axis
Where = tuple[str, int, int]  # phase, ball, axis

PHASES = ("before", "contact", "sliding", "rolling")
BALLS = ("ball 1", "ball 2")
AXES = ("along", "across")
SAID = {
    "before": "before the contact",
    "contact": "at the contact",
    "sliding": "sliding",
    "rolling": "rolling",
    **OF_RIPPLES,
}
ROLLS_ON = 5 / 7  # of a velocity given to a ball that slides, when it rolls: whatever the friction in between
TERMS: dict[str, dict[int, tuple[float, int]]] = {  # displacement: factor and power of time since each stage began
    **{f"before {power}": {BEFORE: (1.0, power)} for power in (1, 2, 3)},
    "offset": {SLIDING: (1.0, 0)},
    "drift": {SLIDING: (1.0, 1), ROLLING: (ROLLS_ON, 1)},
    "slide's bend": {SLIDING: (1.0, 2)},
    "slide's twist": {SLIDING: (1.0, 3)},
    "roll's offset": {ROLLING: (1.0, 0)},
    "roll's drift": {ROLLING: (1.0, 1)},
    "roll's bend": {ROLLING: (1.0, 2)},
    "roll's twist": {ROLLING: (1.0, 3)},
}
TRIALS = {  # what is tried, and what is free beside it
    "before": (("before 1", "before 2", "before 3"), tuple(TERMS)[3:]),
    "contact": (("offset", "drift"), ("slide's bend", "roll's offset", "roll's bend")),
    "sliding": (("slide's bend", "slide's twist"), ("offset", "drift", "roll's offset", "roll's drift", "roll's bend")),
    "rolling": (("roll's bend", "roll's twist"), ("offset", "drift", "slide's bend", "roll's offset", "roll's drift")),
}
FREE_LINE = {
    "before": 2,
    "contact": 0,
    "sliding": 2,
    "rolling": 2,
}  # powers that a size does not count; at rest one less
ROLLER = (1, "before 1")  # the launch takes a roller's drift
PLATE = 0.02  # m, of places


@dataclass(frozen=True)
class Disagreement:
    """One test of the residuals of a ball in a phase, along or across its motion.

    Attributes
    ----------
    phase, ball, observable : str
    sigma : float
        Corrected for all tests.
    against : str
        What the disagreement changes with from clip to clip, or "" for any.
    size : float
        rms of the disagreement in that phase, noise subtracted, um; nan where the residuals are too small to bear it,
        as of a model that is wrong throughout.
    """

    phase: str
    ball: str
    observable: str
    sigma: float
    against: str = ""
    size: float = 0.0

    def __str__(self) -> str:
        changing = f", changing with the {self.against}" if self.against else ""
        return f"{self.ball} {SAID[self.phase]}, {self.observable} its motion{changing}"


def locate(clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise) -> tuple[Disagreement, ...]:
    """Test where the residuals of a fit disagree with noise: by phase, ball and direction, and against what.

    Parameters
    ----------
    clips : sequence of Measured
    fit : Fit
        Of these clips.
    noise : Noise

    Returns
    -------
    tuple of Disagreement
        Every test, most significant first.
    """
    found = [*trials(clips, fit, noise), *ripples(clips, fit, noise)]
    places = [
        Disagreement(p, BALLS[b], AXES[a], _corrected(chi2, dof, len(found)), against, size)
        for (p, b, a), against, chi2, dof, size in found
    ]
    return tuple(sorted(places, key=lambda x: -x.sigma))


def trials(
    clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise
) -> Iterator[tuple[Where, str, float, int, float]]:
    """(phase, ball, axis), what it is held against, chi^2, degrees of freedom and size, um, of each trial."""
    all_: dict[Where, list[ClipAmplitudes]] = {}
    expected = predict_tracks(fit.model, fit.launches, clips)
    for k, clip in enumerate(clips):
        for where, part in _parts(clip, expected[k], fit, k, noise):
            all_.setdefault(where, []).append(part)
    for where, parts in all_.items():
        for result in results(parts):
            yield where, *result


def _parts(
    clip: MeasuredCollision, path: Array, fit: ModelFit, k: int, noise: Noise
) -> Iterator[tuple[Where, ClipAmplitudes]]:
    """One clip's part in every trial."""
    stage, time = stages(clip)
    motion = directions(clip, stage, path)
    white, size = ClipWhitener.of(clip, noise), np.sqrt(sum((s**2).sum(axis=0) for s in fit.slopes))
    unit = 1 / np.where(size > 0, size, 1)
    for phase, (names, beside) in TRIALS.items():
        tried = [(name, b, a) for b in range(2) for a in range(2) for name in names if (b, name) != ROLLER]
        terms = [(name, b, a) for b in range(2) for a in range(2) for name in beside]
        first = len(terms)
        terms += tried
        raw = np.stack([_column(t, stage, clip.ball, time, motion) for t in terms], axis=-1)
        if phase == "contact":  # an impact's natural measure
            raw[..., first:] *= fit.launches[k, V0]
        solved = ClipSolution.of(fit.launch_slopes[k], white(raw), fit.residuals[k], fit.slopes[k] * unit)
        for b in range(2):
            rows = np.isin(stage, [s for name in names for s in TERMS[name]]) & (clip.ball == b)
            for a in range(2):
                wanted = [j for j in range(first, len(terms)) if terms[j][1:] == (b, a)]
                shown = [i for i, j in enumerate(wanted) if solved.kept[j]]
                if not shown:
                    continue
                mine = [wanted[i] for i in shown]
                pulls, per_metre, shared = solved.group(mine)
                full, squares = np.zeros((len(pulls), len(wanted))), np.zeros((len(wanted), len(wanted)))
                full[:, shown] = per_metre
                columns = np.einsum("na,nai->ni", motion[rows, a], raw[rows][..., mine])
                columns = _beyond(columns, time[rows], FREE_LINE[phase] - (phase == "before" and b == 0))
                squares[np.ix_(shown, shown)] = columns.T @ columns
                features = _features(fit.launches[k], path[rows].mean(axis=0), motion[rows, a].mean(axis=0))
                rest = (solved.information, solved.pull)
                left = float(((clip.xy - path)[rows] ** 2).sum())
                yield (
                    (phase, b, a),
                    ClipAmplitudes(pulls, full, shared, *rest, squares, int(rows.sum()), left, features),
                )


def _beyond(columns: Array, time: Array, powers: int) -> Array:
    """What columns (n, k) show beyond a polynomial of so many powers of time."""
    q, _ = np.linalg.qr(np.vander(time, powers))
    return np.asarray(columns - q @ (q.T @ columns))


def _column(term: Term, stage: Ints, ball: Ints, time: Array, motion: Array) -> Array:
    """Displacement (n, 2) by a metre of a term."""
    name, b, a = term
    size = np.zeros(len(stage))
    for s, (factor, power) in TERMS[name].items():
        size += np.where((stage == s) & (ball == b), factor * time**power, 0.0)
    return np.asarray(size[:, None] * motion[:, a])


def _features(launch: Array, place: Array, direction: Array) -> dict[str, Array]:
    """What a clip's amplitude may change with. A force of the place counts by its part along the trial's direction."""
    speed, heading, b = launch[[V0, HEADING, B]]
    x, y = place / PLATE
    field = np.array([1, x, y, x * x, x * y, y * y])
    return {
        "speed": np.array([speed, speed**2]),
        "impact parameter": np.array([b, abs(b), b * b]),
        "heading": np.array([np.cos(heading), np.sin(heading), np.cos(2 * heading), np.sin(2 * heading)]),
        "place": np.outer(direction, field).ravel(),
    }


def _corrected(chi2: float, dof: int, trials: int) -> float:
    p = trials * float(chdtrc(dof, chi2))
    if p >= 1:
        return 0.0
    return float(-ndtri(p / 2)) if p > 1e-250 else chi2_to_sigma(chi2, dof)


def unexplained(left: Sequence[Disagreement]) -> bool:
    """Whether what `locate` found is more than chance does."""
    return bool(left) and left[0].sigma > current_policy().unexplained_sigma
