"""Do collisions bear a claim that they had no part in? Each is foretold with the claim and without it.

Those kept out are foretold by the fits that never saw them, those fitted by all others of them (to first order). With
y what is measured, p and q what is foretold without the claim and with it, d = q - p: y asks for y d / |d| sigma of the
claim, which promised |d|; noise changes that by about one, and what is not known of the claim by |d| over its sigma.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.fitting.model_fit import ModelFit, project_out
from discrepancy.fitting.parameters import parameter_limits
from discrepancy.fitting.significance import closes_too_little
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.policy import current_policy

Parts = Sequence[Array]


@dataclass(frozen=True)
class HeldOutTest:
    """What collisions that had no part in a claim say of it.

    Attributes
    ----------
    gap : (float, float)
        chi^2 a point, without the claim and with it.
    sigma : float
        How many sigma of the claim they ask for.
    promised : float
        How many the claim promised.
    """

    gap: tuple[float, float]
    sigma: float
    promised: float

    @classmethod
    def of(
        cls, without: Parts, with_: Parts, known: float, there: ModelFit | None = None, covariance: Array | None = None
    ) -> HeldOutTest:
        """Hold a claim to clips: do they ask for it as much as it promised?

        Where the clips scatter about the claim by more than noise makes them, sigma is as much smaller.

        Parameters
        ----------
        without, with_ : parts
            Whitened residuals of each clip, by the model without the claim and with it.
        known : float
            Sigma of the claim in the clips fitted; inf where these are among them.
        there : Fit, optional
            The fit with the claim in these clips, for its derivatives.
        covariance : array, optional
            Of its shared parameters from the clips fitted: clips kept out may go beyond what those determine.

        Returns
        -------
        Held
        """
        apart = [p - q for p, q in zip(without, with_, strict=True)]
        size = sum(float(d @ d) for d in apart)
        gap = tuple(sum(float(r @ r) for r in every) / sum(map(len, every)) for every in (without, with_))
        if not size > 0:
            return cls((gap[0], gap[1]), 0.0, 0.0)
        asked = sum(float(p @ d) for p, d in zip(without, apart, strict=True)) / size**0.5
        scatter = sum(float(q @ d) ** 2 for q, d in zip(with_, apart, strict=True)) / size
        loose = size / max(known, 1.0) ** 2
        if there is not None and covariance is not None:
            own = zip(there.launch_slopes, there.slopes, apart, strict=True)
            pull = np.asarray(sum(project_out(a, s).T @ d for a, s, d in own))
            loose = max(loose, float(pull @ covariance @ pull) / size)
        noise = max(1 + loose, scatter if np.isinf(known) else 0.0) ** 0.5
        return cls((gap[0], gap[1]), asked / noise, size**0.5 / noise)

    @property
    def worse(self) -> bool:
        """Foretold no better with the claim."""
        return self.gap[1] >= self.gap[0]

    def closes_less(self, share: float) -> bool:
        """Whether they are not described with the claim, and it closes less than this share of what is missing."""
        return closes_too_little(*self.gap, share)


@dataclass(frozen=True)
class ClaimTest:
    """A claim, and what it is held to.

    Attributes
    ----------
    name : str
    own : float
        Sigma beside all else in the clips fitted.
    kept_out, turns : Held
        In the clips kept out, and in all, each held out once.
    why : str
        Why it is withdrawn; empty where it stands.
    free : bool
        Whether it is a law left free, not an effect.
    """

    name: str
    own: float
    kept_out: HeldOutTest
    turns: HeldOutTest
    why: str = ""
    free: bool = False

    def gap(self) -> dict[str, float]:
        """For discrepancy.json."""
        return {
            "without": self.kept_out.gap[0],
            "with": self.kept_out.gap[1],
            "sigma": self.kept_out.sigma,
            "promised": self.kept_out.promised,
            "turns_without": self.turns.gap[0],
            "turns_with": self.turns.gap[1],
            "turns_sigma": self.turns.sigma,
        }

    def document(self) -> dict[str, Any]:
        """A withdrawn one, for discrepancy.json."""
        return {"claim": self.name, "own_sigma": self.own, "why": self.why} | self.gap()


def reason_to_reject(kept_out: HeldOutTest, turns: HeldOutTest) -> str:
    """Why a claim is withdrawn; empty where the collisions bear it.

    The clips kept out are a quarter of all: they see a claim at the detection limit at some 2.5 sigma, and one in ten
    true claims makes their gap a little larger. So they refuse a claim only where they fall short of what it promised
    by more than their noise. Besides, all clips, each held out once, must ask for it beyond chance.

    Parameters
    ----------
    kept_out, turns : Held
        The claim held to the clips kept out, and to the clips fitted, each held out in turn.

    Returns
    -------
    str
    """
    if kept_out.worse and kept_out.sigma < kept_out.promised - current_policy().max_shortfall_sigma:
        return "collisions kept out are foretold worse with it"
    if turns.worse:
        return "collisions are foretold worse with it, each held out once"
    if turns.sigma < current_policy().leave_one_out_sigma:
        return "collisions, each held out once, do not ask for it beyond chance"
    leaves_more = kept_out.closes_less(current_policy().min_closed_share_of_weak_claim) and turns.closes_less(
        current_policy().min_closed_share_of_weak_claim
    )
    if leaves_more and turns.sigma < current_policy().beside_free_law_sigma:
        return f"far more is missing, and from collision to collision it scatters: {turns.sigma:.3g} sigma"
    if kept_out.closes_less(current_policy().min_closed_share) and turns.closes_less(current_policy().min_closed_share):
        without, with_ = kept_out.gap
        return (
            f"far more is missing: with it collisions kept out are at {with_:.3g} in chi^2 a point, not {without:.3g}"
        )
    return ""


def leave_one_out_residuals(fit: ModelFit, precision: Array | None = None) -> list[Array]:
    """Whitened residuals of each clip by the shared parameters of all other clips, to first order.

    The clip's own launch is fitted to it. Parameters that stand at a limit stay there.

    Parameters
    ----------
    fit : Fit
        Of all clips.
    precision : (J, J) array, optional
        The prior's, of the last J parameters: a free law's coefficients.

    Returns
    -------
    list of (2n,) array
    """
    free = np.array([not _at_limit(fit, n) for n in fit.names], dtype=bool)
    own = fit.linearisation.launch_bases
    slopes = [s[:, free] - q @ (q.T @ s[:, free]) for q, s in zip(own, fit.slopes, strict=True)]
    left = [r - q @ (q.T @ r) for q, r in zip(own, fit.residuals, strict=True)]
    if not free.any():
        return left
    known = np.zeros((len(free), len(free)))
    if precision is not None:
        known[-len(precision) :, -len(precision) :] = precision
    told = np.array([s.T @ s for s in slopes])
    whole = told.sum(axis=0) + known[np.ix_(free, free)]
    scale = np.sqrt(np.where(np.diag(whole) > 0, np.diag(whole), 1.0))
    out = []
    for s, r, own_told in zip(slopes, left, told, strict=True):
        inverse = np.linalg.pinv((whole - own_told) / np.outer(scale, scale), rcond=1e-10, hermitian=True)
        out.append(r + s @ (inverse @ (s.T @ r / scale) / scale))
    return out


def _at_limit(fit: ModelFit, name: str) -> bool:
    if " " in name:  # a coefficient of a free law
        return False
    return fit.model.value(name) in parameter_limits(fit.model, name)


def leave_one_out_with_law(fitted_law: FittedLaw) -> list[Array]:
    """`foretold` by a fit that holds a free law, with the law's prior."""
    return leave_one_out_residuals(fitted_law.joint_fit, fitted_law.prior.precision)
