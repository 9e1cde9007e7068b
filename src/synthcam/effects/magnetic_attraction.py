"""Magnetised balls that attract or repel each other."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class MagneticAttraction(Effect):
    """Each ball is pulled towards the other by the force pull (2R/r)^4 times the mass of a ball of the model.

    r is the distance of the centres, 2R the diameter of the model's ball; pull < 0 repels. The force is the same for
    both balls, whatever their masses and sizes. Jackson, Classical Electrodynamics (1999), ch. 5, gives the forces of
    dipoles of moment m. Upright ones side by side repel by 3 mu0 m^2/(4 pi r^4), and opposite ones attract by as much.
    Dipoles along the line of centres attract by twice that.

    The moments must stay constant while the balls roll, as those of soft steel in a field do: m = 4 pi R^3 B/mu0. An
    upright field of 1 mT gives pull = -0.05 m/s^2 at any position. A field along the line of centres, as in nearly
    head-on hits, gives +0.1 m/s^2. A moment fixed in the steel turns with the ball every 2 pi R = 7.5 mm: not modelled.

    A ball at rest stays while 5/7 of the push is under rolling_decel. The target of a pair (Launch.pair, and every
    scene) is therefore pulled off before it is hit, and moves towards the striker.
    """

    pull: float = parameter(
        "m/s^2",
        typical=0.1,
        low=-0.5,
        high=0.5,
        meaning=("the balls attract each other, by {} at contact", "the balls repel each other, by {} at contact"),
    )

    def push(self, acceleration: Any, other: Any, mass: Any, ball: Any) -> NDArray[np.float64]:
        nearest = 0.8  # diameters: closer centres occur only in paths that a solver tries and rejects
        x, y = other[..., 0], other[..., 1]
        size = ball.diameter**2
        square = np.maximum(x * x + y * y, nearest * nearest * size)  # infinite without another ball
        strength = size / square
        strength *= strength
        strength /= np.sqrt(square)
        strength *= self.pull * ball.mass / mass
        if not np.all(strength):
            other = np.where(np.isfinite(other), other, 0.0)
        return np.asarray(acceleration + strength[..., None] * other)
