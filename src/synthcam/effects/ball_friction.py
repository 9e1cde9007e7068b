"""Friction between the balls that follows Coulomb's law."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter

STICK = 2.5 / 7  # J/m = (1 + beta)|u_t|/7 is C = (1 + beta) 5/14


@dataclass(frozen=True)
class BallFriction(Effect):
    """J = min(mu P, what turns u_t into -beta u_t): slip, or stick with tangential restitution.

    share: of this law in place of the model's fixed spin transfer C, from 0, absent. mu: friction between the balls.
    beta: 0 sticks: J/m = |u_t|/7, C = 5/14, head-on and oblique, as of balls that nothing holds vertically while they
    touch: where `hop` lets both go, the surfaces end at rest. A plate that held both would make it 1/2 head-on, but
    they touch for 9 us and the plate answers in 20: with Hertz contacts of steel, on aluminium, C = .38 (beta .07).
    What the plate then takes of the vertical motion is `hop`'s matter.

    Where C is fitted too, tracks determine share (1 + beta), mu / (1 + beta) and (1 - share) C, no more; a search keeps
    the beta that it is given. A share over 1 stands for a larger beta: 1.2 without any C for .2. Beside a C it is no
    law of contact. Walton & Braun, J. Rheol. 30 (1986) 949; Foerster et al., Phys. Fluids 6 (1994) 1108.
    """

    share: float = parameter("1", typical=1.0, low=0, high=2, default=1.0)
    mu: float = parameter("1", typical=0.15, low=0, high=1, fixed=True, tries=np.geomspace(0.04, 0.4, 17))
    beta: float = parameter("1", typical=0.0, low=-1, high=1, fixed=True, given=True)

    def spin_transfer(self, c: Any, contact_speed: Any, normal_impulse: Any) -> Any:
        slipping = 2.5 * self.mu * normal_impulse / np.maximum(contact_speed, 1e-300)
        return (1 - self.share) * c + self.share * np.minimum((1 + self.beta) * STICK, slipping)
