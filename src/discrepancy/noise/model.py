"""Estimates the noise of measured tracks from the tracks: each ball's own noise, and the noise that both balls share.

Within one phase of motion (before the contact, sliding, rolling) a track is smooth, so the residuals from a cubic are
noise, whatever the physics. If a cubic does not follow a whole phase, noise over whole phases is many times that of
short pieces; the short pieces then decide.

A low-order autoregression, with or without white noise, is fitted to the residuals by restricted maximum likelihood
(REML). REML allows for the cubic's coefficients (Patterson & Thompson, Biometrika 58 (1971) 545). Schwarz's criterion
(BIC) selects the order. Noise that both balls share, as from a shaking camera, is in their sum but not in their
difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import TypeVar

import numpy as np
from scipy.linalg.lapack import dtbtrs, dtrtrs
from scipy.optimize import minimize
from scipy.special import expit, logit

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array, Ints
from synthcam_shared.errors import InputError

T = TypeVar("T")
Stretch = tuple[Array, Array, Ints]  # positions (n, axes), claimed standard deviations (n,), and frames (n,)
NoiseOrder = tuple[int, bool]  # order of an autoregression; whether there is white noise beside it
Pair = tuple[Array, Array, Array, Array, Ints]  # positions (n, 2) of both balls, claimed std (n,) of both, frames (n,)

CUBIC_COEFFICIENTS = 4
MAX_PARTIAL_AUTOCORRELATION = 0.999  # beyond it a clip cannot distinguish it from 1
SHARED_NOISE_CORRELATIONS = (0.0, 0.7, 0.97)  # from frame to frame, at which shared noise is tested
MIN_WHITE_SHARE, MAX_WHITE_SHARE = 1e-9, 0.99
Shut = tuple[Array, Array, float, float, Ints]  # a pair: positions less their mean, claimed rms of each, frames


@dataclass(frozen=True)
class NoiseComponent:
    """A stationary random error: an autoregression plus white noise."""

    variance: float
    partial_autocorrelations: tuple[float, ...] = ()  # of the autoregression, lag 1 first
    white_share: float = 0.0  # the share of the variance that is white

    @lru_cache(maxsize=64)  # noqa: B019
    def autocovariances(self, count: int) -> Array:
        """Autocovariance at lags 0 to count - 1 by Durbin and Levinson; the clips of a likelihood ask for the same."""
        out = np.ones(max(count, len(self.partial_autocorrelations) + 1))
        weights = np.zeros(0)
        for m, p in enumerate(self.partial_autocorrelations, 1):
            out[m] = weights @ out[m - 1 : 0 : -1] + p * (1 - weights @ out[1:m])
            weights = np.append(weights - p * weights[::-1], p)
        order = len(weights)
        out[order + 1 :] = 0
        # each later lag follows from the `order` lags before it: equations with a lower triangle of `order` + 1 bands
        bands = np.ones((order + 1, len(out)))
        for back, weight in enumerate(weights, 1):
            bands[back] = np.where(np.arange(len(out)) + back > order, -weight, 0.0)
        out = dtbtrs(bands, out[:, None], uplo="L")[0][:, 0]
        out[1:] *= 1 - self.white_share
        lags: Array = self.variance * out[:count]
        lags.flags.writeable = False
        return lags


@dataclass(frozen=True)
class Noise:
    """The noise of measured tracks."""

    own: NoiseComponent  # of each ball and axis by itself, in claimed standard deviations
    shared: tuple[NoiseComponent, ...] = ()  # that both balls share, in x and in y, m^2; empty if there is none
    # Like `scale`, over whole phases of motion, if that is so much larger that it must contain motion. The noise is
    # then that of short pieces. Else 0.
    whole_phase_scale: float = 0.0
    frame_spacing: int = 1  # greatest common divisor of the tracks' frame steps: noise at other lags is not seen

    @property
    def scale(self) -> float:
        """The ratio of a ball's own noise to the claimed noise."""
        return float(np.sqrt(self.own.variance))

    @property
    def correlation(self) -> float:
        """Correlation of a ball's own noise between neighbouring frames."""
        lags = self.own.autocovariances(2)
        return float(lags[1] / lags[0])

    @property
    def innovation_scale(self) -> float:
        """Like `scale`, of the innovation from frame to frame: all of white noise, little of slow noise."""
        own = self.own
        news = float(np.prod([1 - p * p for p in own.partial_autocorrelations]))
        return self.scale * float(np.sqrt(own.white_share + (1 - own.white_share) * news))

    @property
    def is_slow(self) -> bool:
        """True if it is so correlated that it may contain missing physics (`SearchPolicy.slow_noise_ratio`)."""
        return self.scale > current_policy().slow_noise_ratio * self.innovation_scale

    @property
    def is_smoothed(self) -> bool:
        """True if a filter smoothed the tracks: its window ends, so the partial correlation two apart is negative."""
        if len(self.own.partial_autocorrelations) < 2:
            return False
        size, near, far = self.own.autocovariances(2 * self.frame_spacing + 1)[:: self.frame_spacing]
        return bool((far * size - near**2) / (size**2 - near**2) < current_policy().smoothed_partial_correlation)

    @property
    def common_mode_rms(self) -> float:
        """rms of the noise that both balls share, per axis, m."""
        return float(np.sqrt(np.mean([s.variance for s in self.shared]))) if self.shared else 0.0


