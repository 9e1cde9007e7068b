"""Priors on the brightness of glints, from the other glints of a clip, that sharpen their positions.

- Where the brightest pixels are clipped, errors of position and flux are correlated. One lamp and equal balls give all
  glints nearly the same flux, apart from a smooth change over the picture. The scatter of the glints shows how nearly.
- A secondary glint with a free flux in each window can be mistaken for a part of the primary one on a small ball.
  Geometry gives the ratio of the two fluxes, except for the reflectance of the balls, which is common to all pairs.

Both condition normal errors. If a quantity with variance v is off by d, a position with covariance c to it is off by c
d / v.
"""

import numpy as np

from synthcam_shared.arrays import Array


def apply_flux_prior(xy: Array, cov: Array, log_flux: Array, cross: Array, own: Array) -> tuple[Array, Array]:
    """Apply the prior on brightness from the flux that the other glints of the film predict.

    Takes positions (n, 2), px, their covariances (n, 2, 2), px^2, and log fluxes (n,). `cross` (n, 2) is the covariance
    of position and log flux, px, and `own` (n,) the variance of the log flux. Returns positions and covariances.
    """
    if len(xy) < 30:  # too few for a prior
        return xy, cov
    rest = np.abs(log_flux - np.median(log_flux))
    # Glints that deviate by more than 5 standard deviations are left alone: they may be another lamp's.
    usual = np.flatnonzero(rest <= 5.0 * 1.4826 * np.median(rest))  # 1.4826: of a normal distribution
    x, y = ((xy[usual] - xy[usual].mean(axis=0)) / max(float(np.ptp(xy[usual])), 1.0)).T
    field = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    scatter = 0.0
    for _ in range(3):
        weight = 1.0 / np.sqrt(own[usual] + scatter)
        smooth = field @ np.linalg.lstsq(field * weight[:, None], log_flux[usual] * weight, rcond=None)[0]
        off = log_flux[usual] - smooth
        scatter = max(float(np.mean(off**2 - own[usual])), 0.0)
    whole = own[usual] + scatter
    better, surer = xy.copy(), cov.copy()
    better[usual] -= cross[usual] * (off / whole)[:, None]
    surer[usual] -= cross[usual, :, None] * cross[usual, None, :] / whole[:, None, None]
    return better, surer


def apply_common_reflectance(
    xy: Array, cov: Array, reflectance: Array, cross: Array, own: Array
) -> tuple[Array, Array]:
    """Apply the prior on brightness from the reflectance that the other pairs of balls show.

    Arguments and results are those of `apply_flux_prior`, with the reflectance (n,) of each window on its own in place
    of the log flux.
    """
    if len(xy) < 2:
        return xy, cov
    geometry_error = 0.1  # relative; the ratio lacks images of higher order and the neighbour's dark side
    scatter = 0.0
    for _ in range(3):
        weight = 1.0 / (own + scatter)
        mean = float(weight @ reflectance / weight.sum())
        excess = float(weight @ ((reflectance - mean) ** 2 - own) / weight.sum())
        scatter = max(excess, (geometry_error * mean) ** 2)
    weight = 1.0 / (own + scatter)
    rest = weight.sum() - weight
    others = (weight @ reflectance - weight * reflectance) / rest
    whole = own + scatter + 1.0 / rest
    better = xy - cross * ((reflectance - others) / whole)[:, None]
    surer = cov - cross[:, :, None] * cross[:, None, :] / whole[:, None, None]
    return better, surer
