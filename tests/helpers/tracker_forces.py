"""Two balls by the forces on them: an impulse as initial data, then friction, integrated."""

import numpy as np
from scipy.integrate import solve_ivp

from tracker.measurement.collision.collision_model import GRAVITY, TIED

R = 1.19e-3
TYPICAL = {"t_c": 0.0913, "x": 2e-3, "y": -1e-3, "heading": 0.7, "beta": 0.2, "v0": 0.3, "drag": 0.135}
TYPICAL |= {"decel": 0.0103, "r": 0.903, "log_mu": np.log(0.232), "C": 0.347, "wx": 0.0, "wy": 0.0}
TYPICAL |= {"ux": 0.0, "uy": 0.0, "side": 0.0}


def tied(**changes):
    return np.array([(TYPICAL | changes)[name] for name in TIED])


def spring_collision(theta, when):
    """Both balls' centres by integrating forces: a stiff contact impulse as initial data, then friction."""
    t_c, x, y, heading, beta, v0, drag, decel, r, log_mu, c, ux, uy, side, *target = theta
    z = np.array([0.0, 0.0, 1.0])
    d = np.array([np.cos(heading), np.sin(heading), 0])
    n = np.array([np.cos(heading - beta), np.sin(heading - beta), 0])
    v1 = np.array([*target, 0.0])
    v2 = v1 + v0 * d
    early = {1: v1, 2: v2}
    w1, w2 = np.cross(z, v1) / R, np.cross(z, v2 - [ux, uy, 0]) / R + side / R * z
    spun = {1: w1, 2: w2}
    slip = v2 - v1 + np.cross(w2 + w1, n) * R
    slip -= slip @ n * n
    impulse = (1 + r) / 2 * ((v2 - v1) @ n) * n + 0.4 * c * slip  # on ball 1, per unit mass
    impulse_flat = impulse - impulse @ z * z
    spin = 2.5 / R * np.cross(n, -0.4 * c * slip)
    first = np.array([x, y, 0.0])
    balls = {1: (first, v1 + impulse_flat, w1 + spin), 2: (first - 2 * R * n, v2 - impulse_flat, w2 + spin)}

    def force(_, state, rolling):
        v, w = state[3:6], state[6:9]
        if rolling:
            speed = np.linalg.norm(v)
            a = -(drag * speed + decel) * v / speed if speed > 1e-9 else np.zeros(3)
            return np.concatenate([v, a, np.cross(z, a) / R])
        u = v - R * np.cross(w, z)
        u[2] = 0
        a = -np.exp(log_mu) * GRAVITY * u / np.linalg.norm(u)
        return np.concatenate([v, a, 2.5 / R * np.cross(-z, a)])

    def slip_gone(_, state, rolling):
        u, v, w = u_start, state[3:6], state[6:9]
        return (v - R * np.cross(w, z)) @ u

    slip_gone.terminal = True
    out = {}
    for ball, start in balls.items():
        u_start = start[1] - R * np.cross(start[2], z)
        u_start[2] = 0
        options = {"rtol": 1e-11, "atol": 1e-13, "dense_output": True}
        slide = solve_ivp(force, (t_c, 9), np.concatenate(start), events=slip_gone, args=(False,), **options)
        end = slide.t[-1]
        roll = solve_ivp(force, (end, when.max() + 1), slide.y[:, -1], args=(True,), max_step=0.01, **options)
        slides = ball == 2 and bool(ux or uy)
        back = solve_ivp(
            lambda t, s: force(t, s, not slides),  # noqa: B023
            (t_c, -0.1),
            np.concatenate([start[0], early[ball], spun[ball]]),
            **options,
        )
        legs = [back.sol(t) if t < t_c else (slide.sol if t < end else roll.sol)(t) for t in when]
        out[ball] = np.array(legs)[:, :2]
    return out
