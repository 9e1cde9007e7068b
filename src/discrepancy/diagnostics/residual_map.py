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
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtri

from discrepancy import policy
from discrepancy.arrays import Array, Ints
from discrepancy.data.collisions import Measured
from discrepancy.data.launch import HEADING, T_C, V0, B
from discrepancy.fitting.model_fit import Fit
from discrepancy.fitting.predict import forecast
from discrepancy.fitting.significance import sigmas
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import Whitener

Term = tuple[str, int, int]  # name, ball, axis
Where = tuple[str, int, int]  # phase, ball, axis

PHASES = ("before", "contact", "sliding", "rolling")
BALLS = ("ball 1", "ball 2")
AXES = ("along", "across")
AGAINST = ("speed", "impact parameter", "heading", "place")
SAID = {"before": "before the contact", "contact": "at the contact", "sliding": "sliding", "rolling": "rolling"}
BEFORE, SLIDING, ROLLING = range(3)  # stages of motion; each has terms of its own
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
UNIT = 0.05  # s, of time in the terms
PLATE = 0.02  # m, of places
STILL = 1e-5  # m: a ball that moves less has no direction of its own
SEEN = 1e-5  # of a term's length that the terms before it must leave
SHOWN = 1e-6  # of what a shared parameter does that must be in a trial to count there
SPANNED = 1e-3  # of a template's length that others must leave


@dataclass(frozen=True)
class Place:
    """One test of the residuals of a ball in a phase, along or across its motion.

    Attributes
    ----------
    phase, ball, observable : str
    sigma : float
        Corrected for all tests.
    against : str
        What the disagreement changes with from clip to clip, or "" for any.
    size : float
        rms of the disagreement in that phase, noise subtracted, um.
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


@dataclass(frozen=True)
class _Part:
    """One clip's part in a trial. P terms, of which the clip tells m combinations.

    pulls (m,): amplitudes, of unit variance; per_metre (m, P): pulls that a metre of each term would make;
    shared (m, S): those of the shared parameters; squares (P, P): products of the terms, summed over `rows` rows;
    features: by what the trial is held against, numbers (f,) of this clip.
    """

    pulls: Array
    per_metre: Array
    shared: Array
    information: Array
    pull: Array
    squares: Array
    rows: int
    features: dict[str, Array]


def locate(clips: Sequence[Measured], fit: Fit, noise: Noise) -> tuple[Place, ...]:
    """Test where the residuals of a fit disagree with noise: by phase, ball and direction, and against what.

    Parameters
    ----------
    clips : sequence of Measured
    fit : Fit
        Of these clips.
    noise : Noise

    Returns
    -------
    tuple of Place
        Every test, most significant first.
    """
    found = list(trials(clips, fit, noise))
    places = [
        Place(p, BALLS[b], AXES[a], _corrected(chi2, dof, len(found)), against, size)
        for (p, b, a), against, chi2, dof, size in found
    ]
    return tuple(sorted(places, key=lambda x: -x.sigma))


def trials(clips: Sequence[Measured], fit: Fit, noise: Noise) -> Iterator[tuple[Where, str, float, int, float]]:
    """(phase, ball, axis), what it is held against, chi^2, degrees of freedom and size, um, of each trial."""
    all_: dict[Where, list[_Part]] = {}
    expected = forecast(fit.model, fit.launches, clips)
    for k, clip in enumerate(clips):
        for where, part in _parts(clip, expected[k], fit, k, noise):
            all_.setdefault(where, []).append(part)
    for where, parts in all_.items():
        for result in _results(parts):
            yield where, *result


def _parts(clip: Measured, path: Array, fit: Fit, k: int, noise: Noise) -> Iterator[tuple[Where, _Part]]:
    """One clip's part in every trial."""
    stage, time = _stages(clip)
    motion = _directions(clip, stage, path)
    white, size = Whitener.of(clip, noise), np.sqrt(sum((s**2).sum(axis=0) for s in fit.slopes))
    unit = 1 / np.where(size > 0, size, 1)
    for phase, (names, beside) in TRIALS.items():
        tried = [(name, b, a) for b in range(2) for a in range(2) for name in names if (b, name) != ROLLER]
        terms = [(name, b, a) for b in range(2) for a in range(2) for name in beside]
        first = len(terms)
        terms += tried
        raw = np.stack([_column(t, stage, clip.ball, time, motion) for t in terms], axis=-1)
        if phase == "contact":  # an impact's natural measure
            raw[..., first:] *= fit.launches[k, V0]
        solved = _Solved.of(fit.launch_slopes[k], white(raw), fit.residuals[k], fit.slopes[k] * unit)
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
                yield (phase, b, a), _Part(pulls, full, shared, *rest, squares, int(rows.sum()), features)


