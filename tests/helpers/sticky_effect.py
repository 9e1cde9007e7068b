"""An effect of a user, as a file, for the tests of effects that do not come with the package."""

STICKY = '''
"""Friction that grows with speed."""

from dataclasses import dataclass

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class StickyFingers(Effect):
    """mu (1 + k u)."""

    k: float = parameter("s/m", typical=0.05, low=0)

    def friction(self, mu, slip_speed):
        return mu * (1 + self.k * slip_speed)
'''
