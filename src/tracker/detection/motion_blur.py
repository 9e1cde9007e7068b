"""How long the motion blur of moving glints is, over what velocity and the camera file's exposure make it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from tracker.camera.lens import Array

CURIOUS = 2.5  # deviations, for a further round, and
SURE = 5.0  # of its own deviations, and
PLAIN = 0.05  # of its length, beyond which the blur is not what the camera file says
SETTLED = 0.02  # of its length, by which a further round may change it
STRIKING = 8.0  # deviations, the most that one glint counts for
STRETCH = (0.4, 2.5)  # of the length, from round to round


@dataclass
class MotionBlurEvidence:
    """Score and information of a clip's moving glints on the length of their motion blur, gathered block by block."""

    score: list[Array] = field(default_factory=list)
    information: list[Array] = field(default_factory=list)

    def add(self, score: Array, information: Array) -> None:
        """Score (n,) and information (n,) of glints on the logarithm of the blur's length."""
        kept = np.isfinite(score) & (information > 0.0)
        self.score.append(score[kept])
        self.information.append(information[kept])

    def estimate_length(self) -> tuple[float, float, float]:
        """Factor by which the blur is longer than it was taken to be, its error, and its significance to first order;
        (1, inf, 0) if nothing is known.

        One Newton step in the square of the length, to which the glint's second moment owes its growth. Errors are
        those of the pixels' noise or of the glints' own scatter (sandwich estimator), the larger; the significance is
        that of the scores (Rao's test), none more than STRIKING of its deviations, so that no few misfits decide.
        """
        score, information = (np.concatenate([np.empty(0), *part]) for part in (self.score, self.information))
        if len(score) == 0:
            return 1.0, math.inf, 0.0
        whole = float(information.sum())
        step = float(score.sum()) / whole
        scatter = float(np.sum((score - step * information) ** 2))
        most = STRIKING * np.sqrt(information)
        held = np.clip(score, -most, most)
        noise = max(whole, min(scatter, len(held) * float(held.var())))
        low, high = STRETCH
        factor = math.sqrt(min(max(1.0 + 2.0 * step, low**2), high**2))
        return factor, math.sqrt(max(whole, scatter)) / whole, abs(float(held.sum())) / math.sqrt(noise)
