"""Locate disagreements of model and measurement: the phase, the ball, the direction, and the trend."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from scipy.special import chdtrc, ndtri

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, T_C, V0, B
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.predict import predict_tracks
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.policy import SearchPolicy, current_policy
from synthcam_shared.arrays import Array, Flags, Ints

Term = tuple[str, int, int]  # name, ball, axis
Where = tuple[str, int, int]  # phase, ball, axis
PhaseResult = tuple[str, float, int, float]  # what it changes with, chi^2, degrees of freedom, rms size in um


class MotionStage(IntEnum):
    """A stage of motion of one ball."""

    BEFORE = 0
    SLIDING = 1
    ROLLING = 2


@dataclass(frozen=True)
class Disagreement:
    """One test of the residuals of a ball in a phase, along or across its motion."""

    phase: str
    ball: str
    observable: str
    sigma: float  # corrected for the number of tests
    against: str = ""  # the quantity that the disagreement changes with between clips; "" for a test without a trend
    # rms of the disagreement in that phase, noise subtracted, um. NaN if the terms of the test nearly cancel, as with a
    # model that is wrong throughout.
    size: float = 0.0


# Displacement of a term in each stage: factor and power of the time since the stage began (before: until the contact).
# A velocity that a sliding ball gets decreases to 5/7 of it once the ball rolls, for any friction in between.
TERMS: dict[str, dict[MotionStage, tuple[float, int]]] = {
    **{f"before {power}": {MotionStage.BEFORE: (1.0, power)} for power in (1, 2, 3)},
    "offset": {MotionStage.SLIDING: (1.0, 0)},
    "drift": {MotionStage.SLIDING: (1.0, 1), MotionStage.ROLLING: (5 / 7, 1)},
    "slide's bend": {MotionStage.SLIDING: (1.0, 2)},
    "slide's twist": {MotionStage.SLIDING: (1.0, 3)},
    "roll's offset": {MotionStage.ROLLING: (1.0, 0)},
    "roll's drift": {MotionStage.ROLLING: (1.0, 1)},
    "roll's bend": {MotionStage.ROLLING: (1.0, 2)},
    "roll's twist": {MotionStage.ROLLING: (1.0, 3)},
}
# For each phase: the tested terms, the terms that are free beside them, and the powers of time that the reported size
# leaves out. A ball at rest has one power less.
PHASE_TESTS: dict[str, tuple[tuple[str, ...], tuple[str, ...], int]] = {
    "before": (("before 1", "before 2", "before 3"), tuple(TERMS)[3:], 2),
    "contact": (("offset", "drift"), ("slide's bend", "roll's offset", "roll's bend"), 0),
    "sliding": (
        ("slide's bend", "slide's twist"),
        ("offset", "drift", "roll's offset", "roll's drift", "roll's bend"),
        2,
    ),
    "rolling": (
        ("roll's bend", "roll's twist"),
        ("offset", "drift", "slide's bend", "roll's offset", "roll's drift"),
        2,
    ),
}


def find_disagreements(clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise) -> tuple[Disagreement, ...]:
    """Test where the residuals of a fit disagree with noise.

    In each clip, along and across each ball's motion, the residual is a polynomial of time in each stage. An offset
    and a drift right after the contact belong to the contact. In sliding and rolling only quadratic and higher terms
    count. Each test leaves the terms of all other phases free, and the shared parameters too. So it does not attribute
    a wrong contact to the rolling that follows. Each test gives a chi^2 over all clips, and one for a trend with speed,
    impact parameter, heading or position. Sigma is corrected for the number of tests (Bonferroni).
    """
    found = [*find_disagreements_by_phase(clips, fit, noise), *find_ripples(clips, fit, noise)]
    every = []
    for (phase, ball, axis), (against, chi2, dof, size) in found:
        p = len(found) * float(chdtrc(dof, chi2))
        sigma = 0.0 if p >= 1 else float(-ndtri(p / 2)) if p > 1e-250 else chi2_to_sigma(chi2, dof)
        every.append(Disagreement(phase, f"ball {ball + 1}", ("along", "across")[axis], sigma, against, size))
    return tuple(sorted(every, key=lambda x: -x.sigma))


def is_unexplained(disagreements: Sequence[Disagreement], policy: SearchPolicy) -> bool:
    """Tell if the largest disagreement of model and data exceeds what chance makes."""
    return bool(disagreements) and disagreements[0].sigma > policy.unexplained_sigma


def find_disagreements_by_phase(
    clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise
) -> Iterator[tuple[Where, PhaseResult]]:
    """Locate disagreements by phase, ball and axis: see `find_disagreements`."""
    return _test_clips(_phase_amplitudes, clips, fit, noise)


def _test_clips(
    amplitudes: Callable[..., Iterator[tuple[Where, ClipAmplitudes]]],
    clips: Sequence[MeasuredCollision],
    fit: ModelFit,
    noise: Noise,
) -> Iterator[tuple[Where, PhaseResult]]:
    """Make every test in all clips together; none where the shared parameters can make all that it sees."""
    found: dict[Where, list[ClipAmplitudes]] = {}
    size = np.sqrt(sum((s**2).sum(axis=0) for s in fit.slopes))
    unit = 1 / np.where(size > 0, size, 1)  # so that the derivatives by shared parameters have unit length
    for k, (clip, path) in enumerate(zip(clips, predict_tracks(fit.model, fit.launches, clips), strict=True)):
        for where, part in amplitudes(clip, path, fit, k, fit.slopes[k] * unit, noise):
            found.setdefault(where, []).append(part)
    for where, parts in found.items():
        for result in combine_clips(parts):
            yield where, result


def _phase_amplitudes(
    clip: MeasuredCollision, path: Array, fit: ModelFit, k: int, shared: Array, noise: Noise
) -> Iterator[tuple[Where, ClipAmplitudes]]:
    """Yield the amplitudes of one clip in every test."""
    stage, time = find_stages(clip)
    motion = find_motion_directions(clip, stage, path)
    white = ClipWhitener.of(clip, noise)
    roller = (1, "before 1")  # the launch absorbs a roller's drift
    # The same for a free stretch. Its start absorbs an offset and a drift, so the test has no such terms.
    stretch_tests: dict[str, tuple[tuple[str, ...], tuple[str, ...], int]] = {
        "sliding": (("slide's bend", "slide's twist"), ("roll's offset", "roll's drift", "roll's bend"), 2),
        "rolling": (("roll's offset", "roll's drift", "roll's bend", "roll's twist"), ("slide's bend",), 0),
    }
    tests = stretch_tests if clip.is_stretch else PHASE_TESTS
    for phase, (names, beside, powers) in tests.items():
        tested = [(name, b, a) for b in range(2) for a in range(2) for name in names if (b, name) != roller]
        terms = [(name, b, a) for b in range(2) for a in range(2) for name in beside]
        first = len(terms)
        terms += tested
        raw = np.stack([_column(t, stage, clip.ball, time, motion) for t in terms], axis=-1)
        if phase == "contact":  # an impact's natural measure
            raw[..., first:] *= fit.launches[k, V0]
        solved = ClipSolution.of(fit.launch_slopes[k], white(raw), fit.residuals[k], shared)
        for b in range(2):
            rows = np.isin(stage, [s for name in names for s in TERMS[name]]) & (clip.ball == b)
            for a in range(2):
                wanted = [j for j in range(first, len(terms)) if terms[j][1:] == (b, a)]
                mine = [j for j in wanted if solved.kept[j]]
                if not mine:
                    continue
                columns = np.einsum("na,nai->ni", motion[rows, a], raw[rows][..., mine])
                q, _ = np.linalg.qr(np.vander(time[rows], powers - (phase == "before" and b == 0)))
                columns = columns - q @ (q.T @ columns)  # without these powers of time
                features = _features(fit.launches[k], path[rows].mean(axis=0), motion[rows, a].mean(axis=0))
                products, off = columns.T @ columns, (clip.xy - path)[rows]
                yield (phase, b, a), solved.amplitudes(mine, wanted, products, off, features)


def _column(term: Term, stage: Ints, ball: Ints, time: Array, motion: Array) -> Array:
    """The displacement (n, 2) by one metre of a term."""
    name, b, a = term
    size = np.zeros(len(stage))
    for s, (factor, power) in TERMS[name].items():
        size += np.where((stage == s) & (ball == b), factor * time**power, 0.0)
    return np.asarray(size[:, None] * motion[:, a])


def _features(launch: Array, position: Array, direction: Array, scale_m: float = 0.02) -> dict[str, Array]:
    """Quantities that a clip's amplitude may change with. A force field counts by its part along the direction."""
    speed, heading, b = launch[[V0, HEADING, B]]
    x, y = position / scale_m
    field = np.array([1, x, y, x * x, x * y, y * y])
    return {
        "speed": np.array([speed, speed**2]),
        "impact parameter": np.array([b, abs(b), b * b]),
        "heading": np.array([np.cos(heading), np.sin(heading), np.cos(2 * heading), np.sin(2 * heading)]),
        "position": np.outer(direction, field).ravel(),
    }