@dataclass(frozen=True)
class StretchBundle:
    """k stretches of about the same length, the longest of n positions."""

    values: Array  # (k, n, d) positions without their cubics, in claimed deviations; zero beyond a stretch's end
    basis: Array  # (k, n, CUBIC_COEFFICIENTS) an orthonormal basis of the cubics, in claimed deviations
    lengths: Ints  # (k,)
    frames: Ints | None = None  # (k, n) from each first one, continued beyond its end; None if no frame is missing

    @classmethod
    def of(cls, stretches: Sequence[Stretch]) -> StretchBundle:
        """Bundle stretches."""
        lengths = np.array([len(frames) for *_, frames in stretches])
        longest, axes = int(lengths.max()), stretches[0][0].shape[1]
        since = np.tile(np.arange(longest), (len(stretches), 1))
        cubics, rest = (
            np.zeros((len(stretches), longest, CUBIC_COEFFICIENTS)),
            np.zeros((len(stretches), longest, axes)),
        )
        for k, (positions, claimed, frames) in enumerate(stretches):
            n = len(positions)
            since[k, :n] = frames - frames[0]
            since[k, n:] = since[k, n - 1] + 1 + np.arange(longest - n)
            powers, own = cubic_basis(since[k, :n]) / claimed[:, None], positions / claimed[:, None]
            q, _ = np.linalg.qr(powers)
            cubics[k, :n], rest[k, :n] = q, own - q @ (q.T @ own)
        return cls(rest, cubics, lengths, since if np.any(np.diff(since) != 1) else None)

    @property
    def span(self) -> int:
        """Frames from the first to the last, both counted."""
        return int(self.lengths.max()) if self.frames is None else int(self.frames.max()) + 1

    @cached_property
    def _lags(self) -> Ints:
        """Frames between each two positions, (n, n), or (k, n, n) where frames are missing."""
        rows = np.arange(self.values.shape[1]) if self.frames is None else self.frames
        lags: Ints = np.abs(rows[..., :, None] - rows[..., None, :])
        return lags

    @cached_property
    def _columns(self) -> Array:
        """Basis and values of each stretch, (k, CUBIC_COEFFICIENTS + d, n)."""
        return np.ascontiguousarray(np.concatenate([self.basis, self.values], axis=2).swapaxes(1, 2))

    def covariance(self, lags: Array) -> Array:
        """Covariance from autocovariances at lags 0 to span - 1: (n, n), or (k, n, n) where frames are missing."""
        return np.asarray(lags[self._lags])

    def restricted_likelihood(self, covariance: Array) -> tuple[float, float]:
        """(log determinants, sum of squares) of REML's -2 log likelihood, for a covariance (n, n) or (k, n, n).

        A shorter stretch uses the first rows and columns: their inverse Cholesky factor is the first part of the
        whole one's. See Harville, Biometrika 61 (1974) 383.
        """
        inside, columns = np.arange(self.values.shape[1]) < self.lengths[:, None], self._columns
        factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        if factor.ndim == 2:
            white = _whiten(factor, columns.reshape(-1, columns.shape[2])).reshape(columns.shape)
        else:
            white = np.array([_whiten(own, part) for own, part in zip(factor, columns, strict=True)])
        white *= inside[:, None]
        products = white @ white.swapaxes(1, 2)
        gram, pull = np.split(products[:, :CUBIC_COEFFICIENTS], [CUBIC_COEFFICIENTS], axis=2)
        seen = products[:, CUBIC_COEFFICIENTS:, CUBIC_COEFFICIENTS:]
        squares = np.trace(seen, axis1=1, axis2=2).sum() - (pull * np.linalg.solve(gram, pull)).sum()
        logs = (np.log(np.diagonal(factor, axis1=-2, axis2=-1)) * inside).sum() + np.linalg.slogdet(gram)[1].sum() / 2
        return float(2 * self.values.shape[2] * logs), float(squares)

    @property
    def freedom(self) -> int:
        return int((self.lengths - CUBIC_COEFFICIENTS).sum()) * int(self.values.shape[2])


