"""The evidence of a clip's moving glints on the length of their motion blur, and so on the exposure."""

import math
from dataclasses import dataclass, field

import numpy as np

from synthcam_shared.arrays import Array


@dataclass
class MotionBlurEvidence:
    """Score and information of moving glints on the logarithm of their blur's length, collected block by block."""

    score: list[Array] = field(default_factory=list)
    information: list[Array] = field(default_factory=list)

    def add(self, score: Array, information: Array) -> None:
        """Add the score (n,) and the information (n,) of more glints."""
        kept = np.isfinite(score) & (information > 0.0)
        self.score.append(score[kept])
        self.information.append(information[kept])

    def estimate_length(self) -> tuple[float, float, float]:
        """Estimate the blur's length over the assumed one, its standard error, and how significantly it differs from 1.

        The estimate is one Newton step in the square of the length, to which a glint's second moment is proportional.
        The error is that of the pixels' noise or of the glints' own scatter (sandwich estimator), whichever is larger.
        The significance, in standard deviations, is that of Rao's score test.
        """
        score, information = (np.concatenate([np.empty(0), *part]) for part in (self.score, self.information))
        if len(score) == 0:
            return 1.0, math.inf, 0.0
        whole = float(information.sum())
        step = float(score.sum()) / whole
        scatter = float(np.sum((score - step * information) ** 2))
        most = 8.0 * np.sqrt(information)  # so that a few misfits cannot decide the significance
        clipped = np.clip(score, -most, most)
        noise = max(whole, min(scatter, len(clipped) * float(clipped.var())))
        low, high = 0.4, 2.5  # of one step
        factor = math.sqrt(min(max(1.0 + 2.0 * step, low**2), high**2))
        return factor, math.sqrt(max(whole, scatter)) / whole, abs(float(clipped.sum())) / math.sqrt(noise)