# --- Ripples at the period of a ball's rotation ---


def find_ripples(
    clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise
) -> Iterator[tuple[Where, PhaseResult]]:
    """Test whether residuals ripple once or twice a turn of a ball.

    A ball makes ripples if it is out of round or loaded, or if the tracker follows a mark on it. A rolling ball turns
    once over pi times its diameter. Its initial orientation is unknown. So the ripple has a free phase in each stretch
    of rolling, before the contact and after the slide. Cubics of time are free beside the ripple.
    """
    return _test_clips(_ripple_amplitudes, clips, fit, noise)


def _ripple_amplitudes(
    clip: MeasuredCollision, path: Array, fit: ModelFit, k: int, shared: Array, noise: Noise
) -> Iterator[tuple[Where, ClipAmplitudes]]:
    """Yield the amplitudes of one clip in every test of a ripple."""
    white = ClipWhitener.of(clip, noise)
    for name, times in (("once a turn", 1), ("twice a turn", 2)):
        terms, raw = _ripple_terms(clip, path, times)
        if not terms:
            continue
        solved = ClipSolution.of(fit.launch_slopes[k], white(raw), fit.residuals[k], shared)
        for which in sorted({term for term in terms if term}):
            mine = [i for i, term in enumerate(terms) if term == which and solved.kept[i]]
            if mine:
                columns = raw[..., mine]
                products, rows = np.einsum("nai,naj->ij", columns, columns), (columns != 0).any(axis=(1, 2))
                yield (name, *which), solved.amplitudes(mine, mine, products, (clip.xy - path)[rows], {})