def _beyond(columns: Array, time: Array, powers: int) -> Array:
    """What columns (n, k) show beyond a polynomial of so many powers of time."""
    q, _ = np.linalg.qr(np.vander(time, powers))
    return np.asarray(columns - q @ (q.T @ columns))


def _stages(clip: Measured) -> tuple[Ints, Array]:
    """Stage and time, in UNITs from where the stage begins (before: to the contact), of each row: (n,) and (n,).

    Exposures that hold an event count to the sliding.
    """
    opens = clip.frame / clip.fps
    closes, end, t_c = opens + clip.exposure, clip.ends[clip.ball], clip.launch[T_C]
    stage = np.where(closes <= t_c, BEFORE, np.where(opens >= end, ROLLING, SLIDING))
    middle = (opens + closes) / 2
    time = np.where(stage == BEFORE, t_c - middle, np.where(stage == SLIDING, middle - t_c, middle - end))
    return stage, np.maximum(time, 0) / UNIT


def _column(term: Term, stage: Ints, ball: Ints, time: Array, motion: Array) -> Array:
    """Displacement (n, 2) by a metre of a term."""
    name, b, a = term
    size = np.zeros(len(stage))
    for s, (factor, power) in TERMS[name].items():
        size += np.where((stage == s) & (ball == b), factor * time**power, 0.0)
    return np.asarray(size[:, None] * motion[:, a])


def _directions(clip: Measured, stage: Ints, path: Array) -> Array:
    """Unit vectors along and across each ball's motion in each stage, (n, 2, 2); at rest along the heading."""
    heading = clip.launch[HEADING]
    along = np.tile([np.cos(heading), np.sin(heading)], (len(path), 1))
    for s in (BEFORE, SLIDING, ROLLING):
        for b in range(2):
            rows = np.flatnonzero((stage == s) & (clip.ball == b))
            if len(rows) < 2:
                continue
            way = path[rows[-1]] - path[rows[0]]
            if np.hypot(*way) > STILL:
                along[rows] = way / np.hypot(*way)
    return np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)


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


@dataclass(frozen=True)
class _Solved:
    """Least squares of one clip: amplitudes of unit-length terms, their covariance, and what shared parameters do.

    information (S, S) and pull (S,): of the shared parameters in what the terms leave free.
    """

    kept: NDArray[np.bool_]
    length: Array
    amplitude: Array
    covariance: Array
    shared: Array
    information: Array
    pull: Array

    @classmethod
    def of(cls, launch: Array, columns: Array, residual: Array, shared: Array) -> _Solved:
        """columns (2n, T) of the terms; the launch is free beside them. All whitened."""
        both = np.column_stack([launch, columns])
        length = np.linalg.norm(both, axis=0)
        unit = both / np.where(length > 0, length, 1)
        shown = np.abs(np.diag(np.linalg.qr(unit, mode="r"))) > SEEN
        q, r = np.linalg.qr(unit[:, shown])
        inverse = np.linalg.inv(r)
        at, first = np.flatnonzero(shown), launch.shape[1]
        amplitude, covariance = np.zeros(len(shown)), np.zeros((len(shown),) * 2)
        amplitude[at] = inverse @ (q.T @ residual)
        covariance[np.ix_(at, at)] = inverse @ inverse.T
        slopes = np.zeros((len(shown), shared.shape[1]))
        slopes[at] = inverse @ (q.T @ shared)
        terms, rest = slice(first, None), shared - q @ (q.T @ shared)
        found = amplitude[terms], covariance[terms, terms], slopes[terms]
        return cls(shown[terms], length[terms], *found, rest.T @ rest, rest.T @ residual)

    def group(self, rows: list[int]) -> tuple[Array, Array, Array]:
        """Of some terms, all others free: pulls of unit variance, and those by a metre of each, by what is shared."""
        root = np.linalg.inv(np.linalg.cholesky(self.covariance[np.ix_(rows, rows)]))
        return root @ self.amplitude[rows], root * self.length[rows], root @ self.shared[rows]