def _whiten(factor: Array, rows: Array) -> Array:
    """Whiten rows (m, n) of correlated numbers, by the lower Cholesky factor (n, n) of their covariance."""
    return np.asarray(dtrtrs(factor.T, rows.T, lower=0, trans=1)[0].T)  # neither array is copied to turn it


def cubic_basis(since: Ints) -> Array:
    """Make the cubics of smooth motion beside which noise is seen: powers 3 to 0 of frames, (n, CUBIC_COEFFICIENTS)."""
    even = np.linspace(-1, 1, since[-1] - since[0] + 1)
    return np.vander(even[since - since[0]], CUBIC_COEFFICIENTS)


def group_by_length(lengths: Sequence[int], ratio: float = 1.4) -> list[list[int]]:
    """Choose which smooth stretches the noise model bundles: the longest is at most `ratio` times the shortest."""
    out: list[list[int]] = []
    least = find_shortest_usable_length(lengths)
    for k in sorted(range(len(lengths)), key=lambda k: -lengths[k]):
        if lengths[k] >= least:
            if not out or lengths[out[-1][0]] > ratio * lengths[k]:
                out.append([])
            out[-1].append(k)
    return out


def find_shortest_usable_length(lengths: Sequence[int]) -> int:
    """Positions that a stretch must have to show noise; fewer where no stretch is long."""
    enough = max(lengths, default=0) >= current_policy().min_stretch_positions
    return current_policy().min_stretch_positions if enough else current_policy().min_short_stretch_positions


def bundle_stretches(stretches: Iterable[Stretch]) -> list[StretchBundle]:
    """Bundle by length those stretches that are long enough to show noise."""
    every = list(stretches)
    groups = group_by_length([len(frames) for *_, frames in every])
    return [StretchBundle.of([every[k] for k in group]) for group in groups]


def estimate_noise(clips: Sequence[MeasuredCollision]) -> Noise:
    """Estimate the noise of tracks, own and shared, from the smooth stretches of clips.

    Clips that are much noisier than the median clip are left out. Shared noise is fitted if its score exceeds
    `SearchPolicy.shared_noise_sigma`.

    Raises
    ------
    InputError
        The stretches are too few, or show no noise.
    """
    power = np.array([_measure_power(clip.smooth_stretches()) for clip in clips])
    most = current_policy().max_clip_noise_power * float(np.median(power[power > 0] if power.any() else [0.0]))
    clips = [clip for clip, own in zip(clips, power, strict=True) if own <= most]
    stretches = [stretch for clip in clips for stretch in clip.smooth_stretches()]
    spacing = int(np.gcd.reduce([step for *_, frames in stretches for step in np.diff(frames)] or [1]))
    noise = Noise(fit_own_noise(stretches), frame_spacing=spacing)
    pairs = BallPairs(pair for clip in clips for pair in clip.paired_stretches())
    if pairs.common_mode_score(noise.own) > current_policy().shared_noise_sigma:
        return replace(pairs.noise(), frame_spacing=noise.frame_spacing)
    cut = all(clip.is_stretch for clip in clips)
    return _exclude_motion(noise, stretches, cut) if noise.is_slow else noise


