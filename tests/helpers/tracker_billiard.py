"""Any number of rolling balls that hit each other, by the textbook in three dimensions: none of the tracker's formulas.

Between hits a ball slides (constant friction against the slip of its lowest point) until it rolls, and then rolls on
under its rolling loss. Positions are read at mid-exposure times of a short exposure, far shorter than a frame.
"""

from dataclasses import dataclass

import numpy as np

Z = np.array([0.0, 0.0, 1.0])
G = 9.81


@dataclass
class Physics:
    r: float = 0.9
    mu: float = 0.22
    c: float = 0.3
    drag: float = 0.135
    decel: float = 0.0103
    radius: float = 1.19e-3


def cross(a, b):
    """The vector product of two vectors; numpy's takes 40 microseconds for it."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def rolling(x, v, radius):
    """State (x, v, w) of a ball that rolls at v."""
    x, v = np.array([*x, 0.0]), np.array([*v, 0.0])
    return [x, v, cross(Z, v) / radius]


def slip(ball, radius):
    """Velocity of the lowest point."""
    u = ball[1] + cross(ball[2], -radius * Z)
    return u * [1, 1, 0]


def moved(ball, t, p):
    """State after t without a hit: slides, then rolls, then rests."""
    x, v, w = ball
    u = slip(ball, p.radius)
    size = np.linalg.norm(u)
    if size > 1e-12:
        tau = size / (3.5 * p.mu * G)
        dt = min(t, tau)
        a = -p.mu * G * u / size
        force_spin = cross(-p.radius * Z, a) / (0.4 * p.radius**2)
        x, v, w = x + v * dt + a * dt**2 / 2, v + a * dt, w + force_spin * dt
        if dt < tau:
            return [x, v, w]
        t = t - dt
        w = cross(Z, v) / p.radius + (w @ Z) * Z
    speed = np.linalg.norm(v)
    if speed < 1e-12:
        return [x, v, w]
    k = p.decel / p.drag
    t = min(t, np.log1p(speed / k) / p.drag)
    left = (speed + k) * np.exp(-p.drag * t)
    way = (speed + k) * -np.expm1(-p.drag * t) / p.drag - k * t
    v_new = v * (left - k) / speed
    return [x + v / speed * way, v_new, cross(Z, v_new) / p.radius + (w @ Z) * Z]


def hit(two, one, p):
    """States just after ball `two` touched ball `one`, and what happened."""
    n = (one[0] - two[0]) / np.linalg.norm(one[0] - two[0])
    rub = two[1] - one[1] + cross(two[2] + one[2], p.radius * n)
    rub = rub - rub @ n * n
    push = (1 + p.r) / 2 * ((two[1] - one[1]) @ n) * n
    drag = 0.4 * p.c * rub
    spin = cross(n, -drag) / (0.4 * p.radius)
    flat = drag * [1, 1, 0]
    return [two[0], two[1] - push - flat, two[2] + spin], [one[0], one[1] + push + flat, one[2] + spin], n


def play(balls, until, p):
    """Legs [(time, states)] from one hit to the next, and the hits [(time, two, one, before, after)]."""
    legs, hits, now = [(0.0, balls)], [], 0.0
    step = 1e-3
    while now < until:
        nxt = [moved(b, step, p) for b in balls]
        for i in range(len(balls)):
            for j in range(i):
                closing = (balls[j][0] - balls[i][0]) @ (balls[j][1] - balls[i][1]) < 0
                if closing and np.linalg.norm(nxt[j][0] - nxt[i][0]) < 2 * p.radius:
                    low, high = 0.0, step
                    for _ in range(60):
                        mid = (low + high) / 2
                        apart = moved(balls[j], mid, p)[0] - moved(balls[i], mid, p)[0]
                        low, high = (mid, high) if np.linalg.norm(apart) > 2 * p.radius else (low, mid)
                    before = [moved(b, low, p) for b in balls]
                    two, one = (i, j) if np.linalg.norm(before[i][1]) > np.linalg.norm(before[j][1]) else (j, i)
                    after = list(before)
                    after[two], after[one], _ = hit(before[two], before[one], p)
                    now += low
                    hits.append((now, two, one, before, after))
                    legs.append((now, after))
                    balls = after
                    break
            else:
                continue
            break
        else:
            balls, now = nxt, now + step
    return legs, hits


def positions(legs, times, p):
    """(balls, n, 2) m at times (n,)."""
    starts = np.array([t for t, _ in legs])
    out = np.zeros((len(legs[0][1]), len(times), 2))
    for k, t in enumerate(times):
        start, balls = legs[int(np.searchsorted(starts, t, side="right")) - 1]
        for i, ball in enumerate(balls):
            out[i, k] = moved(ball, t - start, p)[0][:2]
    return out


def truth(event, p):
    """The quantities of a hit, by their definitions."""
    t_c, two, one, before, after = event
    v1, v2 = before[one][1], before[two][1]
    n = (before[one][0] - before[two][0]) / (2 * p.radius)
    t = cross(Z, n)
    rel, gone = v2 - v1, after[two][1] - after[one][1]
    v0 = np.linalg.norm(rel)
    ends = {}
    for ball in (one, two):
        tau = np.linalg.norm(slip(after[ball], p.radius)) / (3.5 * p.mu * G)
        ends[ball] = tau, moved(after[ball], tau * (1 + 1e-12), p)[1]
    f1, f2 = ends[one][1], ends[two][1]
    out = {"v0": v0, "b": Z @ cross(rel / v0, before[two][0] - before[one][0]) / (2 * p.radius), "t_c": t_c}
    out |= {"r": -(gone @ n) / (rel @ n), "s": (gone @ t) / (rel @ t), "C": p.c, "mu_k": p.mu}
    out |= {"tau1": ends[one][0], "tau2": ends[two][0], "v1f": np.linalg.norm(f1), "v2f": np.linalg.norm(f2)}
    out["energy_fraction"] = (f1 @ f1 + f2 @ f2) / (v1 @ v1 + v2 @ v2)
    out["momentum_fraction"] = (f1 + f2) @ (v1 + v2) / ((v1 + v2) @ (v1 + v2))
    out["final_angle"] = np.arccos(f1 @ f2 / np.linalg.norm(f1) / np.linalg.norm(f2))
    out |= {"w1n": after[one][2] @ n, "w1t": after[one][2] @ t, "w2n": after[two][2] @ n, "w2t": after[two][2] @ t}
    return out | {"drag": p.drag, "decel": p.decel}