def _ripple_terms(
    clip: MeasuredCollision, path: Array, times: int, min_periods: float = 1.0, order: int = 3
) -> tuple[list[tuple[int, int] | None], Array]:
    """Ball and axis of each term, None for polynomials; displacements. A part of a period is a bend."""
    stage, _ = find_stages(clip)
    motion = find_motion_directions(clip, stage, path)
    smooth: list[Array] = []
    waves: dict[tuple[int, int], list[Array]] = {}
    for ball in range(2):
        for s in (MotionStage.BEFORE, MotionStage.ROLLING):
            rows = np.flatnonzero((stage == s) & (clip.ball == ball))
            steps = np.hypot(*np.diff(path[rows], axis=0).T)
            angle = times * (np.concatenate([[0.0], np.cumsum(steps)]) / (clip.camera.ball_diameter / 2))
            if len(rows) == 0 or angle[-1] < min_periods * 2 * np.pi:
                continue
            columns = np.column_stack(
                [np.vander(np.linspace(-1, 1, len(rows)), order + 1), np.cos(angle), np.sin(angle)]
            )
            for axis in range(2):
                along = np.zeros((len(stage), 2, columns.shape[1]))
                along[rows] = motion[rows, axis, :, None] * columns[:, None]
                smooth += list(np.moveaxis(along[..., :-2], -1, 0))
                waves.setdefault((ball, axis), []).extend(np.moveaxis(along[..., -2:], -1, 0))
    terms = [None] * len(smooth) + [which for which, each in waves.items() for _ in each]
    every = [*smooth, *(column for each in waves.values() for column in each)]
    return terms, np.stack(every, axis=-1) if every else np.zeros((len(stage), 2, 0))


# --- Stages of motion ---