def _exclude_motion(noise: Noise, stretches: Sequence[Stretch], cut: bool = False) -> Noise:
    """The noise, or that of short pieces if it contains motion; cut: of stretches, where a cubic takes it up."""
    short = replace(noise, own=fit_own_noise(_cut_pieces(stretches)), whole_phase_scale=noise.scale)
    policy, left = current_policy(), np.sqrt(_measure_power(stretches))
    exceeds = cut or left > policy.min_cubic_residual_ratio * short.scale
    return short if exceeds and noise.scale > policy.max_noise_growth * short.scale else noise


def _measure_power(stretches: Iterable[Stretch]) -> float:
    """Mean square of the residuals from cubics, in claimed variances; 0 where stretches are too short."""
    every = bundle_stretches(stretches)
    freedom = sum(bundle.freedom for bundle in every)
    return sum(float((bundle.values**2).sum()) for bundle in every) / freedom if freedom else 0.0


def _cut_pieces(stretches: Sequence[Stretch]) -> list[Stretch]:
    """Pieces so short that a cubic follows any motion, without those of an event or of a repeated position."""
    rounding = 1e-9  # of the claimed variance
    size = current_policy().min_short_stretch_positions
    cut = [
        (positions[k : k + size], claimed[k : k + size], frames[k : k + size])
        for positions, claimed, frames in stretches
        for k in range(0, len(frames) - size + 1, size)
    ]
    power = (StretchBundle.of(cut).values ** 2).sum(axis=(1, 2))
    moves = power > rounding
    most = current_policy().max_piece_noise_power * float(np.median(power[moves] if moves.any() else power))
    return [piece for piece, own in zip(cut, power, strict=True) if rounding < own <= most]


def fit_own_noise(stretches: Iterable[Stretch]) -> NoiseComponent:
    """Fit the noise of single tracks to stretches, each within one phase. Raises ValueError if there are too few."""
    every = bundle_stretches(stretches)
    if not every:
        raise InputError("the tracks: too few consecutive frames to estimate the noise")
    longest = max(b.span for b in every)
    freedom = sum(b.freedom for b in every)

    def profile(component: NoiseComponent) -> tuple[float, float]:
        """(-2 log likelihood at the best variance, that variance)."""
        lags = component.autocovariances(longest)
        parts = [b.restricted_likelihood(b.covariance(lags)) for b in every]
        logs, squares = (sum(p[k] for p in parts) for k in (0, 1))
        if not squares > 0:
            raise InputError("the tracks: positions show no noise from frame to frame")
        return logs + freedom * np.log(squares / freedom), squares / freedom

    orders: tuple[NoiseOrder, ...] = ((0, False), (1, False), (1, True), (2, False), (3, False), (5, False))
    unit = select_order(
        orders, lambda shape, x: component_from_numbers(shape, 1.0, x), lambda c: profile(c)[0], np.log(freedom)
    )
    return replace(unit, variance=profile(unit)[1])


def component_from_numbers(shape: NoiseOrder, variance: float, x: Array) -> NoiseComponent:
    """Make a component of the noise from unbounded numbers: arctanh of partial autocorrelations, logit of a share."""
    order, white = shape
    part = MIN_WHITE_SHARE + (MAX_WHITE_SHARE - MIN_WHITE_SHARE) * float(expit(x[order])) if white else 0.0
    return NoiseComponent(variance, tuple((MAX_PARTIAL_AUTOCORRELATION * np.tanh(x[:order])).tolist()), part)


def numbers_from_component(component: NoiseComponent) -> Array:
    """Turn a component of the noise back into unbounded numbers, without the variance."""
    shares = np.array(component.partial_autocorrelations) / MAX_PARTIAL_AUTOCORRELATION
    x = np.arctanh(np.clip(shares, -1 + 1e-9, 1 - 1e-9))
    if not component.white_share:
        return x
    white = (component.white_share - MIN_WHITE_SHARE) / (MAX_WHITE_SHARE - MIN_WHITE_SHARE)
    return np.append(x, logit(np.clip(white, 1e-3, 1 - 1e-3)))


