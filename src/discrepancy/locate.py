"""Where simulation and measurement disagree: by phase, ball and observable, before any effect is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_law
from scipy.stats import norm

from discrepancy.fit import Fit, Whitener
from discrepancy.forecast import forecast
from discrepancy.measured import Measured
from discrepancy.name import sigmas
from discrepancy.noise import Noise

Array = NDArray[np.float64]

PHASES = ("before", "sliding", "rolling")
BALLS = ("ball 1", "ball 2")
AXES = ("along", "across")
TERMS = 3  # offset, drift and bend of the residual within a phase


@dataclass(frozen=True)
class Place:
    """One look: the residuals of a ball in a phase, along or across its motion. sigma: corrected for all looks."""

    phase: str
    ball: str
    observable: str
    sigma: float


def locate(clips: Sequence[Measured], now: Fit, noise: Noise) -> tuple[Place, ...]:
    """Every look at the fit's residuals, most significant first.

    In each clip the whitened residual of one ball and phase is held against an offset, a drift and a bend along (or
    across) its motion; the squares add up over clips. What the fit absorbed makes the test a little mild.
    """
    sums = {(p, b, a): [0.0, 0] for p in range(3) for b in range(2) for a in range(2)}
    expected = forecast(now.model, now.launches, clips)
    for k, clip in enumerate(clips):
        white = Whitener.of(clip, noise)
        phase, motion = clip.phase(), _directions(clip, expected[k])
        for p, b, a in sums:
            rows = (phase == p) & (clip.ball == b)
            if rows.sum() < 2 * TERMS:
                continue
            time = np.linspace(-1, 1, int(rows.sum()))
            basis = np.zeros((len(phase), 2, TERMS))
            basis[rows] = motion[rows, a, :, None] * np.vander(time, TERMS)[:, None]
            q, _ = np.linalg.qr(white(basis))
            sums[p, b, a][0] += float(((q.T @ now.residuals[k]) ** 2).sum())
            sums[p, b, a][1] += TERMS
    looks = sum(1 for _, dof in sums.values() if dof)
    found = [
        Place(PHASES[p], BALLS[b], AXES[a], _corrected(chi2, int(dof), looks))
        for (p, b, a), (chi2, dof) in sums.items()
        if dof
    ]
    return tuple(sorted(found, key=lambda x: -x.sigma))


def _corrected(chi2: float, dof: int, looks: int) -> float:
    p = looks * float(chi2_law.sf(chi2, dof))
    if p >= 1:
        return 0.0
    return float(norm.isf(p / 2)) if p > 1e-250 else sigmas(chi2, dof)


def _directions(clip: Measured, path: Array) -> Array:
    """Unit vectors along and across each ball's motion in each phase, (n, 2, 2); at rest along the heading."""
    heading = clip.launch[4]
    along = np.tile([np.cos(heading), np.sin(heading)], (len(path), 1))
    phase = clip.phase()
    for p in range(3):
        for b in range(2):
            rows = np.flatnonzero((phase == p) & (clip.ball == b))
            if len(rows) < 2:
                continue
            way = path[rows[-1]] - path[rows[0]]
            if np.hypot(*way) > 1e-5:
                along[rows] = way / np.hypot(*way)
    return np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)
