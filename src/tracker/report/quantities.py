"""The measured quantities of a collision: symbol, unit and meaning of each, by its column name."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A quantity that `tracker` measures.

    symbol: an index follows "_".
    unit: in which its value is shown; "" for a pure number.
    factor: the number of these units in one SI unit.
    error_unit, error_factor: the same for errors, which are smaller.
    """

    symbol: str
    unit: str
    factor: float
    meaning: str
    error_unit: str = "10⁻³"
    error_factor: float = 1e3

    @property
    def plain_symbol(self) -> str:
        """The symbol for a terminal."""
        return self.symbol.replace("_", "")

    @property
    def formula(self) -> str:
        """The symbol for matplotlib."""
        if re.fullmatch("[a-z ]{3,}", self.symbol):
            return self.symbol
        indexed = re.sub(r"_(\w+)", r"_{\1}", self.symbol)
        return f"${indexed}$"


QUANTITIES = {
    "v0": Quantity("v_0", "cm/s", 1e2, "speed of the striker at contact", "mm/s"),
    "b": Quantity("b/2R", "", 1.0, "impact parameter over the ball's diameter"),
    "t_c": Quantity("t_c", "ms", 1e3, "time of contact", "µs", 1e6),
    "r": Quantity("r", "", 1.0, "coefficient of restitution (restitution in a scene)"),
    "s": Quantity("s", "", 1.0, "share of the tangential velocity that is kept"),
    "mu_k": Quantity("μ_k", "", 1.0, "coefficient of sliding friction on the plate (sliding_friction in a scene)"),
    "C": Quantity("C", "", 1.0, "share of the striker's spin passed on, reversed (spin_transfer in a scene)"),
    "tau1": Quantity("τ_1", "ms", 1e3, "time for which the struck ball slides", "µs", 1e6),
    "tau2": Quantity("τ_2", "ms", 1e3, "time for which the striker slides", "µs", 1e6),
    "v1f": Quantity("v_1f", "cm/s", 1e2, "speed of the struck ball once it rolls", "mm/s"),
    "v2f": Quantity("v_2f", "cm/s", 1e2, "speed of the striker once it rolls", "mm/s"),
    "energy_fraction": Quantity("E/E_0", "", 1.0, "share of the translational energy that remains once both roll"),
    "momentum_fraction": Quantity("p/p_0", "", 1.0, "share of the momentum that remains once both roll"),
    "final_angle": Quantity("angle", "deg", 180 / math.pi, "angle between the final velocities", "mrad"),
    "drag": Quantity("C_roll", "1/s", 1.0, "rolling loss that grows with speed (rolling_drag in a scene)", "1/s", 1.0),
    "decel": Quantity("D_roll", "cm/s²", 1e2, "rolling loss at any speed (rolling_decel in a scene)", "mm/s²"),
    "w1n": Quantity("ω_1n", "rad/s", 1.0, "spin of the struck ball along the line of centres", "rad/s", 1.0),
    "w1t": Quantity("ω_1t", "rad/s", 1.0, "spin of the struck ball across the line of centres", "rad/s", 1.0),
    "w2n": Quantity("ω_2n", "rad/s", 1.0, "spin of the striker along the line of centres", "rad/s", 1.0),
    "w2t": Quantity("ω_2t", "rad/s", 1.0, "spin of the striker across the line of centres", "rad/s", 1.0),
}
