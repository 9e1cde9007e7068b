"""Friction between the balls by Coulomb's law."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class BallFriction(Effect):
    """Friction between the balls obeys Coulomb: J = min(mu P, the impulse that turns u_t into -beta u_t).

    The contact slips, or sticks with tangential restitution beta.

    - share: how much of this law replaces the constant spin transfer C; 0 is absent. With no C at all, a
      share over 1 acts as a larger beta: 1.2 as beta = 0.2. Together with a C it is not a law of contact.
    - mu: friction between the balls.
    - rise, fall: friction grows as the surfaces slow down, to mu + rise exp(-|u_t|/fall). Billiard balls have about
      mu = 0.01, rise = 0.108 and fall = 0.92 m/s (D. Alciatore, TP A.14, on data of W. C. Marlow, 1995).
    - beta: 0 sticks, J/m = |u_t|/7, C = 5/14 for head-on and oblique hits. This holds where nothing stops the vertical
      motion of the balls during the contact: where `hop` lets both go, the surfaces end at rest. A plate that held both
      would give C = 1/2 head-on. The balls touch for 9 us and the plate answers in 20 us. Hertz contacts of steel on
      aluminium give C = 0.38 (beta = 0.07). The share of the vertical motion that the plate takes is a matter of `hop`.

    If C is fitted too, tracks determine share (1 + beta), mu / (1 + beta) and (1 - share) C, no more. A search
    therefore leaves beta as given, and rise and fall too.

    Walton & Braun, J. Rheol. 30 (1986) 949; Foerster et al., Phys. Fluids 6 (1994) 1108.
    """

    share: float = parameter("1", typical=1.0, low=0, high=2, default=1.0)
    mu: float = parameter("1", typical=0.15, low=0, high=1, fixed=True, tries=np.geomspace(0.04, 0.4, 17))
    beta: float = parameter("1", typical=0.0, low=-1, high=1, fixed=True, given=True)
    rise: float = parameter("1", typical=0.0, low=0, high=1, fixed=True, given=True)
    fall: float = parameter("m/s", typical=0.92, low=1e-3, high=100, fixed=True, given=True)

    def spin_transfer(self, c: Any, contact_speed: Any, normal_impulse: Any, inertia: Any) -> Any:
        mu = self.mu + self.rise * np.exp(-contact_speed / self.fall) if self.rise else self.mu
        slipping = mu * normal_impulse / (inertia * np.maximum(contact_speed, 1e-300))
        sticking = (1 + self.beta) / (2 * (1 + inertia))  # J/m = (1 + beta)|u_t|/7 for solid balls
        return (1 - self.share) * c + self.share * np.minimum(sticking, slipping)