def order_of(component: NoiseComponent) -> NoiseOrder:
    """Return the order of a noise model that has this component."""
    return len(component.partial_autocorrelations), component.white_share > 0


def noise_from_numbers(shape: NoiseOrder, common: NoiseOrder | None, x: Array) -> Noise:
    """Make the noise from unbounded numbers x: log variance and numbers of the own component, then of the shared ones.

    shape, common: orders of the own and of the shared component; None without shared noise. The shared component has a
    log variance for each axis; its other numbers are the same for both.
    """
    own = component_from_numbers(shape, float(np.exp(x[0])), x[1:])
    if common is None:
        return Noise(own)
    rest = x[1 + sum(shape) :]
    return Noise(own, tuple(component_from_numbers(common, float(np.exp(v)), rest[2:]) for v in rest[:2]))


def select_order(
    shapes: Sequence[NoiseOrder],
    build: Callable[[NoiseOrder, Array], T],
    cost: Callable[[T], float],
    penalty: float,
    common: Array | None = None,
) -> T:
    """Build the noise model of the order with the least cost + penalty per number (Schwarz's criterion).

    The search ends when two orders in a row do not improve it.

    shapes: orders to try, simple ones first.
    build: makes a model from an order and numbers.
    cost: its -2 log likelihood.
    common (k,): start values of numbers that every order has, before its own.
    """
    head = np.zeros(0) if common is None else common
    best, winner, last, tail, lost = np.inf, build(shapes[0], head), shapes[0], np.zeros(0), 0
    for shape in shapes:
        known = tail[: min(last[0], shape[0])]
        start = np.array([*np.ones(shape[0]), 0.0]) if shape[1] else np.append(known, np.zeros(shape[0] - len(known)))

        def cost_of(x: Array, shape: NoiseOrder = shape) -> float:
            return cost(build(shape, x))

        x = minimise_cost(cost_of, np.concatenate([head, start]))
        paid = finite_cost(cost_of, x) + penalty * len(x)
        lost = 0 if paid < best else lost + 1
        if paid < best:
            best, winner, last = paid, build(shape, x), shape
            head, tail = x[: len(head)], x[len(head) :]
        if lost == 2:
            break
    return winner


def finite_cost(cost: Callable[[Array], float], x: Array) -> float:
    """Compute the cost of a noise model; a very large number where a covariance is singular or the cost not finite."""
    impossible = 1e12  # -2 log likelihood
    try:
        with np.errstate(all="ignore"):
            value = cost(x)
    except np.linalg.LinAlgError:
        return impossible
    return value if np.isfinite(value) else impossible


def minimise_cost(cost: Callable[[Array], float], start: Array) -> Array:
    """Minimise the smooth cost of a noise model (BFGS). A slope of 2 is flat enough: the curvature is some hundreds."""
    if not len(start):
        return start
    safe = partial(finite_cost, cost)
    return np.asarray(minimize(safe, start, method="BFGS", options={"eps": 1e-4, "gtol": 2.0, "maxiter": 40}).x)


