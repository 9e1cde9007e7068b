"""Motions of two balls before and after a contact that lasts, and their residuals.

Outside the contact, the impulse acts as if it came at one instant, whatever the law of the force. Let the balls close
at speed v, and let the impulse have its mean time t after they touch at separation D. The paths before and after it
cross then, at the separation d = D - v t, which is a parameter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Ints
from tracker.measurement.collision.collision_model import (
    AFTER,
    FREE,
    GRAVITY,
    SLIP_RATE,
    TIED,
    compute_unit_vectors,
    mean_positions,
    tied_to_free,
)
from tracker.measurement.collision.least_squares import BROAD_PRIORS, BallPair, PairResiduals

STRAIGHT = (*FREE[:8], "v1x", "v1y", "v2x", "v2y", *FREE[-2:])  # free motions without a slide


class LastingResiduals(PairResiduals):
    """Residuals of two balls' positions outside a contact.

    The last two parameters are lengths: by how much the paths miss each other across the line of centres, and d. Those
    of a tied motion follow two numbers that the law of the force determines: by how much its slides are delayed (see
    `delay_of_slides`), and its impulse is turned (see `turn_of_impulse`). kind: "tied", "free", or "straight", a free
    motion that no friction slows down. friction: of a tied motion, if it is known within a quarter.
    """

    def __init__(self, pair: BallPair, kind: str, friction: float | None = None) -> None:
        held = pair.zero_parameters | ({"drag", "decel"} if kind == "straight" else set())
        super().__init__(pair, {"tied": TIED, "free": FREE, "straight": STRAIGHT}[kind], held)
        self.kind = kind
        given = {} if friction is None else {"log_mu": (float(np.log(friction)), 0.25)}
        priors = [given.get(name, BROAD_PRIORS.get(name, (0.0, np.inf))) for name in self.names]
        priors += [(0.0, 1.0)] * self.laws_of_force
        self.prior = np.array([*(centre for centre, _ in priors), 0.0, pair.diameter])
        self.prior_weight = np.array([*(1 / width for _, width in priors), 200 / pair.diameter, 1 / pair.diameter])

    @property
    def laws_of_force(self) -> int:
        """Number of parameters that the law of the force determines."""
        return 2 if self.kind == "tied" else 0

    def to_free(self, x: NDArray[np.inexact]) -> NDArray[np.inexact]:
        """The free parameters (..., 22) of x (..., p)."""
        whole = np.zeros((*x.shape[:-1], self.size), dtype=x.dtype)
        whole[..., self.index] = x[..., : len(self.index)]
        if self.kind == "free":
            return whole
        if self.kind == "tied":
            before = time_before_crossing(whole[..., 4], whole[..., 5], x[..., -1], self.pair.diameter)
            closing = whole[..., 5] * np.cos(whole[..., 4])
            depth = self.pair.diameter - x[..., -1]
            lasts, delay = delay_of_slides(closing, whole[..., 8], whole[..., 9], before, depth, x[..., -4])
            delay = np.where(delay.real < 0.5 * before.real, delay, 0.5 * before)
            turned = whole.copy()
            turned[..., 4] -= turn_of_impulse(whole[..., 4], whole[..., 5] * lasts / self.pair.diameter, x[..., -3])
            free = tied_to_free(turned, self.pair.spin)
            free[..., 4] = whole[..., 4]
            return advance_slides(free, before - delay)
        free = np.zeros((*x.shape[:-1], len(FREE)), dtype=x.dtype)
        free[..., :8], free[..., -2:] = whole[..., :8], whole[..., -2:]
        short_slide = np.log(1e-4)  # log s
        for ball, at in AFTER.items():
            velocity = whole[..., 6 + 2 * ball : 8 + 2 * ball]
            free[..., at : at + 2] = free[..., at + 2 : at + 4] = velocity
            free[..., at + 4] = short_slide
        return free

    def predict(self, x: Array, ball: Ints, start: Array) -> tuple[Array, Array]:
        """Positions (n, 2) of exposures and their derivatives (n, 2, p)."""
        free = np.asarray(self.to_free(x).real, dtype=np.float64)
        steps = x + 1e-30j * np.eye(len(x))
        by = np.asarray(self.to_free(steps).imag.T / 1e-30, dtype=np.float64)  # (22, p)
        position, slope = mean_positions(free, ball, start, self.pair.struck.exposure, float(x[-1]))
        slope = slope @ by
        _, n, t = compute_unit_vectors(free[3], free[4])
        slope[..., -1] -= (ball == 2)[:, None] * n
        across = np.where(start < free[0], 0.0, 1.5 - ball)[:, None] * t
        position += x[-2] * across
        slope[..., -2] += across
        return position, slope

    def displace(self, x: Array) -> tuple[Array, Array]:
        position, slope = self.predict(x, self.ball, self.start)
        return position, np.moveaxis(slope, -1, 0)


def time_before_crossing(
    beta: NDArray[np.inexact], v0: NDArray[np.inexact], distance: NDArray[np.inexact], diameter: float
) -> NDArray[np.inexact]:
    """Seconds from the first touch of a lasting contact to the crossing of the paths at a distance (m), angle beta."""
    reach = diameter**2 - (distance * np.sin(beta)) ** 2
    return np.asarray((np.sqrt(np.where(reach.real > 0, reach, 0.0)) - distance * np.cos(beta)) / v0)


def delay_of_slides(
    closing: NDArray[np.inexact],
    r: NDArray[np.inexact],
    log_mu: NDArray[np.inexact],
    before: NDArray[np.inexact],
    depth: NDArray[np.inexact],
    excess: NDArray[np.inexact],
) -> tuple[NDArray[np.inexact], NDArray[np.inexact]]:
    """Seconds that a contact lasts, and by which it delays slides: balls roll until the push exceeds 7/2 mu g.

    - closing, m/s; r of the whole impulse; before: s from the touch to t_c.
    - depth: of the crossing of the paths, m within one diameter.
    - excess over the mean of five laws of the force, in their standard deviations.

    Until then friction is 2/7 of the push, so that half of this time counts. That is 7/2 mu g T^2/(pi^2 J) for a push
    like a half sine. A push as of Hertz rises later. A dashpot pushes from the touch on, the more the lower the speed
    is at which the balls part. Let this be k times that of closing. The shares of half a sine that five laws integrate
    to are k^3 +- .6 k^1.5, for contacts of 1 to 30 ms with r from .2 to .95.
    """
    braking = 2 * np.exp(log_mu) * GRAVITY  # of both balls
    crossing = r * closing - braking * before
    slowest = 0.05 * closing
    crossing = np.where(crossing.real > slowest.real, crossing, slowest)
    square = crossing**2 - 2 * braking * depth
    parting = np.sqrt(np.where(square.real > slowest.real**2, square, slowest**2))
    lasts = before + 2 * depth / (crossing + parting)
    half_sine = SLIP_RATE * braking / 2 * lasts**2 / (np.pi**2 * (1 + r) / 2 * closing)
    root = (parting / closing) ** 1.5
    return np.asarray(lasts), np.asarray((root**2 + 0.6 * root * excess) * half_sine)


def turn_of_impulse(
    beta: NDArray[np.inexact], way: NDArray[np.inexact], excess: NDArray[np.inexact]
) -> NDArray[np.inexact]:
    """Angle between the impulse and the line of centres at the crossing of the paths, in the sense in which it turns.

    way: of the free balls against each other in the time of the contact, in diameters; excess as for `delay_of_slides`.
    Balls are further apart late in the contact, where the line turns slower. Five laws of the force
    integrate to .8 +- .8 % of its turn.
    """
    return np.asarray(0.008 * (1 + excess) * np.sin(beta) * way)


def advance_slides(free: NDArray[np.inexact], delay: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Advance slides that a lasting contact delays: free parameters (..., 22) at t_c, from those at their start."""
    out = free.copy()
    for at in AFTER.values():
        v, f, past = free[..., at : at + 2], free[..., at + 2 : at + 4], delay / np.exp(free[..., at + 4])
        most = 0.7  # share of a slide from which on the rest gets ever smaller, so that some of it is left
        left = np.where(past.real < most, 1 - past, (1 - most) * np.exp((most - past) / (1 - most)))
        out[..., at : at + 2] = f + left[..., None] * (v - f)
        out[..., at + 4] = free[..., at + 4] + np.log(left)
    return out


def rewind_slides(free: Array, delay: Array) -> Array:
    """Rewind slides that a lasting contact delays: free parameters (..., 22) at their start, from those at t_c."""
    out = free.copy()
    for at in AFTER.values():
        v, f, tau = free[..., at : at + 2], free[..., at + 2 : at + 4], np.exp(free[..., at + 4])
        out[..., at : at + 2] = v + (delay / tau)[..., None] * (v - f)
        out[..., at + 4] = np.log(tau + delay)
    return out