def find_stages(clip: MeasuredCollision, unit_s: float = 0.05) -> tuple[Ints, Array]:
    """Find the stage (n,) of residuals, and the time in it or until the contact; events count as sliding."""
    opens = clip.frame / clip.fps
    closes, end, t_c = opens + clip.exposure, clip.slide_ends[clip.ball], clip.launch[T_C]
    stages = [MotionStage.BEFORE, MotionStage.ROLLING]
    stage = np.select([closes <= t_c, opens >= end], stages, MotionStage.SLIDING)
    middle = (opens + closes) / 2
    time = np.select([stage == s for s in stages], [t_c - middle, middle - end], middle - t_c)
    return stage, np.maximum(time, 0) / unit_s


def find_motion_directions(clip: MeasuredCollision, stage: Ints, path: Array, min_move_m: float = 1e-5) -> Array:
    """Find unit vectors along and across each ball's motion in each phase, (n, 2, 2), for the residuals."""
    heading = clip.launch[HEADING]
    along = np.tile([np.cos(heading), np.sin(heading)], (len(path), 1))
    for s in MotionStage:
        for b in range(2):
            rows = np.flatnonzero((stage == s) & (clip.ball == b))
            if len(rows) < 2:
                continue
            move = path[rows[-1]] - path[rows[0]]
            if np.hypot(*move) > min_move_m:
                along[rows] = move / np.hypot(*move)
    return np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)


# --- Amplitudes of terms, over all clips ---


@dataclass(frozen=True)
class ClipAmplitudes:
    """One clip's part in a test of P terms, of which the clip determines m combinations."""

    pulls: Array  # (m,): amplitudes, of unit variance
    per_metre: Array  # (m, P): pulls that a metre of each term makes
    shared: Array  # (m, S): pulls that a unit of each shared parameter makes
    # (S, S) and (S,): of the shared parameters, in the residuals that the terms leave
    information: Array
    pull: Array
    products: Array  # (P, P): products of the terms, m^2, summed over the rows
    rows: int
    residual_squares: float  # sum of squares of the residuals in these rows, m^2
    # the quantities that the amplitude may change with, and their values in this clip
    features: dict[str, Array]

    @cached_property
    def metres(self) -> Array:
        """Metres of each term that a pull makes, (P, m)."""
        return np.asarray(np.linalg.pinv(self.per_metre))

    @cached_property
    def noise_squares(self) -> float:
        """The sum of squares that pulls of unit variance make in the rows, m^2."""
        return float(np.trace(self.metres.T @ self.products @ self.metres))


@dataclass(frozen=True)
class ClipSolution:
    """Least squares of one clip: amplitudes of unit-length terms, a root of their covariance, and shared slopes.

    The covariance is root @ root.T. That of terms that are nearly dependent would be singular by rounding.
    `information` (S, S) and `pull` (S,) belong to the shared parameters, in the residuals that the terms leave.
    """

    kept: Flags
    length: Array
    amplitude: Array
    root: Array  # (T, k)
    shared: Array
    information: Array
    pull: Array

    @classmethod
    def of(cls, launch: Array, columns: Array, residual: Array, shared: Array, min_share: float = 1e-5) -> ClipSolution:
        """Fit whitened columns (2n, T) of terms beside the launch; of a term those before it must leave this share."""
        both = np.column_stack([launch, columns])
        length = np.linalg.norm(both, axis=0)
        unit = both / np.where(length > 0, length, 1)
        kept = length > 0
        q, r = np.linalg.qr(unit[:, kept])
        left = np.pad(np.abs(np.diag(r)) > min_share, (0, int(kept.sum()) - len(r)))
        if not left.all():
            kept[kept] = left
            q, r = np.linalg.qr(unit[:, kept])
        inverse = np.linalg.inv(r)
        at, first = np.flatnonzero(kept), launch.shape[1]
        amplitude, root = np.zeros(len(kept)), np.zeros((len(kept), len(at)))
        amplitude[at] = inverse @ (q.T @ residual)
        root[at] = inverse
        slopes = np.zeros((len(kept), shared.shape[1]))
        slopes[at] = inverse @ (q.T @ shared)
        terms, rest = slice(first, None), shared - q @ (q.T @ shared)
        return cls(
            kept=kept[terms],
            length=length[terms],
            amplitude=amplitude[terms],
            root=root[terms],
            shared=slopes[terms],
            information=rest.T @ rest,
            pull=rest.T @ residual,
        )

    def amplitudes(
        self, mine: list[int], wanted: list[int], products: Array, off: Array, features: dict[str, Array]
    ) -> ClipAmplitudes:
        """The clip's part in a test of the wanted terms, with all others free; it determines the terms `mine`.

        products: of the terms `mine`, as in the part. off (n, 2): the residuals in the rows of the test, m.
        """
        upper = np.linalg.qr(self.root[mine].T, mode="r")
        whiten = np.linalg.inv(upper * np.sign(np.diag(upper))[:, None]).T
        at, size = [wanted.index(j) for j in mine], len(wanted)
        per_metre, squares = np.zeros((len(mine), size)), np.zeros((size, size))
        per_metre[:, at], squares[np.ix_(at, at)] = whiten * self.length[mine], products
        return ClipAmplitudes(
            pulls=whiten @ self.amplitude[mine],
            per_metre=per_metre,
            shared=whiten @ self.shared[mine],
            information=self.information,
            pull=self.pull,
            products=squares,
            rows=len(off),
            residual_squares=float((off**2).sum()),
            features=features,
        )