def _results(parts: Sequence[_Part]) -> Iterator[tuple[str, float, int, float]]:
    """(against, chi^2, degrees of freedom, size in um) of one trial over all clips.

    The shared parameters are free; what the trial leaves of the clips tells of them too, as a few rows more.
    """
    values, axes = np.linalg.eigh(sum(g.information for g in parts))
    seen = values > SHOWN * values.max(initial=0)
    roots = np.sqrt(values[seen])
    rest = axes[:, seen].T @ sum(g.pull for g in parts) / roots
    pulls = np.concatenate([*(g.pulls for g in parts), rest])
    taken = _basis(np.concatenate([*(g.shared for g in parts), roots[:, None] * axes[:, seen].T]))
    left = pulls - taken @ (taken.T @ pulls)
    freedom = len(pulls) - taken.shape[1]
    if freedom:
        yield "", float(left @ left), freedom, _size(parts, left, freedom / len(pulls))
    if len(parts) < policy.FEWEST_CLIPS_OF_A_TREND:
        return
    always = _basis(np.column_stack([_stacked([g.per_metre for g in parts], len(rest)), taken]))
    for against in AGAINST:
        changing = [np.asarray(np.kron(g.features[against], g.per_metre)) for g in parts]
        basis = _basis(_stacked(changing, len(rest)), always)
        shown = basis.T @ pulls
        if len(shown):
            yield against, float(shown @ shown), len(shown), _size(parts, basis @ shown, len(shown) / len(pulls))


def _stacked(columns: Sequence[Array], rest: int) -> Array:
    """Of all clips, with zeros in the `rest` rows that tell of the shared parameters only."""
    return np.concatenate([*columns, np.zeros((rest, columns[0].shape[1]))])


def _basis(columns: Array, besides: Array | None = None) -> Array:
    """An orthonormal basis of what columns span, less what `besides`, orthonormal, spans."""
    length = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(length > 0, length, 1)
    if besides is not None:
        unit = unit - besides @ (besides.T @ unit)
    axes, sizes, _ = np.linalg.svd(unit, full_matrices=False)
    return np.asarray(axes[:, sizes > SPANNED])


def _size(parts: Sequence[_Part], pulls: Array, noisy: float) -> float:
    """rms displacement, um, that makes these pulls, less what noise makes: `noisy` of its directions are in them."""
    total, rows, first = 0.0, 0, 0
    for g in parts:
        metres = np.linalg.pinv(g.per_metre)
        terms = metres @ pulls[first : first + len(g.pulls)]
        total += float(terms @ g.squares @ terms - noisy * np.trace(metres.T @ g.squares @ metres))
        rows, first = rows + g.rows, first + len(g.pulls)
    return 1e6 * float(np.sqrt(max(total, 0.0) / rows))


def _corrected(chi2: float, dof: int, trials: int) -> float:
    p = trials * float(chdtrc(dof, chi2))
    if p >= 1:
        return 0.0
    return float(-ndtri(p / 2)) if p > 1e-250 else sigmas(chi2, dof)


def unexplained(left: Sequence[Place]) -> bool:
    """Whether what `locate` found is more than chance does."""
    return bool(left) and left[0].sigma > policy.UNEXPLAINED_SIGMA
