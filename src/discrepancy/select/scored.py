"""A candidate that is scored: with some values of its shape parameters, and what it would explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from discrepancy.arrays import Array
from discrepancy.fitting.parameters import Candidate, find_parameter
from synthcam.model import Model


@dataclass(frozen=True)
class RealisticSizes:
    """Realistic sizes (k,) of a candidate's strengths, and how many of them its limits allow.

    side: 1 where a single strength stands at its lower limit and can only grow, -1 at its upper, else 0.
    """

    sizes: Array
    allowed: float
    side: int

    @classmethod
    def of(cls, candidate: Candidate, model: Model) -> RealisticSizes:
        """Of a candidate beside this model."""
        ways = [find_parameter(model, s) for s in candidate.strengths]
        sizes = np.array([p.typical or 1.0 for p in ways])
        allowed = max(max(abs(p.low), abs(p.high)) / size for p, size in zip(ways, sizes, strict=True))
        value, p = model.value(candidate.strengths[0]), ways[0]
        side = int(value <= p.low) - int(value >= p.high) if len(ways) == 1 else 0
        return cls(sizes, allowed, side)


@dataclass(frozen=True)
class CandidateScore:
    """A candidate with its score test.

    Attributes
    ----------
    candidate : Candidate
    shapes : dict of str to float
        The best values tried of its shape parameters, for whose number sigma is corrected.
    sigma : float
    gain : float
        The chi^2 that adding it would take, to first order.
    limit : float
        The detection limit, in realistic sizes of the strength that shows best; infinite where the fit absorbs all.
    identifiable : bool
        False where that limit is absurd, or more than the effect allows.
    signature : (points, m) array
        The derivative at zero strength less all that the fit absorbs, made orthonormal; m <= k directions are seen.
    columns : tuple of (2n, k) arrays
        The derivative of each clip's whitened forecast, before anything is taken out.
    """

    candidate: Candidate
    shapes: dict[str, float]
    sigma: float
    gain: float
    limit: float
    identifiable: bool
    signature: Array
    columns: tuple[Array, ...]

    @property
    def absorbed(self) -> bool:
        """Whether it moves the tracks, but only as the fit's own parameters and launches can."""
        return self.signature.shape[1] == 0 and any(c.any() for c in self.columns)

    @property
    def effect(self) -> str:
        return self.candidate.name

    @property
    def strengths(self) -> tuple[str, ...]:
        return self.candidate.strengths


@dataclass(frozen=True)
class CandidateTrial:
    """A candidate with values of its shape parameters, and the derivatives by its strengths, (2n, k) of each clip."""

    candidate: Candidate
    shapes: dict[str, float]
    columns: tuple[Array, ...]


@dataclass(frozen=True)
class TrialScore:
    """The score of a trial, as in `CandidateScore`. axes (k, m): its signature times these is an orthonormal basis."""

    trial: CandidateTrial
    sigma: float
    gain: float
    limit: float
    identifiable: bool
    axes: Array

    @property
    def order(self) -> tuple[bool, float, float]:
        """The key to sort scores by, the best first."""
        return not self.identifiable, -self.sigma, self.limit

    def scored(self, signature: Array) -> CandidateScore:
        """The candidate as scored. signature (points, k): the trial's columns less all that the fit absorbs."""
        columns = tuple(np.array(c) for c in self.trial.columns)  # no views, which would keep all trials alive
        return CandidateScore(
            self.trial.candidate,
            self.trial.shapes,
            self.sigma,
            self.gain,
            self.limit,
            self.identifiable,
            signature @ self.axes,
            columns,
        )
