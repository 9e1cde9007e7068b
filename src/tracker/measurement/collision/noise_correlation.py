"""Noise that is correlated from frame to frame, measured where balls roll or rest freely.

Before the contact and after the slides a cubic describes the motion, whatever the impact. Restricted maximum likelihood
gives the size and the correlation of its residuals. It accounts for the degrees of freedom of the cubics (Patterson &
Thompson 1971).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from synthcam_shared.arrays import Array, Ints
from tracker.measurement.collision.collision_model import FREE
from tracker.measurement.collision.least_squares import BallPair, CollisionFit
from tracker.measurement.noise.position_noise import ScatterRatio, measure_scatter, share_seen_by_scatter
from tracker.measurement.noise.whitening import compute_innovations

MIN_CORRELATION_SIGMA = 3.0  # standard errors of the correlation of neighbouring residuals, from which on it is fitted


def with_correlated_noise(pair: BallPair, free: CollisionFit) -> BallPair | None:
    """Give two balls the noise that their tracks show: its size and its correlation from frame to frame.

    Its free fit says when the balls roll. The result is None if the errors are not clearly correlated, or if no ball
    rolls for long enough. It is also None if the residuals of the cubics cannot be errors, because those would scatter
    more from frame to frame.
    """
    if pair.striker.encoded:
        return _with_codec_errors(pair, free)
    if _neighbour_correlation(free)[1] < MIN_CORRELATION_SIGMA:
        return None
    parts = list(_whiten_with_cubics(pair, free))
    if not parts:
        return None
    # At a correlation of .972 the noise is 4 times its scatter from frame to frame. Longer-lived residuals are motion
    # that the model lacks, and no errors of positions.
    tried = np.tanh(np.linspace(0, 2.125, 18))
    gains, sizes = zip(*(_restricted_likelihood(parts, float(rho)) for rho in tried), strict=True)
    best = int(np.argmax(gains))
    # a gain of 10 in the logarithm of the likelihood is beyond four standard errors
    if gains[best] - gains[0] < 10.0:
        return None
    size, rho = sizes[best], float(tried[best])
    quick = measure_scatter([track for _, track in pair.balls])
    # Correlated errors of this size would scatter from frame to frame by more than twice the observed scatter. Then the
    # ball is pushed, a cubic does not describe its motion, and the residuals are not errors.
    if quick is not None and size.ratio * share_seen_by_scatter(rho) > 4.0 * quick.ratio:
        return None
    struck, striker = (replace(track.scale_errors(size), rho=rho) for _, track in pair.balls)
    return replace(pair, struck=struck, striker=striker)


def _with_codec_errors(pair: BallPair, free: CollisionFit) -> BallPair | None:
    """The pair with errors as large as the residuals of a free fit, within what an encoder can cause.

    The errors of an encoder are uneven: single pixels or a few frames do not show their size. They persist where a
    ball creeps; `fixed` describes that.
    """
    size = ScatterRatio(free.chi2 / max(free.dof, 1), float(max(free.dof, 1)))
    # Beyond 9 times the variance that pixels and scatter show, the motion is another than the model.
    if not size.sigmas > MIN_CORRELATION_SIGMA or size.ratio > 9.0:
        return None
    struck, striker = (track.scale_errors(size) for _, track in pair.balls)
    return replace(pair, struck=struck, striker=striker)


def variance_of_residuals(free: CollisionFit) -> float:
    """Factor on the variances of a rejected free fit for noise as large and as correlated as its residuals.

    Residuals that are correlated by rho from frame to frame count as (1 - rho)/(1 + rho) of their number.
    """
    rho, _ = _neighbour_correlation(free)
    rho = min(max(rho, 0.0), 0.98)
    return max(free.chi2 / max(free.dof, 1), 1.0) * (1 + rho) / (1 - rho)


def _neighbour_correlation(free: CollisionFit) -> tuple[float, float]:
    """Correlation of neighbouring residuals of a free fit, and the same in standard errors."""
    left = free.linearised[1][: 2 * len(free.pair)].reshape(-1, 2)
    cut = len(free.pair.struck)
    products = np.concatenate([part[1:] * part[:-1] for part in (left[:cut], left[cut:])])
    rho = float(products.mean() / max(float((left**2).mean()), 1e-300))
    return rho, rho * float(np.sqrt(products.size))


def _whiten_with_cubics(pair: BallPair, free: CollisionFit) -> Iterator[tuple[Array, Ints]]:
    """Cubics of either axis and positions, whitened by the claimed errors, (9, 2n); frames (n,).

    They are those of each ball before the contact and after its slide, a frame away from either.
    """
    for ball, track in pair.balls:
        t_c, frame = free.parameters[0], float(np.median(np.diff(track.start))) if len(track) > 1 else 0.0
        end = t_c + np.exp(free.parameters[FREE.index(f"log_tau{ball}")])
        for rows in (track.start + track.exposure < t_c - frame, track.start > end + frame):
            if rows.sum() < 12:  # too few to show a correlation
                continue
            part = track.where(rows)
            scaled = np.interp(part.frame, [part.frame[0], part.frame[-1]], [-1, 1])
            columns = np.zeros((9, len(part), 2))
            columns[:4, :, 0] = columns[4:8, :, 1] = (scaled[:, None] ** np.arange(4)).T
            columns[-1] = part.position - part.position.mean(axis=0)
            yield replace(part, rho=0.0).whiten(columns), part.frame


def _restricted_likelihood(parts: list[tuple[Array, Ints]], rho: float) -> tuple[float, ScatterRatio]:
    """Logarithm of the restricted likelihood at a correlation, with the size that maximises it."""
    squares, freedom, volume = 0.0, 0, 0.0
    for columns, frame in parts:
        kept = rho ** np.diff(frame) if rho else np.zeros(len(frame) - 1)
        r = np.linalg.qr(compute_innovations(columns, kept).T, mode="r")
        size = np.abs(np.diag(r))
        squares += float(size[-1] ** 2)
        freedom += columns.shape[1] - len(columns) + 1
        volume += float(np.log1p(-(kept**2)).sum()) + float(np.log(np.maximum(size[:-1], 1e-300)).sum())
    squares = max(squares, 1e-20)
    return -freedom / 2 * np.log(squares) - volume, ScatterRatio(squares / freedom, float(freedom))
