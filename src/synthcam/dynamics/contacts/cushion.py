"""The impact of a ball on a cushion, by the equations of Mathavan, Jackson & Parkin.

They are in Proc. IMechE C 224 (2010) 1863. The cushion touches the ball above its centre, at an angle theta, and
presses it on the plate. Both rub the ball, and the directions of both slips change during the impact. So the
velocities are integrated over the impulse P of the cushion. The first part ends when the ball no longer approaches.
The second ends when the cushion has returned the share e^2 of the work done on it.
"""

import math

import numpy as np

from synthcam.dynamics.contacts.walls import Wall, WallImpact
from synthcam.dynamics.kinematics import State
from synthcam.model import Body
from synthcam_shared.arrays import Array


def press_cushion(wall: Wall, plate_friction: float, ball: State, body: Body, restitution: float) -> WallImpact:
    """Let a ball hit a cushion that it touches.

    plate_friction: of the ball on the plate.
    Raises ValueError if friction keeps the cushion from stopping the ball.
    """
    sticking_share = 1e-6  # of the first speed: friction fades at slips below it, which is sticking
    (radius, mass, inertia), (x, y, z, vx, vy, vz, wx, wy, wz) = body, ball
    _, nx, ny = wall.distance(x, y)
    sine, friction = wall.rise(radius), wall.friction
    cosine = math.sqrt(1 - sine * sine)
    first = np.array([  # along the cushion and towards it
        *(nx * vy - ny * vx, -nx * vx - ny * vy),
        *(nx * wy - ny * wx, -nx * wx - ny * wy, wz),
        0.0,
    ])  # fmt: skip
    least, turn = sticking_share * math.hypot(*first[:2]), 1 / (inertia * radius)

    def change(_: float, now: Array) -> list[float]:
        a, b, ra, rb, rz = now[0], now[1], radius * now[2], radius * now[3], radius * now[4]
        ia, ib = a + rb * sine - rz * cosine, ra - b * sine
        ca, cb = a - rb, b + ra
        slip, slip_below = math.hypot(ia, ib, least), math.hypot(ca, cb, least)
        pa, pb = friction * ia / slip, friction * ib / slip
        pressed = plate_friction * (sine + pb * cosine)
        qa, qb = pressed * ca / slip_below, pressed * cb / slip_below
        return [
            *(-pa - qa, pb * sine - cosine - qb),
            *(-turn * (pb + qb), -turn * (pa * sine - qa), turn * pa * cosine),
            abs(b) * cosine,
        ]

    from scipy.integrate import solve_ivp  # here alone: slow to load

    def integrate(start: Array, until: int, level: float) -> tuple[float, Array]:
        def reached(_: float, now: Array) -> float:
            return float(now[until] - level)

        reached.terminal = True  # type: ignore[attr-defined]
        most = 100 * math.hypot(*first[:2])
        done = solve_ivp(change, (0.0, most), start, method="LSODA", rtol=1e-8, atol=1e-12, events=reached)
        if done.t_events is None or done.y_events is None or not len(done.t_events[0]):
            raise ValueError("friction keeps a cushion from stopping a ball: the cushion is too high or too rough")
        return float(done.t_events[0][0]), np.asarray(done.y_events[0][0])

    pressing, now = integrate(first, 1, 0.0)
    easing, now = integrate(np.array([*now[:5], 0.0]), 5, restitution**2 * now[5]) if restitution > 0 else (0.0, now)
    a, b, wa, wb, wz_after = now[:5].tolist()
    after = (x, y, z, -ny * a - nx * b, nx * a - ny * b, vz, -ny * wa - nx * wb, nx * wa - ny * wb, wz_after)
    impulse_t = -inertia * radius * (wz_after - wz) / cosine
    return WallImpact(after, (nx, ny), mass * (pressing + easing), mass * impulse_t)
