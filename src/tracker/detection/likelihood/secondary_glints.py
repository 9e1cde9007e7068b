"""A prior on the flux of secondary glints: the balls' reflectance is common to all pairs of a clip.

A secondary glint free in each window is mistaken for a part of the primary one when the ball is small. Geometry gives
the ratio of the two but for the balls' reflectance, and that is one number, which every pair shows.
"""

from __future__ import annotations

from tracker.camera.lens import Array

ROUNDS = 3  # in which the scatter of the reflectances is found
LOOSE = 0.1  # of the reflectance, what geometry leaves out: images of higher order, the neighbour's dark side


def apply_common_reflectance(
    xy: Array, cov: Array, reflectance: Array, cross: Array, own: Array
) -> tuple[Array, Array]:
    """Glints' positions with what the reflectance of the other balls adds to them.

    Conditioning of normal errors on the mean of all the others, which leaves out what a window says itself.

    Parameters
    ----------
    xy : ndarray of shape (n, 2)
        Positions, px.
    cov : ndarray of shape (n, 2, 2)
        Their covariances, px^2.
    reflectance : ndarray of shape (n,)
    cross : ndarray of shape (n, 2)
        Covariance of position and reflectance, px.
    own : ndarray of shape (n,)
        Variance of the reflectance.

    Returns
    -------
    xy, cov : ndarray
        Of the same shapes.
    """
    if len(xy) < 2:
        return xy, cov
    scatter = 0.0
    for _ in range(ROUNDS):
        weight = 1.0 / (own + scatter)
        mean = float(weight @ reflectance / weight.sum())
        excess = float(weight @ ((reflectance - mean) ** 2 - own) / weight.sum())
        scatter = max(excess, (LOOSE * mean) ** 2)
    weight = 1.0 / (own + scatter)
    rest = weight.sum() - weight
    others = (weight @ reflectance - weight * reflectance) / rest
    whole = own + scatter + 1.0 / rest
    better = xy - cross * ((reflectance - others) / whole)[:, None]
    surer = cov - cross[:, :, None] * cross[:, None, :] / whole[:, None, None]
    return better, surer