class BallPairs:
    """Both balls in the same frames, each in one phase: their sum holds what they share, their difference does not."""

    def __init__(self, pairs: Iterable[Pair]):
        given = list(pairs)
        least = find_shortest_usable_length([len(one) for one, *_ in given])
        self.pairs = [
            (one - one.mean(axis=0), two - two.mean(axis=0), *(float(np.sqrt(np.mean(c**2))) for c in claims), frame)
            for one, two, *claims, frame in given
            if len(one) >= least
        ]
        self.differences, self.sums, self.weights = list[StretchBundle](), list[list[StretchBundle]](), list[Array]()
        for group in group_by_length([len(one) for one, *_ in self.pairs]):
            pairs = [self.pairs[k] for k in group]
            size = np.array([np.hypot(*pair[2:4]) for pair in pairs])
            claimed = [np.full(len(pair[0]), s) for pair, s in zip(pairs, size, strict=True)]
            some = [(one, two, c, frames) for (one, two, _, _, frames), c in zip(pairs, claimed, strict=True)]
            self.differences.append(StretchBundle.of([(one - two, c, frames) for one, two, c, frames in some]))
            sums = [[((one + two)[:, [axis]], c, frames) for one, two, c, frames in some] for axis in (0, 1)]
            self.sums.append([StretchBundle.of(along) for along in sums])
            self.weights.append(4 / size[:, None, None] ** 2)  # of the shared variance in the sum's, own being 1
        self.longest = max((b.span for b in self.differences), default=0)

    def common_mode_score(self, own: NoiseComponent) -> float:
        """The most significant score of shared noise over correlations and axes, in sigma under independence.

        The score is the sum of u0' K u1, with K the kernel of shared noise. Here u is A times a ball's positions
        without their cubic, and A is the inverse covariance. Under independence its mean is zero and its variance is
        the sum of tr(K A K A) (a score test; Rao, Proc. Camb. Phil. Soc. 44 (1948) 50).
        """
        scores, variances = np.zeros((len(SHARED_NOISE_CORRELATIONS), 2)), np.zeros(len(SHARED_NOISE_CORRELATIONS))
        lags = own.autocovariances(self.longest)
        groups: dict[tuple[int, ...], list[Shut]] = {}
        for pair in self.pairs:
            groups.setdefault(tuple((pair[4] - pair[4][0]).tolist()), []).append(pair)
        for frames, members in groups.items():
            since = np.array(frames)
            apart = np.abs(since[:, None] - since)
            both, claims = np.array([p[:2] for p in members]), np.array([p[2:4] for p in members])
            factor = np.linalg.cholesky(lags[apart])
            q, _ = np.linalg.qr(np.linalg.solve(factor, cubic_basis(since)))
            root = np.linalg.inv(factor) - q @ np.linalg.solve(factor.T, q).T
            weight = root.T @ root
            pulls = weight @ both / (claims**2)[..., None, None]
            scale = float(np.sum(1 / claims.prod(axis=1) ** 2))
            for j, rho in enumerate(SHARED_NOISE_CORRELATIONS):
                kernel = rho ** apart.astype(float)
                scores[j] += np.einsum("kma,mn,kna->a", pulls[:, 0], kernel, pulls[:, 1])
                variances[j] += np.trace(kernel @ weight @ kernel @ weight) * scale
        if not self.pairs:
            return 0.0
        single = scores / np.sqrt(variances)[:, None]
        return float(max(single.max(), (single.sum(axis=1) / np.sqrt(2)).max()))

    def cost(self, noise: Noise) -> float:
        """-2 log likelihood, up to a constant."""
        own = noise.own.autocovariances(self.longest)
        shared = [s.autocovariances(self.longest) for s in noise.shared]
        out = 0.0
        for difference, sums, weight in zip(self.differences, self.sums, self.weights, strict=True):
            alone = difference.covariance(own)
            out += sum(difference.restricted_likelihood(alone))
            if shared:
                wholes = [alone + weight * s.covariance(lags) for s, lags in zip(sums, shared, strict=True)]
            else:
                wholes = [alone, alone]
            out += sum(sum(s.restricted_likelihood(whole)) for s, whole in zip(sums, wholes, strict=True))
        return out

    def own(self) -> NoiseComponent:
        """The noise that the balls do not share, from the difference of their positions."""
        return fit_own_noise(
            ((one - two) / float(np.hypot(*sizes)), np.ones(len(one)), frame) for one, two, *sizes, frame in self.pairs
        )

    def noise(self) -> Noise:
        """Fit own and shared noise together."""
        alone = self.own()
        shape = order_of(alone)
        shared = 0.5 * alone.variance * float(np.mean([np.square(p[2:4]) for p in self.pairs]))
        start = np.array([np.log(alone.variance), *numbers_from_component(alone), np.log(shared), np.log(shared)])
        freedom = 2 * sum(d.freedom for d in self.differences)
        orders: tuple[NoiseOrder, ...] = ((0, False), (1, False), (1, True), (2, False))  # of the noise of both balls
        return select_order(
            orders, lambda common, x: noise_from_numbers(shape, common, x), self.cost, np.log(freedom), start
        )
