"""Magnetised balls that attract or repel each other."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter

NEAREST = 0.8  # diameters: no two centres are nearer but in a path that is only tried


@dataclass(frozen=True)
class MagneticAttraction(Effect):
    """A force of `pull` (2R/r)^4 times the mass of a ball of the model, on each towards the other; pull < 0 repels.

    r: distance of the centres; 2R: the model's diameter. It is the same for both, whatever their masses and sizes.
    Dipoles of moment m (Jackson, Classical Electrodynamics (1999), ch. 5): upright ones, side by side, repel by
    3 mu0 m^2/(4 pi r^4), opposite ones attract by as much; ones along the line of centres attract by twice that.

    Moments must stay as they are while the balls roll: of soft steel in a field, m = 4 pi R^3 B/mu0. An upright B of
    1 mT gives pull = -0.05 m/s^2 wherever the balls are; one along the line of centres, as near head-on, +0.1. A moment
    fixed in the steel turns with the ball, and its force with it, every 2 pi R = 7.5 mm: that is not modelled. A ball
    at rest stays while 5/7 of the push is under `rolling_decel`. So the target of a pair (Launch.pair, and every scene)
    is pulled off before it is hit, and comes to meet the striker.
    """

    pull: float = parameter("m/s^2", typical=0.1, low=-0.5, high=0.5)

    def push(self, acceleration: Any, other: Any, mass: Any, ball: Any) -> NDArray[np.float64]:
        x, y = other[..., 0], other[..., 1]
        size = ball.diameter**2
        square = np.maximum(x * x + y * y, NEAREST * NEAREST * size)  # infinite where there is no other
        strength = size / square
        strength *= strength
        strength /= np.sqrt(square)
        strength *= self.pull * ball.mass / mass
        if not np.all(strength):
            other = np.where(np.isfinite(other), other, 0.0)
        return np.asarray(acceleration + strength[..., None] * other)
