"""Two bodies whose contact takes time, by one of several laws of force along the normal, and their tracks."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pandas as pd

GRAVITY = 9.81  # m/s^2
PIXEL = 4e-4  # m
LAWS = ("spring", "cut", "hertz", "viscous", "dents")
STEPS = 300  # of integration, in the duration of a contact


@dataclass(frozen=True)
class SoftHit:
    """A striker that moves along x at a struck body at rest; lengths in m, times in s.

    The restitution is `r` and the force lasts for `duration`, at the closing speed of this hit and without friction.
    duration 0 is an instant. sticky: the contact never opens; the spring then has the period of 4 durations. friction:
    of the bodies with the plate; 0 for discs that slide without friction, otherwise the bodies are balls. rub: friction
    between the bodies.

    law, of the force against the depth x, and its end:

    - "spring": a linear spring with a dashpot, until the separation is one diameter again;
    - "cut": the same, until the force is zero;
    - "hertz": x^1.5 and a dashpot x^.25, of a restitution that no speed changes (Tsuji et al. 1992);
    - "viscous": x^1.5 and a dashpot x^.5 (Kuwabara & Kono 1987);
    - "dents": straight loading and a steeper unloading that leaves a dent (Walton & Braun 1986).
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
    law: str = "spring"

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

    @property
    def time_within(self) -> float:
        """Seconds for which the separation is under one diameter, in the first contact."""
        if self.duration == 0 or self.sticky:
            return self.duration
        t = np.linspace(0, 4 * self.duration, 4001)[1:]
        one, two = self.positions(t)
        within = self.diameter - np.hypot(*(one - two).T)
        k = int(np.argmax(within <= 0))
        return float(np.interp(0.0, [within[k], within[k - 1]], [t[k], t[k - 1]]))

    def positions(self, t: np.ndarray) -> np.ndarray:
        """(2, n, 2) m at times t since the first touch: struck, striker."""
        state, begin = self._state_at_touch(), 0.0
        out = np.zeros((2, len(t), 2))
        out[1] = state[2:4] + np.outer(t, [self.v0, 0.0])
        for _ in range(4):  # balls that slide may touch again
            times, way = self._touch(state, t[-1] - begin)
            within = (t >= begin) & (t <= begin + times[-1])
            for k in range(4):
                out[k // 2, within, k % 2] = np.interp(t[within] - begin, times, way[:, k])
            begin, state = begin + times[-1], way[-1]
            late = t > begin
            out[:, late] = self._slide_and_roll(state, t[late] - begin)[:, :4].reshape(-1, 2, 2).transpose(1, 0, 2)
            again = self._next_touch(state, t[-1] - begin)
            if again is None:
                break
            state, begin = self._slide_and_roll(state, np.array([again]))[0], begin + again
        return out

    def end_of_force(self) -> tuple[float, np.ndarray]:
        """Seconds for which the force lasts, and the state (12,) when it ends."""
        times, way = self._touch(self._state_at_touch(), np.inf)
        return float(times[-1]), way[-1]

    def _state_at_touch(self) -> np.ndarray:
        """Positions (4), velocities (4), and velocities at which the bodies would roll (4)."""
        start = np.array([-np.sqrt(1 - self.b**2), -self.b]) * self.diameter  # of the striker
        return np.concatenate([[0, 0], start, [0, 0], [self.v0, 0], [0, 0], [self.v0, 0]])

    def _touch(self, state: np.ndarray, left: float) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,) since a touch, and states (n, 12), until the force ends."""
        if self.duration == 0:
            apart = state[:2] - state[2:4]
            n = apart / np.hypot(*apart)
            change = (1 + self.r) / 2 * ((state[6:8] - state[4:6]) @ n) * n
            after = state.copy()
            after[4:6] += change
            after[6:8] -= change
            return np.array([0.0]), after[None]
        step, most, deepest = self.duration / STEPS, left if self.sticky else 6 * self.duration, 0.0
        times, way = [0.0], [state]
        while times[-1] < most:
            before = way[-1]
            y = self._step(before, step, deepest)
            depth, closing = self._depth(y)
            deepest = max(deepest, depth)
            ended = depth <= 0 if self.law == "spring" else self._push(depth, closing, deepest) <= 0
            ended = ended and not self.sticky and closing < 0
            if ended and self.law == "spring":  # its force does not end smoothly
                old = self._depth(before)[0]
                step *= max(old / (old - depth), 1e-6)
                y = self._step(before, step, deepest)
            times.append(times[-1] + step)
            way.append(y)
            if ended:
                break
        return np.array(times), np.array(way)

    def _next_touch(self, state: np.ndarray, left: float) -> float | None:
        """Seconds until free bodies touch again; None if they do not."""
        t = np.arange(1e-4, max(left, 2e-4), 2e-4)
        way = self._slide_and_roll(state, t)
        apart, speed = way[:, 0:2] - way[:, 2:4], way[:, 4:6] - way[:, 6:8]
        near = (np.hypot(*apart.T) < self.diameter) & ((apart * speed).sum(axis=1) < 0)
        return float(t[int(np.argmax(near))]) if near.any() and not self.sticky else None

    def _slide_and_roll(self, state: np.ndarray, t: np.ndarray) -> np.ndarray:
        """States (n, 12) of free bodies."""
        out = np.tile(state, (len(t), 1))
        for ball in (0, 2):
            x, v, carried = (state[k + ball : k + ball + 2] for k in (0, 4, 8))
            slip = v - carried
            size = np.hypot(*slip)
            if self.friction == 0 or size < 1e-9:
                out[:, ball : ball + 2] = x + np.outer(t, v)
                continue
            pull = -self.friction * GRAVITY * slip / size
            tau = size / (3.5 * self.friction * GRAVITY)
            s = np.minimum(t, tau)
            out[:, ball : ball + 2] = x + np.outer(s, v) + np.outer(s**2 / 2, pull) + np.outer(t - s, v + pull * tau)
            out[:, 4 + ball : 6 + ball] = v + np.outer(s, pull)
            out[:, 8 + ball : 10 + ball] = carried - 2.5 * np.outer(s, pull)
        return out

    def _push(self, depth: float, closing: float, deepest: float) -> float:
        """Relative acceleration (m/s^2) that the contact makes."""
        if self.sticky:
            rate = 2 * np.pi / (4 * self.duration)
            return (rate**2 + (0.25 * rate) ** 2) * depth + 2 * 0.25 * rate * closing
        loss, lasts = solve_law(self.law, self.r)
        speed = self.v0 * np.sqrt(1 - self.b**2)
        unit = self.duration / lasts  # s
        return speed / unit * push(self.law, loss, depth / (speed * unit), closing / speed, deepest / (speed * unit))

    def _depth(self, y: np.ndarray) -> tuple[float, float]:
        """Depth and closing speed of a state."""
        apart, speed = y[0:2] - y[2:4], y[4:6] - y[6:8]
        s = float(np.hypot(*apart))
        return self.diameter - s, -float(speed @ apart) / s

    def _step(self, y: np.ndarray, step: float, deepest: float) -> np.ndarray:
        """The state a step (s) later, by Runge and Kutta."""
        k1 = self._rates(y, deepest)
        k2 = self._rates(y + step / 2 * k1, deepest)
        k3 = self._rates(y + step / 2 * k2, deepest)
        k4 = self._rates(y + step * k3, deepest)
        return np.asarray(y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4))

    def _rates(self, y: np.ndarray, deepest: float) -> np.ndarray:
        apart, speed = y[0:2] - y[2:4], y[4:6] - y[6:8]
        s = np.hypot(*apart)
        n = apart / s
        closing = -float(speed @ n)
        force = self._push(self.diameter - s, closing, deepest) / 2  # on the struck body, per unit mass
        if self.law != "spring" and not self.sticky:
            force = max(force, 0.0)
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


def push(law: str, loss: float, x: float, v: float, deepest: float) -> float:
    """Relative acceleration of a contact at depth x and closing speed v, without units."""
    if law in ("spring", "cut"):
        return x + 2 * loss * v
    if law == "dents":
        return x if x >= deepest else deepest - (deepest - x) / loss**2
    x = max(x, 0.0)
    return x**1.5 + loss * x ** (0.25 if law == "hertz" else 0.5) * v


@lru_cache(maxsize=4096)
def solve_law(law: str, r: float) -> tuple[float, float]:
    """Loss of a law with the restitution r at a closing speed of 1, and how long its force lasts then."""
    if law == "spring":
        rate = -np.log(r)
        damping = rate / np.hypot(np.pi, rate)
        return float(damping), float(np.pi / np.sqrt(1 - damping**2))
    if law == "dents":
        return r, float(np.pi / 2 * (1 + r))
    low, high = 0.0, 4.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if _throw(law, middle)[0] > r else (low, middle)
    return middle, _throw(law, middle)[1]


def _throw(law: str, loss: float, step: float = 0.01) -> tuple[float, float]:
    """Restitution and duration of a head-on hit at a closing speed of 1."""

    def rate(x: float, v: float) -> float:
        return max(push(law, loss, x, v, 0.0), 0.0)

    x, v, t = 0.0, 1.0, 0.0
    while t < 20:
        a1 = rate(x, v)
        x2, v2 = x + step / 2 * v, v - step / 2 * a1
        a2 = rate(x2, v2)
        x3, v3 = x + step / 2 * v2, v - step / 2 * a2
        a3 = rate(x3, v3)
        x4, v4 = x + step * v3, v - step * a3
        a4 = rate(x4, v4)
        x, v, t = x + step / 6 * (v + 2 * v2 + 2 * v3 + v4), v - step / 6 * (a1 + 2 * a2 + 2 * a3 + a4), t + step
        if v < 0 and push(law, loss, x, v, 0.0) <= 0:
            break
    return -v, t


def draw_hit(rng: np.random.Generator, **fixed: object) -> SoftHit:
    """A hit as a laboratory has it: contacts of 0 to 30 ms at 250 to 1,000 frames a second."""
    duration = float(rng.choice([0.0, *rng.uniform(0, 0.03, 5)]))
    hit = SoftHit(
        duration=duration,
        r=rng.uniform(0.2, 0.95),
        v0=rng.uniform(0.15, 0.5),
        b=rng.choice([0.0, rng.uniform(-0.6, 0.6)]),
        friction=float(rng.choice([0.0, rng.uniform(0.05, 0.25)])),
        fps=float(rng.choice([250.0, 500.0, 1000.0])),
        noise=PIXEL * 0.03 * 10 ** rng.uniform(0, 1),
        heading=rng.uniform(0, 2 * np.pi),
        law=str(rng.choice(LAWS)),
    )
    if hit.law == "dents" and hit.r < 0.5:  # a dent of a low restitution is as deep as balls are not
        hit = replace(hit, law="cut")
    return replace(hit, **{"before": int(0.08 * hit.fps), "after": int(0.35 * hit.fps)} | fixed)
