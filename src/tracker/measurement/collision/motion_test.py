"""Tests the laws of sliding and rolling that a free fit contains, by how much better the motion of other laws fits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from tracker.measurement.collision.collision_model import AFTER, FREE
from tracker.measurement.collision.least_squares import CollisionFit, WhitenedResiduals

Floats = NDArray[np.float64]


def find_p_of_motion(free: CollisionFit, noise_dof: float, *, least_share: float = 1e-3) -> float:
    """Find the probability of so large a gain of chi^2 from other laws of motion, if those of the free fit are true.

    Few of the many degrees of freedom depend on a friction that falls with the speed, or on a slope. So chi^2 of all
    positions hardly shows them. The displacements that such laws cause are tested alone, by one linear step. NaN where
    the fit itself absorbs all of them.

    noise_dof: as in `compute_p_value`; least_share: of a displacement, that the parameters of the fit must leave.
    """
    problem = WhitenedResiduals(free.pair, tied=False)
    residual, rows = problem(free.parameters[problem.index])
    since = problem.start + free.pair.struck.exposure / 2 - free.parameters[0]
    whitened = problem.whiten(displace_by_other_laws(free.parameters, problem.ball, since)).T
    others = np.concatenate([whitened, np.zeros((len(residual) - len(whitened), whitened.shape[1]))])
    size = np.linalg.norm(others, axis=0)
    others = others[:, size > 0] / size[size > 0]
    known = np.linalg.qr(rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-30))[0]
    left = others - known @ (known.T @ others)
    basis, values, _ = np.linalg.svd(left, full_matrices=False)
    basis = basis[:, values > least_share]
    count = basis.shape[1]
    if not count or not noise_dof > 0:
        return np.nan
    gain = float(((residual @ basis) ** 2).sum())
    return float(chdtrc(count, gain) if np.isinf(noise_dof) else fdtrc(count, noise_dof, gain / count))


def displace_by_other_laws(free: Floats, ball: NDArray[np.int64], since: Floats) -> Floats:
    """Displacements (8, n, 2) of balls in any unit, each by a law of motion that a free fit (22,) does not contain.

    In a slide the acceleration changes with time, at the same velocities at its ends. Before the contact and after a
    slide a constant acceleration acts along the way or across it.

    ball (n,): 1 or 2; since (n,): time since the contact, s.
    """
    out = []
    for number, at in AFTER.items():
        own, tau = ball == number, np.exp(free[at + 4])
        slide, roll = np.clip(since, 0.0, tau), np.maximum(since - tau, 0.0)
        out.append(_along(free[at + 2 : at + 4] - free[at : at + 2], own * (slide**3 / (6 * tau) - slide**2 / 4)))
        along = _along(free[at + 2 : at + 4], own * roll**2)
        out += [along, _turn(along)]
    heading = free[FREE.index("heading")]
    before = _along(np.array([np.cos(heading), np.sin(heading)]), (ball == 2) * np.minimum(since, 0.0) ** 2)
    return np.array([*out, before, _turn(before)])


def _along(way: Floats, size: Floats) -> Floats:
    return np.outer(size, way / max(float(np.hypot(*way)), 1e-30))


def _turn(displacement: Floats) -> Floats:
    return np.column_stack([-displacement[:, 1], displacement[:, 0]])
