"""Which effect is missing: score tests of the whole library, alias classes, refits, and when to stop."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import gammaln
from scipy.stats import chi2 as chi2_law
from scipy.stats import norm

from discrepancy.fit import Fit, Whitener, derivative, fit, limits_of
from discrepancy.measured import Measured
from discrepancy.noise import Noise
from synthcam.effect import Effect, library

Array = NDArray[np.float64]

CLAIM = 4.0  # sigma: one claim in a thousand searches with nothing hidden, for a library of this size
MOST = 4  # effects named in one search: more together can imitate what is in nobody's library
SEEN = 1e-4  # of a signature's length that must be left when all that the fit absorbs is taken out
ALIAS = 0.9  # of the cosine between two signatures: beyond it the data hardly part them
PART = 9.5  # of chi^2: a rival that fits worse by less is not excluded
TRUST = 10.0  # where much stays unexplained, what an effect must explain, in units of that


def sigmas(chi2: float, dof: int) -> float:
    """The |z| of a normal variable as improbable as chi^2 with so many degrees of freedom."""
    if dof == 1:
        return float(np.sqrt(max(chi2, 0.0)))
    log_p = float(chi2_law.logsf(chi2, dof))
    if not log_p > -600:  # beyond 1e-300: the leading term of the tail
        half, x = dof / 2, chi2 / 2
        log_p = float(half * np.log(x) - x - gammaln(half) - np.log(x - half + 1))
    if log_p > np.log(0.999):
        return 0.0
    return float(brentq(lambda z: norm.logsf(z) + np.log(2) - log_p, 0, np.sqrt(chi2) + 1))


@dataclass(frozen=True)
class Candidate:
    """A score test. signature (points, k): the derivative at zero strength less all that the fit absorbs."""

    effect: str
    strengths: tuple[str, ...]
    sigma: float
    signature: Array


@dataclass(frozen=True)
class Named:
    """An effect added to the model. values, std: by dotted name. aliases: what fits as well, itself first."""

    effect: str
    values: dict[str, float]
    std: dict[str, float]
    sigma: float
    aliases: tuple[str, ...]


@dataclass(frozen=True)
class Search:
    """The outcome of a search. steps: the fits, before any effect and after each named one. ranking: the base's."""

    steps: tuple[Fit, ...]
    ranking: tuple[Candidate, ...]
    named: tuple[Named, ...]

    @property
    def base(self) -> Fit:
        return self.steps[0]

    @property
    def best(self) -> Fit:
        return self.steps[-1]

    def trusted(self) -> Search:
        """Without the effects, from the first that explains too little of what they all leave unexplained.

        For use where the library does not suffice: an effect outside it leans on some effect inside it.
        """
        excess = self.best.chi2 - (self.best.points - self.best.parameters)
        gains = [a.chi2 - b.chi2 for a, b in itertools.pairwise(self.steps)]
        kept = list(itertools.takewhile(lambda gain: gain > TRUST * excess, gains))
        return Search(
            self.steps[: len(kept) + 1], self.ranking, _refreshed(self.named[: len(kept)], self.steps[len(kept)])
        )


def _refreshed(named: Sequence[Named], last: Fit) -> tuple[Named, ...]:
    """The named effects with their strengths as the last fit has them."""
    errors = dict(zip(last.names, np.sqrt(np.diag(last.covariance)).tolist(), strict=True))
    return tuple(
        dataclasses.replace(n, values={s: last.model.value(s) for s in n.values}, std={s: errors[s] for s in n.values})
        for n in named
    )


def strengths_of(effect: type[Effect]) -> tuple[str, ...]:
    return tuple(f"{effect.name()}.{p.name}" for p in effect.strengths())


def rank(clips: Sequence[Measured], now: Fit, noise: Noise, tick: Callable[[], None]) -> tuple[Candidate, ...]:
    """Rao's score test of every effect whose strengths the fit has not fitted; most significant first."""
    whiteners = [Whitener.of(c, noise) for c in clips]
    left = np.concatenate(now.residuals)
    found = []
    for name, effect in library().items():
        strengths = tuple(s for s in strengths_of(effect) if s not in now.names)
        if not strengths:
            continue
        slopes = [derivative(now.model, now.launches, clips, s) for s in strengths]
        columns = [white(np.stack([s[k] for s in slopes], axis=-1)) for k, white in enumerate(whiteners)]
        tick()
        length = np.linalg.norm(np.concatenate(columns), axis=0)
        found.append(_score(name, strengths, now.projected(columns), length, left))
    return tuple(sorted(found, key=lambda c: -c.sigma))


def _score(name: str, strengths: tuple[str, ...], signature: Array, length: Array, left: Array) -> Candidate:
    """The score of one candidate; directions that the fit absorbs, as it does a wrong clock, count for nothing.

    length (k,): of the signature's columns before the fit took its part. A strength that has one sign scores nothing
    when the data ask for the other.
    """
    unit = signature / np.where(length > 0, length, 1)
    values, axes = np.linalg.eigh(unit.T @ unit)
    seen = values > SEEN**2
    if not seen.any():
        return Candidate(name, strengths, 0.0, signature)
    pulls = (axes[:, seen].T @ (unit.T @ left)) / np.sqrt(values[seen])
    if len(strengths) == 1 and limits_of(strengths[0])[0] == 0 and signature[:, 0] @ left < 0:
        return Candidate(name, strengths, 0.0, signature)
    return Candidate(name, strengths, sigmas(float(pulls @ pulls), int(seen.sum())), signature)


def likeness(one: Array, other: Array) -> float:
    """The largest cosine between two signatures' spans."""
    a, b = np.linalg.qr(one)[0], np.linalg.qr(other)[0]
    return float(np.linalg.svd(a.T @ b, compute_uv=False).max())


def search(clips: Sequence[Measured], base: Fit, noise: Noise, tick: Callable[[], None] = lambda: None) -> Search:
    """Name effects one by one until none scores CLAIM. Each leader and its aliases are refitted; the best fit stays."""
    now, steps = base, [base]
    named: list[Named] = []
    ranking = first = rank(clips, base, noise, tick)
    while ranking and ranking[0].sigma > CLAIM and len(named) < MOST:
        leader = ranking[0]
        rivals = [c for c in ranking if likeness(leader.signature, c.signature) > ALIAS]
        tries = [(fit(clips, now.model, [*now.names, *c.strengths], noise, now.launches, tick), c) for c in rivals]
        tries.sort(key=lambda t: t[0].chi2)
        best, winner = tries[0]
        gain = sigmas(now.chi2 - best.chi2, len(winner.strengths))
        if gain < CLAIM:
            break
        aliases = tuple(c.effect for f, c in tries if f.chi2 - best.chi2 < PART)
        values = {s: best.model.value(s) for s in winner.strengths}
        named.append(Named(winner.effect, values, values, gain, aliases))
        now = best
        steps.append(now)
        ranking = rank(clips, now, noise, tick)
    return Search(tuple(steps), first, _refreshed(named, now))
