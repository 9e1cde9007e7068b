"""Noise that lasts from frame to frame, read where balls roll or rest freely: before the contact, after the slides.

There a cubic describes the motion, whatever the impact did. Size and correlation of what it leaves are found by
restricted maximum likelihood, which counts what the cubics take up (Patterson & Thompson 1971).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracker.measurement.collision.collision_model import FREE
from tracker.measurement.collision.least_squares import BallPair, CollisionFit, WhitenedResiduals
from tracker.measurement.noise.position_noise import ScatterRatio, measure_scatter, share_seen_by_scatter
from tracker.measurement.noise.whitening import innovations
from tracker.measurement.positions import BallTrack

Floats = NDArray[np.float64]
ORDER = 3  # of the polynomial
FEWEST = 12  # positions in a stretch that is used
# Correlations that are tried, from 0 to .972. There the noise is 4 times its scatter from frame to frame; what lasts
# longer is motion that the model lacks, and no error of positions.
TRIED = np.tanh(np.linspace(0, 2.125, 18))
NOTICEABLE = 3.0  # standard errors of the correlation of neighbouring residuals, from which on it is fitted
LARGEST = (
    9.0  # of an encoder's errors' variance, over that which pixels and scatter show: beyond, the motion is another
)
# Variance from frame to frame that lasting errors would have, over what is seen: beyond, a cubic does not describe the
# motion (a ball that is pushed), and what it leaves is no error. Chosen: twice the error.
UNSEEN = 4.0
CLEAR = 10.0  # gain in the logarithm of the likelihood: beyond four standard errors


def with_correlated_noise(pair: BallPair, free: CollisionFit) -> BallPair | None:
    """The pair with errors of the size and the correlation from frame to frame that its tracks show.

    Parameters
    ----------
    pair : Pair
    free : Fit
        A free fit of it, which says when the balls roll.

    Returns
    -------
    Pair or None
        None where the errors are not clearly correlated, or no ball rolls for long enough to tell, or what a cubic
        leaves cannot be errors, for it would scatter more from frame to frame than it does.
    """
    if pair.striker.encoded:
        return _with_codec_errors(pair, free)
    if _neighbour_correlation(free) < NOTICEABLE:
        return None
    parts = [_whiten_with_cubics(stretch) for stretch in _rolling_stretches(pair, free)]
    if not parts:
        return None
    gains, sizes = zip(*(_restricted_likelihood(parts, float(rho)) for rho in TRIED), strict=True)
    best = int(np.argmax(gains))
    if gains[best] - gains[0] < CLEAR:
        return None
    size, rho = sizes[best], float(TRIED[best])
    quick = measure_scatter([track for _, track in pair.balls])
    if quick is not None and size.ratio * share_seen_by_scatter(rho) > UNSEEN * quick.ratio:
        return None
    struck, striker = (replace(track.scale_errors(size), rho=rho) for _, track in pair.balls)
    return replace(pair, struck=struck, striker=striker)


def _with_codec_errors(pair: BallPair, free: CollisionFit) -> BallPair | None:
    """The pair with errors as large as a free fit leaves, if that is more, and not too much for an encoder's.

    An encoder's errors are uneven: neither single pixels nor a few frames show their size. They last where a ball
    creeps, which `fixed` stands for.
    """
    size = ScatterRatio(free.chi2 / max(free.dof, 1), float(max(free.dof, 1)))
    if not size.sigmas > NOTICEABLE or size.ratio > LARGEST:
        return None
    struck, striker = (track.scale_errors(size) for _, track in pair.balls)
    return replace(pair, struck=struck, striker=striker)


def _neighbour_correlation(free: CollisionFit) -> float:
    """Correlation of neighbouring residuals of a free fit, in standard errors."""
    problem = WhitenedResiduals(free.pair, False)
    left = problem.residual(free.parameters[problem.index])[: 2 * len(free.pair)].reshape(-1, 2)
    cut = len(free.pair.struck)
    products = np.concatenate([part[1:] * part[:-1] for part in (left[:cut], left[cut:])])
    return float(products.mean() * np.sqrt(products.size) / max(float((left**2).mean()), 1e-300))


def _rolling_stretches(pair: BallPair, free: CollisionFit) -> Iterator[BallTrack]:
    """Each ball before the contact and after its slide, a frame away from either."""
    for ball, track in pair.balls:
        t_c, frame = free.parameters[0], float(np.median(np.diff(track.start))) if len(track) > 1 else 0.0
        end = t_c + np.exp(free.parameters[FREE.index(f"log_tau{ball}")])
        for rows in (track.start + track.exposure < t_c - frame, track.start > end + frame):
            if rows.sum() >= FEWEST:
                yield track.where(rows)


def _whiten_with_cubics(track: BallTrack) -> tuple[Floats, NDArray[np.int64]]:
    """Cubics of either axis and positions, whitened by what is claimed, (9, 2n); frames (n,)."""
    powers = np.interp(track.frame, [track.frame[0], track.frame[-1]], [-1, 1])[:, None] ** np.arange(ORDER + 1)
    columns = np.zeros((2 * ORDER + 3, len(track), 2))
    for axis in (0, 1):
        columns[axis * (ORDER + 1) : (axis + 1) * (ORDER + 1), :, axis] = powers.T
    columns[-1] = track.position - track.position.mean(axis=0)
    return replace(track, rho=0.0).whiten(columns), track.frame


def _restricted_likelihood(parts: list[tuple[Floats, NDArray[np.int64]]], rho: float) -> tuple[float, ScatterRatio]:
    """Logarithm of the restricted likelihood at a correlation, with the size that maximises it."""
    squares, freedom, volume = 0.0, 0, 0.0
    for columns, frame in parts:
        kept = rho ** np.diff(frame) if rho else np.zeros(len(frame) - 1)
        r = np.linalg.qr(innovations(columns, kept).T, mode="r")
        size = np.abs(np.diag(r))
        squares += float(size[-1] ** 2)
        freedom += columns.shape[1] - len(columns) + 1
        volume += float(np.log1p(-(kept**2)).sum()) + float(np.log(np.maximum(size[:-1], 1e-300)).sum())
    squares = max(squares, 1e-20)
    return -freedom / 2 * np.log(squares) - volume, ScatterRatio(squares / freedom, float(freedom))
