"""How balls are turned: the integral of their spins, by Magnus's series of fourth order between knots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthcam.dynamics.trajectory import Trajectory

Array = NDArray[np.float64]

STEP = 0.1  # rad between two knots, at most
NODES = 0.5 + np.array([-1, 1]) / np.sqrt(12)  # Gauss's


class OrientationHistory:
    """Rotations from each ball's axes to the world's. first: quaternions (balls, 4), x y z w, as the motion starts."""

    def __init__(self, motion: Trajectory, first: Array) -> None:
        self._motion = motion
        coarse = np.linspace(motion.t0, motion.t1, 257)
        spins = np.linalg.norm(motion.at(coarse)[..., 6:9], axis=-1).max(axis=1)
        jumps = [e.t for e in motion.events]
        self._knots, self._turns = [], []
        for ball, spin in enumerate(spins):
            count = 2 + int(np.ceil(1.5 * spin * (motion.t1 - motion.t0) / STEP))
            knots = np.unique([*np.linspace(motion.t0, motion.t1, count), *jumps])
            steps = self._steps(ball, knots[:-1], knots[1:])
            turns = np.empty((len(knots), 4))
            turn = Rotation.from_quat(first[ball])
            turns[0] = turn.as_quat()
            for k, step in enumerate(steps):
                turn = step * turn
                turns[k + 1] = turn.as_quat()
            self._knots.append(knots)
            self._turns.append(turns)

    def at(self, ball: int, times: Array) -> Rotation:
        """One ball's rotations at times (m,) within the motion."""
        knots = self._knots[ball]
        k = np.clip(np.searchsorted(knots, times, "right") - 1, 0, len(knots) - 1)
        return self._steps(ball, knots[k], times) * Rotation.from_quat(self._turns[ball][k])

    def _steps(self, ball: int, start: Array, end: Array) -> Rotation:
        """Rotations (m,) between two times (m,) without a jump between them."""
        span = (end - start)[:, None]
        times = np.clip(start[:, None] + span * NODES, self._motion.t0, self._motion.t1)
        spins = self._motion.at(times.ravel())[ball, :, 6:9].reshape(-1, 2, 3)
        a, b = spins[:, 0], spins[:, 1]
        return Rotation.from_rotvec(span / 2 * (a + b) - np.sqrt(3) / 12 * span**2 * np.cross(a, b))
