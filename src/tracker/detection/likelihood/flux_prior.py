"""A prior on the flux of clipped glints, from the film's other glints, that sharpens their positions.

Where the brightest pixels are clipped, errors of position and flux go together. One lamp and like balls make all glints
nearly as bright, but for a smooth change over the field; how nearly, the glints say themselves.
"""

from __future__ import annotations

import numpy as np

from tracker.camera.lens import Array

FEWEST = 30  # glints
ROUNDS = 3  # in which the glints' own scatter is found
STRANGE = 5.0  # deviations of the bulk: another lamp's glint, or none
NORMAL = 1.4826  # standard deviation of a normal spread over its median absolute deviation


def apply_flux_prior(xy: Array, cov: Array, log_flux: Array, cross: Array, own: Array) -> tuple[Array, Array]:
    """Glints' positions with what the flux of the film's other glints adds to them.

    Conditioning of normal errors: where the log flux is off by d, and d has the variance v = own + the scatter of true
    fluxes, the position is off by cross d / v.

    Parameters
    ----------
    xy : ndarray of shape (n, 2)
        Positions, px.
    cov : ndarray of shape (n, 2, 2)
        Their covariances, px^2.
    log_flux : ndarray of shape (n,)
    cross : ndarray of shape (n, 2)
        Covariance of position and log flux, px.
    own : ndarray of shape (n,)
        Variance of the log flux.

    Returns
    -------
    xy, cov : ndarray
        Of the same shapes.
    """
    if len(xy) < FEWEST:
        return xy, cov
    rest = np.abs(log_flux - np.median(log_flux))
    alike = np.flatnonzero(rest <= STRANGE * NORMAL * np.median(rest))
    x, y = ((xy[alike] - xy[alike].mean(axis=0)) / max(float(np.ptp(xy[alike])), 1.0)).T
    field = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    scatter = 0.0
    for _ in range(ROUNDS):
        weight = 1.0 / np.sqrt(own[alike] + scatter)
        smooth = field @ np.linalg.lstsq(field * weight[:, None], log_flux[alike] * weight, rcond=None)[0]
        off = log_flux[alike] - smooth
        scatter = max(float(np.mean(off**2 - own[alike])), 0.0)
    whole = own[alike] + scatter
    better, surer = xy.copy(), cov.copy()
    better[alike] -= cross[alike] * (off / whole)[:, None]
    surer[alike] -= cross[alike, :, None] * cross[alike, None, :] / whole[:, None, None]
    return better, surer
