"""A free law fitted in full: the coefficients of its law with everything else, and the law's curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from discrepancy.arrays import Array
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import find_parameter
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.marginal_likelihood import Prior
from synthcam.model import Model


@dataclass(frozen=True)
class FittedLaw:
    """A free law fitted in full.

    Attributes
    ----------
    law : FreeLaw
    coefs : (size,) array
    prior : Prior
    fit : Fit
        The fit beside it, its model with the law in it where an effect can hold it.
    plain : Model
        The model without the law.
    evidence : Evidence
        The clips, with what the law moved taken out of them where no effect can hold it.
    moves : tuple of (2n, size) arrays
        Whitened derivatives by the coefficients, of each clip.
    sigma : float
        Of the law against the fit without it.
    score : float
        chi^2 with the cost of all freedom.
    """

    law: FreeLaw
    coefs: Array
    prior: Prior
    fit: ModelFit
    model_without_law: Model
    evidence: WhitenedClips
    slopes: tuple[Array, ...]
    sigma: float
    score: float

    @property
    def joint_fit(self) -> ModelFit:
        """The fit with the coefficients among its parameters."""
        names = [f"{self.law.name} {j}" for j in range(self.law.size)]
        return self.fit.extend(self.fit.model, names, self.slopes)

    @property
    def owners(self) -> list[tuple[str, int]]:
        """Those of the law's own parameters that the fit changed."""
        return [(name, power) for name, power in self.law.owners if name in self.fit.names]

    def curve(self, *x: Array) -> tuple[Array, Array]:
        """The law at x: values (n, parts), and their covariances over the places, (parts, n, n)."""
        values = self.law.value_in_model(self.fit.model, *x) + self.law.values(self.coefs, *x).reshape(
            -1, self.law.parts
        )
        spread, extra, one = self._covariance(), len(self.owners), self.law.size // self.law.parts
        own = np.stack([x[0] ** power for _, power in self.owners], axis=-1) if extra else np.zeros((len(x[0]), 0))
        covariances = []
        for part in range(self.law.parts):
            rows = np.r_[np.arange(extra), extra + part * one + np.arange(one)]
            design = np.concatenate([own, self.law.basis(*x)], axis=1)
            if self.law.centred:
                design = design - design.mean(axis=0)
            covariances.append(design @ spread[np.ix_(rows, rows)] @ design.T)
        return (values - values.mean(axis=0) if self.law.centred else values), np.stack(covariances)

    def _covariance(self) -> Array:
        """Of the law's own parameters and the coefficients, all else marginal."""
        names = [name for name, _ in self.owners]
        own = [s[:, self.fit.columns_of(names)] for s in self.fit.slopes]
        both = [np.concatenate(pair, axis=1) for pair in zip(own, self.slopes, strict=True)]
        matrix, _ = self.fit.drop(self.fit.model, names).information(both)
        matrix[len(names) :, len(names) :] += self.prior.precision
        scale = np.sqrt(np.diag(matrix))
        return np.asarray(np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale))

    def significances_of_effects(self, base: ModelFit) -> dict[str, float]:
        """Sigma of what is fitted beside the free law and not in the base, by effect, the free law being free.

        How far its strengths are from what the base holds them at.
        """
        fit, found = self.joint_fit, {}
        for effect, names in self.fit.added_names(base).items():
            own = [n for n in names if "." not in n or not find_parameter(fit.model, n).fixed]
            rows = fit.columns_of(own)
            moved = fit.values(own) - base.values(own)
            covariance = fit.covariance[np.ix_(rows, rows)]
            found[effect] = chi2_to_sigma(float(moved @ np.linalg.pinv(covariance, hermitian=True) @ moved), len(own))
        return found

    def likelihood_of_curve(self) -> tuple[Array, Array]:
        """Of the whole law as coefficients, its own parameters among them: where it is largest, and its information.

        (J,) and (J, J), no prior in either; relative to the law's own parameters as fitted.
        """
        names = [name for name, _ in self.owners]
        information, pull = self.fit.drop(self.fit.model, names).information(self.slopes)
        pull = pull + information @ self.coefs
        return np.asarray(np.linalg.pinv(information, rcond=1e-10, hermitian=True) @ pull), information