def combine_clips(parts: Sequence[ClipAmplitudes], min_shared: float = 1e-6) -> Iterator[PhaseResult]:
    """Test a disagreement in all clips together: amplitudes of the residuals, with the shared parameters free.

    The clips also constrain the shared parameters outside the test. A few additional rows hold that. Directions of the
    shared parameters with less than `min_shared` of the largest information do not count.

    Yields the quantity that the amplitude changes with ("" without a trend), chi^2, degrees of freedom, rms size in um.
    """
    values, axes = np.linalg.eigh(sum(g.information for g in parts))
    seen = values > min_shared * values.max(initial=0)
    roots = np.sqrt(values[seen])
    rest = axes[:, seen].T @ sum(g.pull for g in parts) / roots
    pulls = np.concatenate([*(g.pulls for g in parts), rest])
    absorbed = _span(np.concatenate([*(g.shared for g in parts), roots[:, None] * axes[:, seen].T]))
    left = pulls - absorbed @ (absorbed.T @ pulls)
    freedom = len(pulls) - absorbed.shape[1]
    if freedom:
        yield "", float(left @ left), freedom, _rms_size(parts, left, freedom / len(pulls))
    if not parts[0].features or len(parts) < current_policy().min_clips_for_trend:
        return
    always = _span(np.column_stack([_stack_clips([g.per_metre for g in parts], len(rest)), absorbed]))
    for against in parts[0].features:
        changing = [np.asarray(np.kron(g.features[against], g.per_metre)) for g in parts]
        trend = _span(_stack_clips(changing, len(rest)), always)
        found = trend.T @ pulls
        if len(found):
            yield against, float(found @ found), len(found), _rms_size(parts, trend @ found, len(found) / len(pulls))


def _stack_clips(columns: Sequence[Array], rest: int) -> Array:
    """Stack the columns of all clips, with zeros in the `rest` rows that belong only to the shared parameters."""
    return np.concatenate([*columns, np.zeros((rest, columns[0].shape[1]))])


def _span(columns: Array, besides: Array | None = None, min_share: float = 1e-3) -> Array:
    """An orthonormal basis of columns, less the orthonormal `besides`; of a column the others must leave this share."""
    length = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(length > 0, length, 1)
    if besides is not None:
        unit = unit - besides @ (besides.T @ unit)
    axes, sizes, _ = np.linalg.svd(unit, full_matrices=False)
    return np.asarray(axes[:, sizes > min_share])


def _rms_size(parts: Sequence[ClipAmplitudes], pulls: Array, noisy: float) -> float:
    """The rms displacement, um, that makes these pulls, less the noise in this share; NaN if terms cancel."""
    total, rows, first = 0.0, 0, 0
    for g in parts:
        terms = g.metres @ pulls[first : first + len(g.pulls)]
        total += float(terms @ g.products @ terms) - noisy * g.noise_squares
        rows, first = rows + g.rows, first + len(g.pulls)
    if total > current_policy().max_disagreement_to_residual ** 2 * sum(g.residual_squares for g in parts):
        return float("nan")
    return 1e6 * float(np.sqrt(max(total, 0.0) / rows))
