"""An effect that bends every law of motion, and scipy's integration of the raw equations with it, for the tests."""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from synthcam.effect import Effect, parameter
from synthcam.model import Model

R = Model().ball.radius
G = 9.81
TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "dense_output": True}


@dataclass(frozen=True)
class Everything(Effect):
    """Bends every law of motion, and each by position or speed."""

    size: float = parameter("1", typical=1)

    def friction(self, mu, slip_speed, slip):
        return mu * (1 + self.size * (0.3 * np.exp(-slip_speed / 0.1) + 0.1 * slip[..., 0] * slip[..., 1]))

    def normal_load(self, load, position):
        return load * (1 + self.size * 5 * position[..., 0])

    def push(self, acceleration, position, velocity):
        return acceleration + self.size * (0.5 * np.sin(300 * position) - 0.02 * velocity)

    def rolling(self, loss, speed, position):
        return loss + self.size * (0.1 * speed**2 + 0.005 * np.sin(200 * position[..., 1]))

    def drilling(self, twist, spin, friction):
        return twist - self.size * 3 * friction * spin


BENT = Model(effects=(Everything(size=1.0),))


def slide_by_hand(start, times):
    """x, y, vx, vy, wx, wy, wz of a slide from the state `start`, until the slip is 1e-7 m/s."""

    def right(_, y):
        v, u = y[2:4], np.array([y[2] - R * y[5], y[3] + R * y[4]])
        s = np.hypot(*u)
        hat = u / s
        mu = 0.232 * (1 + 0.3 * np.exp(-s / 0.1) + 0.1 * hat[0] * hat[1])
        f = -mu * G * (1 + 5 * y[0]) * hat
        push = 0.5 * np.sin(300 * y[:2]) - 0.02 * v
        return [*v, *(f + push), 2.5 / R * f[1], -2.5 / R * f[0], -3 * mu * y[6]]

    def slip(_, y):
        return np.hypot(y[2] - R * y[5], y[3] + R * y[4]) - 1e-7

    slip.terminal = True
    return solve_ivp(right, (times[0], times[-1]), start[[0, 1, 3, 4, 6, 7, 8]], events=slip, **TIGHT)


def roll_by_hand(start, t0, t1):
    """x, y, vx, vy of a roll."""

    def right(_, y):
        v = y[2:]
        s = np.hypot(*v)
        loss = 0.135 * s + 0.0103 + 0.1 * s * s + 0.005 * np.sin(200 * y[1])
        return [*v, *(5 / 7 * (0.5 * np.sin(300 * y[:2]) - 0.02 * v) - loss / s * v)]

    return solve_ivp(right, (t0, t1), [*start[:2], *start[3:5]], **TIGHT)
