"""Kinetic theory of hard discs in a plane, as a comparison for measured rates and free paths.

Enskog's rates hold for a homogeneous gas with a Maxwellian distribution and no correlation of velocities. The pair
correlation at contact is that of Henderson (1975), Mol. Phys. 30, 971; it holds up to an area fraction of about 0.6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from synthcam_shared.arrays import Array


def contact_pair_correlation(area_fraction: ArrayLike) -> Array:
    """Pair correlation of hard discs at contact: (1 - 7 phi / 16) / (1 - phi)^2."""
    phi = np.asarray(area_fraction, dtype=np.float64)
    return np.asarray((1 - 7 * phi / 16) / (1 - phi) ** 2)


def contact_rate(temperature: ArrayLike, density: ArrayLike, diameter: float) -> Array:
    """Contacts of one disc per second: 2 n d g sqrt(pi T).

    temperature: m^2/s^2, variance of one component of the velocity. density: discs per m^2. diameter: m.
    """
    n = np.asarray(density, dtype=np.float64)
    g = contact_pair_correlation(n * np.pi * diameter**2 / 4)
    return np.asarray(2 * n * diameter * g * np.sqrt(np.pi * np.asarray(temperature, dtype=np.float64)))


def mean_free_path(density: ArrayLike, diameter: float) -> Array:
    """Mean free path of discs between two contacts, m, by kinetic theory: 1 / (2 sqrt(2) n d g)."""
    n = np.asarray(density, dtype=np.float64)
    return np.asarray(1 / (2 * np.sqrt(2) * n * diameter * contact_pair_correlation(n * np.pi * diameter**2 / 4)))
