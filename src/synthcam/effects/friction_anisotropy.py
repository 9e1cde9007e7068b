"""A plate with a grain: sliding friction depends on the direction of the slip."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class FrictionAnisotropy(Effect):
    """mu(th) = mu [1 + c cos 2 th + s sin 2 th], with the direction th of the slip from x.

    The first harmonic of Zmitrowicz, Wear 73 (1981) 9. The friction stays opposite to the slip. A grain at th0 with the
    size e has c = e cos 2 th0 and s = e sin 2 th0.
    """

    c: float = parameter(
        "1",
        typical=0.1,
        low=-0.45,
        high=0.45,
        meaning=("friction is larger along x than along y", "friction is larger along y than along x"),
    )
    s: float = parameter(
        "1",
        typical=0.1,
        low=-0.45,
        high=0.45,
        meaning=(
            "friction is larger at +45 degrees to x than at -45 degrees",
            "friction is larger at -45 degrees to x than at +45 degrees",
        ),
    )

    def friction(self, mu: Any, slip: Any) -> Any:
        cos, sin = slip[..., 0], slip[..., 1]
        return mu * (1 + self.c * (cos * cos - sin * sin) + self.s * 2 * cos * sin)
