"""Two bodies whose contact takes time, a spring with a dashpot along the normal, and their tracks."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

GRAVITY = 9.81  # m/s^2
PIXEL = 4e-4  # m


@dataclass(frozen=True)
class SoftHit:
    """A striker that moves along x at a struck body at rest; lengths in m, times in s.

    The spring and the dashpot give a head-on hit the restitution `r` and the duration `duration`, whatever its speed.
    duration 0 is an instant. sticky: the contact never opens; the spring then has the period of 4 durations.
    friction: of the bodies with the plate; 0 for discs that slide without friction, otherwise the bodies are balls.
    rub: friction between the bodies.
    """

    duration: float
    r: float = 0.9
    v0: float = 0.3
    b: float = 0.0  # impact parameter over the diameter
    friction: float = 0.0
    rub: float = 0.0
    sticky: bool = False
    fps: float = 500.0
    diameter: float = 0.05
    before: int = 30  # frames
    after: int = 120  # frames
    noise: float = 2e-5
    heading: float = 0.0

    @property
    def camera(self) -> dict:
        return {"fps": self.fps, "ball_diameter": self.diameter}

    def tracks(self, rng: np.random.Generator) -> pd.DataFrame:
        """frame, particle, x, y (m): noisy positions of both bodies; particle 0 is struck."""
        phase = rng.uniform(0, 1)
        t = (np.arange(-self.before, self.after) + phase) / self.fps
        way = self.positions(t)
        c, s = np.cos(self.heading), np.sin(self.heading)
        parts = []
        for particle in (0, 1):
            x, y = way[particle].T
            xy = np.column_stack([c * x - s * y, s * x + c * y]) + rng.normal(0, self.noise, (len(t), 2))
            frame = np.arange(len(t))
            parts.append(pd.DataFrame({"frame": frame, "particle": particle, "x": xy[:, 0], "y": xy[:, 1]}))
        return pd.concat(parts, ignore_index=True)

    def positions(self, t: np.ndarray) -> np.ndarray:
        """(2, n, 2) m at times t since the first touch: struck, striker."""
        start = np.array([-np.sqrt(1 - self.b**2), -self.b]) * self.diameter  # of the striker at the touch
        out = np.zeros((2, len(t), 2))
        early = t < 0
        out[1, early] = start + np.outer(t[early], [self.v0, 0.0])
        late = np.flatnonzero(~early)
        if self.duration == 0:
            n = -start / self.diameter
            change = (1 + self.r) / 2 * self.v0 * n[0] * n
            state = np.concatenate([[0, 0], start, change, [self.v0 - change[0], -change[1]], [0, 0], [self.v0, 0]])
            leave = 0.0
        else:
            first = np.concatenate([[0, 0], start, [0, 0], [self.v0, 0], [0, 0], [self.v0, 0]])
            end = t[-1] if self.sticky else 3 * self.duration + 1 / self.fps
            found = solve_ivp(
                self._rates, (0, end), first, events=None if self.sticky else _opening(self.diameter),
                dense_output=True, rtol=1e-8, atol=1e-11, max_step=self.duration / 20,
            )  # fmt: skip
            leave, state = found.t[-1], found.y[:, -1]
            within = late[t[late] <= leave]
            if len(within):
                out[:, within] = found.sol(t[within])[:4].T.reshape(-1, 2, 2).transpose(1, 0, 2)
            late = late[t[late] > leave]
        for ball in (0, 1):
            x, v, carried = (state[k + 2 * ball : k + 2 * ball + 2] for k in (0, 4, 8))
            out[ball, late] = self._slide_and_roll(x, v, carried, t[late] - leave)
        return out

    def _slide_and_roll(self, x: np.ndarray, v: np.ndarray, carried: np.ndarray, t: np.ndarray) -> np.ndarray:
        slip = v - carried
        size = np.hypot(*slip)
        if self.friction == 0 or size < 1e-9:
            return x + np.outer(t, v)
        pull = -self.friction * GRAVITY * slip / size
        tau = size / (3.5 * self.friction * GRAVITY)
        s = np.minimum(t, tau)
        return x + np.outer(s, v) + np.outer(s**2 / 2, pull) + np.outer(t - s, v + pull * tau)

    def _rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """Rates of: positions of both (4), velocities (4), velocities at which they would roll (4)."""
        apart, speed = y[0:2] - y[2:4], y[4:6] - y[6:8]
        s = np.hypot(*apart)
        n = apart / s
        period = 4 * self.duration if self.sticky else 2 * self.duration
        damping = 0.25 * 2 * np.pi / period if self.sticky else -np.log(self.r) / self.duration  # per s
        stiffness = (2 * np.pi / period) ** 2 + damping**2
        depth, closing = self.diameter - s, -(speed @ n)
        force = (stiffness * depth + 2 * damping * closing) / 2  # on the struck body, per unit mass
        across = speed - (speed @ n) * n
        push = force * n - self.rub * abs(force) * across / np.sqrt(across @ across + 1e-8)
        rates = np.concatenate([y[4:8], push, -push, np.zeros(4)])
        if self.friction:
            for ball in (0, 2):
                slip = y[4 + ball : 6 + ball] - y[8 + ball : 10 + ball]
                pull = self.friction * GRAVITY * slip / np.sqrt(slip @ slip + 1e-8)
                rates[4 + ball : 6 + ball] -= pull
                rates[8 + ball : 10 + ball] += 2.5 * pull
        return rates


def _opening(diameter: float):  # type: ignore[no-untyped-def]
    def event(t: float, y: np.ndarray) -> float:
        return float(np.hypot(*(y[0:2] - y[2:4])) - diameter) if t > 1e-5 else -1.0

    event.terminal = True  # type: ignore[attr-defined]
    event.direction = 1  # type: ignore[attr-defined]
    return event


def draw_hit(rng: np.random.Generator, **fixed: object) -> SoftHit:
    """A hit as a laboratory has it: contacts of 0 to 30 ms at 250 to 1,000 frames a second."""
    hit = SoftHit(
        duration=float(rng.choice([0.0, *rng.uniform(0.002, 0.03, 5)])),
        r=rng.uniform(0.2, 0.95),
        v0=rng.uniform(0.15, 0.5),
        b=rng.choice([0.0, rng.uniform(-0.6, 0.6)]),
        friction=float(rng.choice([0.0, rng.uniform(0.05, 0.25)])),
        fps=float(rng.choice([250.0, 500.0, 1000.0])),
        noise=PIXEL * 0.05 * 10 ** rng.uniform(0, 1),
        heading=rng.uniform(0, 2 * np.pi),
    )
    return replace(hit, **{"before": int(0.08 * hit.fps), "after": int(0.35 * hit.fps)} | fixed)
