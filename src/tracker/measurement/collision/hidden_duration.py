"""Contacts that are too short to be seen: how long they may last, by where a fit of an impact lets the balls touch.

Two paths that break at one instant touch at one diameter. If the impulse takes the time T, they cross within one
diameter, by the way that the balls close in the time up to its middle.
"""

from __future__ import annotations

import numpy as np

from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues


def measure_hidden_duration(
    diameter: float, values: DerivedValues, distance: tuple[float, float]
) -> tuple[float, float]:
    """Measure how long a contact lasts, s, and its error, by the distance of the centres that a fit of an impact finds.

    diameter in m. distance: in diameters, with its standard error, as `camera_errors.measure_contact_distance` gives
    it. The duration of an instant is 0 within its error.
    """
    r = float(np.clip(values.value[QUANTITY_NAMES.index("r")], 0.1, 1.0))
    per_way = (1 + 1 / r) / measure_closing_speed(values) * diameter
    return (1 - distance[0]) * per_way, distance[1] * per_way


def measure_closing_speed(values: DerivedValues) -> float:
    """Measure the speed at which the balls of a fit close along the line of centres, m/s; never 0."""
    v0, b = (float(values.value[QUANTITY_NAMES.index(name)]) for name in ("v0", "b"))
    return max(v0 * float(np.sqrt(max(1 - b**2, 0.1))), 1e-9)


def compute_steel_duration(diameter: float, closing: float) -> float:
    """Compute how long two equal steel balls touch, s, by Hertz's law; diameter in m, closing speed in m/s."""
    density, modulus, poisson = 7800.0, 206e9, 0.3  # kg/m^3, Pa, 1
    mass, radius = density * np.pi * diameter**3 / 12, diameter / 4  # reduced, of two balls
    stiffness = modulus / (2 * (1 - poisson**2))
    return float(2.868 * (mass**2 / (radius * stiffness**2 * closing)) ** 0.2)


def estimate_hidden_duration(measured: float, std: float, shortest: float) -> float:
    """Estimate the rms duration of a contact from a measured one and its error, s; shortest: that of steel balls.

    By Hertz's law the duration goes as (density/modulus)^(2/5): balls of glass touch for as long as those of steel, of
    hard plastics or wood up to three times as long, and of rubber at least thirty times. The prior takes one contact in
    fifty as soft. For hard and for soft ones it is even in the logarithm. Below 0.05 ms a contact counts as an instant,
    as simulations of small balls have it.
    """
    instant, softest, soft = 5e-5, 0.03, 0.02  # s, s, share of the prior
    hard = np.geomspace(shortest, 3 * shortest, 500)
    every = np.concatenate([hard, np.geomspace(hard[-1], max(softest, 2 * hard[-1]), 500)])
    every[every < instant] = 0.0
    square = ((every - measured) / std) ** 2
    weight = np.exp((square.min() - square) / 2) * np.repeat([1 - soft, soft], 500)
    return float(np.sqrt(weight @ every**2 / weight.sum()))
