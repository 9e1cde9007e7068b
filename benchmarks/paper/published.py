"""The numbers that the paper prints, with their printed errors and the page.

A chi^2 needs some errors that the paper does not print. They are given here with their source.
"""

from __future__ import annotations

from dataclasses import dataclass

COLLISIONS = 28  # of the histogram of r
R_SCATTER = 0.11
R_ERROR = R_SCATTER / COLLISIONS**0.5  # of the mean, if the printed .11 is the scatter of the 28


@dataclass(frozen=True)
class Number:
    """value, its error (None: not printed), unit, and the section of the paper."""

    value: float
    error: float | None
    unit: str
    place: str


NUMBERS = {
    "drag": Number(0.135, None, "1/s", "III A"),
    "decel": Number(1.03, None, "cm/s^2", "III A"),
    "mu_r": Number(2.5e-3, None, "", "III A"),
    "r, differences": Number(0.85, 0.11, "", "III B, fig. 4"),
    "r, fit": Number(0.903, 0.008, "", "III B"),
    "mu_k, fit": Number(0.232, 0.023, "", "III B"),
    "C, fit": Number(0.347, 0.008, "", "III B"),
    "C, spins": Number(0.25, 0.02, "", "IV"),
    "dn": Number(0.01, 0.02, "", "IV"),
    "energy": Number(0.37, None, "", "III C"),
    "energy, impact alone": Number(0.91, None, "", "III C"),
    "momentum": Number(0.80, None, "", "III D"),
    "tau at 10 cm/s": Number(0.06, None, "s", "III B, figs. 2, 3"),
    "angle at the hit": Number(90.0, None, "degrees", "III B, fig. 5"),
    "sliding over rolling": Number(1e2, None, "", "I"),
    "crossover velocity": Number(1e-2, None, "cm/s", "III B"),
    "force ratio": Number(1e3, None, "", "V"),
}


@dataclass(frozen=True)
class Observed:
    """A number that enters the chi^2 of a model: published value, error, and where the error comes from."""

    name: str
    value: float
    error: float
    why: str


_ALLOWED = 0.008 * COLLISIONS**0.5
OBSERVED = (
    Observed("r, fit", 0.903, 0.008, "printed"),
    Observed("C, fit", 0.347, 0.008, "printed"),
    Observed("mu_k, fit", 0.232, 0.023, "printed"),
    Observed(
        "scatter of r", 0.0, _ALLOWED, "of each collision's r about the fit: at most what the printed error allows"
    ),
    Observed("scatter of C", 0.0, _ALLOWED, "the same for C"),
    Observed("r, differences", 0.85, R_ERROR, "printed scatter over the root of 28"),
    Observed("slope of r", 0.0, 0.14, "per m/s; 'no obvious dependence': what a scatter of .11 hides in 28 collisions"),
    Observed("C, spins", 0.25, 0.02, "printed"),
    Observed("dn", 0.01, 0.02, "printed"),
    Observed("energy", 0.37, 0.02, "'~', taken as two units of the last digit"),
    Observed("momentum", 0.80, 0.02, "the same"),
)
SLOW = Observed("tau at 10 cm/s", 0.06, 0.015, "'~', one collision read by eye; our guess, not in the chi^2")
