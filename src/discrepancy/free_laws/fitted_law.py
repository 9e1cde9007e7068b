"""A free law fitted together with all other parameters, and its curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import find_parameter
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.marginal_likelihood import CoefficientPrior
from synthcam.model import Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class FittedLaw:
    """A free law fitted together with all other parameters.

    Its model has the law as an effect. If no effect can express it, what the law moves is subtracted from the tracks.
    """

    law: FreeLaw
    coefs: Array  # (size,)
    prior: CoefficientPrior
    fit: ModelFit  # of all other parameters
    model_without_law: Model
    evidence: WhitenedClips  # the clips
    slopes: tuple[Array, ...]  # (2n, size) of each clip: whitened derivatives by the coefficients
    sigma: float  # significance of the law against the fit without it
    score: float  # chi^2 plus the cost of all freedom

    @property
    def joint_fit(self) -> ModelFit:
        """The fit with the coefficients as parameters."""
        names = [f"{self.law.name} {j}" for j in range(self.law.size)]
        return self.fit.extend(self.fit.model, names, self.slopes)

    @property
    def owners(self) -> list[tuple[str, int]]:
        """The base parameters of the law that are fitted, with their powers of the axis."""
        return [(name, power) for name, power in self.law.owners if name in self.fit.names]

    def curve(self, *x: Array) -> tuple[Array, Array]:
        """Evaluate the law at x: values (n, parts), and their covariances between the points, (parts, n, n)."""
        series = self.law.values(self.coefs, *x).reshape(-1, self.law.parts)
        values = self.law.value_in_model(self.fit.model, *x) + series
        extra, one = len(self.owners), self.law.size // self.law.parts
        matrix, _ = self.information_with_owners(self.slopes)
        matrix[extra:, extra:] += self.prior.precision
        scale = np.sqrt(np.diag(matrix))
        spread = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)  # marginal over all else
        own = np.stack([x[0] ** power for _, power in self.owners], axis=-1) if extra else np.zeros((len(x[0]), 0))
        covariances = []
        for part in range(self.law.parts):
            rows = np.r_[np.arange(extra), extra + part * one + np.arange(one)]
            design = np.concatenate([own, self.law.basis(*x)], axis=1)
            if self.law.centred:
                design = design - design.mean(axis=0)
            covariances.append(design @ spread[np.ix_(rows, rows)] @ design.T)
        return (values - values.mean(axis=0) if self.law.centred else values), np.stack(covariances)

    def information_with_owners(self, columns: Sequence[Array]) -> tuple[Array, Array]:
        """Information and pull of the law's own parameters, followed by columns (2n, k) of each clip."""
        names = [name for name, _ in self.owners]
        own = [s[:, self.fit.columns_of(names)] for s in self.fit.slopes]
        both = [np.concatenate(pair, axis=1) for pair in zip(own, columns, strict=True)]
        return self.fit.drop(self.fit.model, names).information(both)

    def significances_of_effects(self, base: ModelFit) -> dict[str, float]:
        """Significance, in sigma, of each effect that is fitted beside the free law and is not in the base fit.

        It compares the effect's strengths with their values in the base fit, marginal over the free law.
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
        """The maximum of the likelihood over the coefficients, (J,), and their information, (J, J), without a prior.

        The law's own parameters are part of the coefficients. These are relative to the fitted own parameters.
        """
        names = [name for name, _ in self.owners]
        information, pull = self.fit.drop(self.fit.model, names).information(self.slopes)
        pull = pull + information @ self.coefs
        return np.asarray(np.linalg.pinv(information, rcond=1e-10, hermitian=True) @ pull), information
