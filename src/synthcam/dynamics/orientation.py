"""The orientation of each ball over time: the integral of its spin, by the Magnus series of fourth order."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from synthcam.dynamics.trajectory import Trajectory
from synthcam_shared.arrays import Array


class OrientationHistory:
    """Rotations from the axes of each ball to those of the world.

    first: orientations (balls, 4) at the start of the motion, as quaternions x, y, z, w.
    Method: Blanes, Casas, Oteo & Ros, Physics Reports 470 (2009) 151.
    """

    def __init__(self, motion: Trajectory, first: Array) -> None:
        max_step = 0.1  # rad, the largest rotation between two knots
        self._motion = motion
        coarse = np.linspace(motion.t0, motion.t1, 257)
        spins = np.linalg.norm(motion.at(coarse)[..., 6:9], axis=-1).max(axis=1)
        jumps = [e.t for e in motion.events]
        self._knots, self._turns = [], []
        for ball, spin in enumerate(spins):
            count = 2 + int(np.ceil(1.5 * spin * (motion.t1 - motion.t0) / max_step))
            knots = np.unique([*np.linspace(motion.t0, motion.t1, count), *jumps])
            steps = self._steps(ball, knots[:-1], knots[1:])
            turns = [tuple(Rotation.from_quat(first[ball]).as_quat().tolist())]
            for step in steps.as_quat().tolist():
                turns.append(_compose(step, turns[-1]))
            self._knots.append(knots)
            self._turns.append(np.array(turns))

    def at(self, ball: int, times: Array) -> Rotation:
        """Return the rotations of one ball at times (m,) within the motion."""
        knots = self._knots[ball]
        k = np.clip(np.searchsorted(knots, times, "right") - 1, 0, len(knots) - 1)
        return self._steps(ball, knots[k], times) * Rotation.from_quat(self._turns[ball][k])

    def _steps(self, ball: int, start: Array, end: Array) -> Rotation:
        """Return the rotations (m,) between two times (m,) without a jump of the spin between them."""
        span = (end - start)[:, None]
        gauss_nodes = 0.5 + np.array([-1, 1]) / np.sqrt(12)
        times = np.clip(start[:, None] + span * gauss_nodes, self._motion.t0, self._motion.t1)
        spins = self._motion.at_one(ball, times.ravel())[:, 6:9].reshape(-1, 2, 3)
        a, b = spins[:, 0], spins[:, 1]
        return Rotation.from_rotvec(span / 2 * (a + b) - np.sqrt(3) / 12 * span**2 * np.cross(a, b))


def _compose(step: list[float], turn: tuple[float, ...]) -> tuple[float, ...]:
    """Turn an orientation by a step, both unit quaternions: of one alone, a tenth of the time of `Rotation`."""
    (a, b, c, d), (e, f, g, h) = step, turn
    x = d * e + h * a + (b * g - c * f)
    y = d * f + h * b + (c * e - a * g)
    z = d * g + h * c + (a * f - b * e)
    w = d * h - a * e - b * f - c * g
    size = math.sqrt(x * x + y * y + z * z + w * w)
    return x / size, y / size, z / size, w / size
