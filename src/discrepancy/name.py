"""Which effect is missing: score tests of the whole library, alias classes, refits, and when to stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2 as chi2_law
from scipy.stats import norm

from discrepancy.fit import Fit, Whitener, derivative, fit
from discrepancy.measured import Measured
from discrepancy.noise import Noise
from synthcam.effect import Effect, library

Array = NDArray[np.float64]

CLAIM = 4.0  # sigma: one claim in a thousand searches with nothing hidden, for a library of this size
ALIAS = 0.9  # of the cosine between two signatures: beyond it the data hardly part them
PART = 9.5  # of chi^2: a rival that fits worse by less is not excluded


def sigmas(chi2: float, dof: int) -> float:
    """The |z| of a normal variable as improbable as chi^2 with so many degrees of freedom."""
    if dof == 1:
        return float(np.sqrt(max(chi2, 0.0)))
    log_p = float(chi2_law.logsf(chi2, dof))
    if not np.isfinite(log_p):
        return float(np.sqrt(2 * chi2) - np.sqrt(2 * dof - 1))  # Fisher's approximation, for beyond 1e-300
    if log_p > np.log(0.999):
        return 0.0
    return float(brentq(lambda z: norm.logsf(z) + np.log(2) - log_p, 0, 60))


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
    """The outcome of a search. base: the fit before; best: after the named effects. ranking: scores of the base fit."""

    base: Fit
    best: Fit
    ranking: tuple[Candidate, ...]
    named: tuple[Named, ...]


def strengths_of(effect: type[Effect]) -> tuple[str, ...]:
    return tuple(f"{effect.name()}.{p.name}" for p in effect.strengths())


def rank(clips: Sequence[Measured], now: Fit, noise: Noise, tick: Callable[[], None]) -> tuple[Candidate, ...]:
    """Rao's score test of every effect that the model does not hold yet, from one fit; most significant first."""
    present = {e.name() for e in now.model.effects if e.active}
    whiteners = [Whitener.of(c, noise) for c in clips]
    left = np.concatenate(now.residuals)
    found = []
    for name, effect in library().items():
        if name in present:
            continue
        strengths, columns = strengths_of(effect), []
        for clip, launch, white in zip(clips, now.launches, whiteners, strict=True):
            slopes = [derivative(now.model, launch, clip, s) for s in strengths]
            columns.append(white(np.stack(slopes, axis=-1)))
        tick()
        found.append(_score(name, strengths, now.projected(columns), left))
    return tuple(sorted(found, key=lambda c: -c.sigma))


def _score(name: str, strengths: tuple[str, ...], signature: Array, left: Array) -> Candidate:
    pull, information = signature.T @ left, signature.T @ signature
    if np.linalg.matrix_rank(information, hermitian=True) < len(strengths):
        return Candidate(name, strengths, 0.0, signature)
    return Candidate(name, strengths, sigmas(float(pull @ np.linalg.solve(information, pull)), len(pull)), signature)


def likeness(one: Array, other: Array) -> float:
    """The largest cosine between two signatures' spans."""
    a, b = np.linalg.qr(one)[0], np.linalg.qr(other)[0]
    return float(np.linalg.svd(a.T @ b, compute_uv=False).max())


def search(clips: Sequence[Measured], base: Fit, noise: Noise, tick: Callable[[], None] = lambda: None) -> Search:
    """Name effects one by one until none scores CLAIM. Each leader and its aliases are refitted; the best fit stays."""
    now, named = base, []
    ranking = first = rank(clips, base, noise, tick)
    while ranking and ranking[0].sigma > CLAIM:
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
        errors = np.sqrt(np.diag(best.covariance))
        std = {s: float(errors[best.names.index(s)]) for s in winner.strengths}
        named.append(Named(winner.effect, values, std, gain, aliases))
        now = best
        ranking = rank(clips, now, noise, tick)
    return Search(base, now, first, tuple(named))
