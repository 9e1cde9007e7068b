"""What a ball's places are worth together: whitening by their full covariance.

A pixel's own response and offset are the same in every frame, so a ball at rest has the same error in all of
them, and one that creeps shares some of it from frame to frame. Linearised, the shift that a random pattern of
pixels gives a Gaussian glint is the gradient of a smooth random field: shifts at two places D apart correlate as
(1 - D D^T / 2 s^2) exp(-|D|^2 / 4 s^2), s the glint's width. At D = 0 that is one, for a resting ball.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Floats = NDArray[np.float64]
LONGEST = 200  # rows whitened together; beyond them a moving ball has long left its pixels
OWN = 1e-3  # least share of the covariance that is a frame's own: keeps the matrix regular


class Whitener:
    """Turns errors of n places into independent ones of unit size; one block where nothing is shared."""

    def __init__(self, place: Floats, cov: Floats, fixed: Floats, width: float) -> None:
        """place (n, 2) m, cov (n, 2, 2) m^2, fixed (n, 2, 2) the shared part of it, width m of a glint."""
        self.alone = _inverse_root(cov) if len(cov) else cov
        self.blocks: list[tuple[slice, Floats]] = []
        if width > 0 and len(cov) and fixed.any():
            for start in range(0, len(cov), LONGEST):
                rows = slice(start, start + LONGEST)
                whole = covariance(place[rows], cov[rows], fixed[rows], width)
                lower = np.linalg.cholesky(whole)
                self.blocks.append((rows, solve_triangular(lower, np.eye(len(lower)), lower=True)))

    def __call__(self, errors: Floats) -> Floats:
        """errors (n, 2) or (n, 2, p) -> (2n,) or (2n, p)."""
        flat = (2 * len(errors), *errors.shape[2:])
        if not self.blocks:
            tall = errors[..., None] if errors.ndim == 2 else errors
            return np.asarray((self.alone @ tall).reshape(flat), dtype=np.float64)
        parts = [root @ errors[rows].reshape(-1, *errors.shape[2:]) for rows, root in self.blocks]
        return np.concatenate(parts)

    def distance(self, errors: Floats) -> Floats:
        """(n,) squared Mahalanobis distance of each place by itself."""
        return np.asarray(((self.alone @ errors[..., None])[..., 0] ** 2).sum(axis=1), dtype=np.float64)


def covariance(place: Floats, cov: Floats, fixed: Floats, width: float) -> Floats:
    """Covariance (2n, 2n) m^2 of places (n, 2) m; cov, fixed (n, 2, 2) and width as for Whitener."""
    n = len(place)
    fixed = fixed * _admitted(cov, fixed)[:, None, None]
    size, axes = np.linalg.eigh(fixed)
    root = axes * np.sqrt(np.maximum(size, 0.0))[:, None, :] @ np.swapaxes(axes, 1, 2)
    apart = (place[:, None] - place[None]) / width
    near = np.exp(-(apart**2).sum(-1) / 4)[..., None, None]
    kernel = near * (np.eye(2) - apart[..., :, None] * apart[..., None, :] / 2)
    shared = np.einsum("iab,ijbc,jcd->iajd", root, kernel, root, optimize=True)
    shared[range(n), :, range(n), :] += cov - fixed
    return np.asarray(shared.reshape(2 * n, 2 * n), dtype=np.float64)


def _admitted(cov: Floats, fixed: Floats) -> Floats:
    """(n,) factors that leave each frame its own share, whatever a table says of the shared part."""
    root = _inverse_root(cov)
    most = np.linalg.eigvalsh(root @ fixed @ np.swapaxes(root, 1, 2))[:, -1]
    return np.asarray(np.minimum(1.0, (1 - OWN) / np.maximum(most, 1e-300)), dtype=np.float64)


def _inverse_root(cov: Floats) -> Floats:
    """Matrices W (n, 2, 2) with W^T W = cov^-1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)), dtype=np.float64)
