"""Something that no effect of the library is: a law left free explains it better than any of them.

Every free law is held against the base model, the best model of the library, and each of its effects alone, to first
order; the leaders are fitted in full. A second library effect is believed only where it beats the free laws.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from discrepancy import policy
from discrepancy.data.collisions import Measured
from discrepancy.fitting.gauss_newton import FAILED, Evidence, Fit, fit, linearised, settle, solve
from discrepancy.fitting.parameters import Suspect, limits_of, within
from discrepancy.free_laws.credible_band import stepped
from discrepancy.free_laws.evidence import Weight, significance, weigh
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.free_law import FreeLaw
from discrepancy.free_laws.library import free_laws
from discrepancy.noise.model import Noise
from discrepancy.selection.candidate import Candidate
from discrepancy.selection.model_cost import law_chosen, price
from discrepancy.selection.score_test import Contest
from synthcam.model import Model

Array = NDArray[np.float64]

LEADERS = 3  # fitted in full
NEAR, LOOSE = 15.0, 0.01  # of chi^2, and of what a free law explains: what the first order may be wrong by
ROUNDS = 30
SETTLED = 0.05  # of chi^2: what a further step would gain
SHORTER = (1.0, 0.5, 0.25, 0.1, 0.02)  # shares of a step that are tried


@dataclass(frozen=True)
class Look:
    """A free law held against a fit, to first order."""

    law: FreeLaw
    now: Fit
    sigma: float
    weight: Weight

    def score(self, base: Fit) -> float:
        """What it would cost, in chi^2."""
        return price(self.now, base) + law_chosen() - self.weight.gain


def _moves(evidence: Evidence, law: FreeLaw, model: Model, launches: Array) -> tuple[Array, ...]:
    """Whitened derivatives by the coefficients, (2n, J) of each clip."""
    return evidence.white(law.columns(model, launches, evidence.clips))


def _look(law: FreeLaw, now: Fit, moves: Sequence[Array]) -> Look:
    information, pull = now.information(moves)
    return Look(law, now, significance(law, information, pull), weigh(law, information, pull))


def fill(evidence: Evidence, look: Look, base: Fit, tick: Callable[[], None] = lambda: None) -> FittedLaw:
    """The free law fitted with everything that `look.now` fits, its prior's size and smoothness by the data."""
    law, plain, now = look.law, look.now.model, look.now
    moves = _moves(evidence, law, plain, now.launches)
    coefs, here, fresh = np.zeros(law.size), evidence, False
    for _ in range(ROUNDS):
        tick()
        information, pull = now.information(moves)
        weight = weigh(law, information, pull + information @ coefs)
        precision, step = weight.prior.precision, weight.coefs - coefs
        moved = None
        if step @ (information + precision) @ step > SETTLED:
            before = now.chi2 + coefs @ precision @ coefs
            for share in SHORTER:
                moved = _moved(evidence, law, plain, now, moves, coefs, share * step)
                if moved and moved[1].chi2 + (coefs + share * step) @ precision @ (coefs + share * step) < before:
                    coefs = coefs + share * step
                    here, now, plain = moved
                    fresh = False
                    break
                moved = None
        if moved is None:
            if fresh:
                break
            now = linearised(here, now.model, now.names, now.launches)
            moves = _moves(evidence, law, law.bent(plain, coefs), now.launches)
            fresh = True
    freedom = np.linalg.slogdet(np.eye(law.size) + information / np.diag(weight.prior.precision)[:, None])
    paid = law_chosen() + weight.prior.cost + float(coefs @ weight.prior.precision @ coefs + freedom[1])
    smooth = FittedLaw(law, coefs, weight.prior, now, plain, here, moves, look.sigma, price(now, base) + paid)
    return dataclasses.replace(smooth, score=smooth.score - stepped(smooth))


def _moved(
    evidence: Evidence, law: FreeLaw, plain: Model, now: Fit, moves: Sequence[Array], coefs: Array, step: Array
) -> tuple[Evidence, Fit, Model] | None:
    """A step of the coefficients, and of all else as then fits best to first order; None where there is no motion."""
    rest = dataclasses.replace(now, residuals=tuple(r - c @ step for r, c in zip(now.residuals, moves, strict=True)))
    value = np.array([plain.value(n) for n in now.names])
    low, high = np.array([limits_of(plain, n) for n in now.names]).reshape(-1, 2).T
    shared, own = solve(rest, 0.0, low - value, high - value)
    launches = now.launches + own
    if not (np.all(np.abs(launches[:, 5]) < 1) and np.all(launches[:, 3] > 0)):
        return None
    try:
        plain = within(plain, dict(zip(now.names, (value + shared).tolist(), strict=True)))
        model = law.bent(plain, coefs + step)
        here = dataclasses.replace(evidence, clips=tuple(law.undone(evidence.clips, plain, launches, coefs + step)))
        residuals = here.left(model, launches)
    except FAILED:
        return None
    return here, dataclasses.replace(now, model=model, launches=launches, residuals=residuals), plain


def alone(evidence: Evidence, base: Fit, best: Fit, tick: Callable[[], None] = lambda: None) -> list[Fit]:
    """Where the best model has several effects that the base has not fitted: the fit of each of them alone."""
    added = dict.fromkeys(n.rpartition(".")[0] or n for n in best.names if n not in base.names)
    if len(added) < 2:
        return []
    fits = []
    for effect in added:
        own = [n for n in best.names if n not in base.names and (n.rpartition(".")[0] or n) == effect]
        effects = tuple(e for e in best.model.effects if e.name() == effect or e.name() not in added)
        values = {n: best.model.value(n) for n in own}
        model = dataclasses.replace(base.model, effects=effects).replace(values)
        with suppress(ValueError):  # alone it has no motion
            start = linearised(evidence, model, (*base.names, *own), base.launches)
            fits.append(settle(evidence, start, tick, rough=True))
    return fits


class FreeLawContest:
    """The free laws, held against the library's models as the search goes from one to the next.

    A named effect is preferred to a free law in its place: against a model of the library a free law counts only where
    that model leaves a free law significant, or needs two effects more than the free law does, or is worse by what an
    effect is preferred by. rivals: other models of the library with as many effects, which may be less simple than the
    latest but fit better.
    """

    def __init__(self, evidence: Evidence, base: Fit, tick: Callable[[], None] = lambda: None) -> None:
        self.evidence, self.base, self.tick = evidence, base, tick
        self.laws = free_laws(base.model, base.launches, evidence.clips)
        self.fitted: list[FittedLaw] = []
        self.rivals: Sequence[Fit] = ()
        self.beaten = False
        self.asked: tuple[FittedLaw, Candidate | None] | None = None
        self.refuted = self._consider([base])

    def beat(self, now: Fit, rivals: Sequence[Fit] = ()) -> bool:
        """Does a free law beside a smaller model explain more than the library's latest, and than the one before it?

        A free law may bend to hold two effects of the library: beside none, it must leave nothing for a second. And the
        library has one more effect to answer with.
        """
        self.rivals, before = rivals, self.beaten
        self.refuted = self._consider([*alone(self.evidence, self.base, now, self.tick), now])
        best = self._best(now, 1)
        self.beaten = best is not None and (self._count(now) > 1 or self._next(best) is None)
        return self.beaten and before

    def nearly(self, now: Fit) -> FittedLaw | None:
        """The free law that explains nearly as much as the library's best model, or more."""
        best = min(self.fitted, key=lambda f: f.score, default=None)
        return best if best and best.score < self._cost(now) + policy.FREE_LAW_NEAR else None

    def outcome(self, now: Fit) -> FittedLaw | None:
        """The free law that explains the clips better than the library's best model, and than chance; None if none
        does.

        With such library effects beside it as it still needs.
        """
        best = self._best(now, 0)
        for _ in range(policy.MOST_EFFECTS_BESIDE_FREE_LAW if best else 0):
            beside = self._next(best) if best else None
            if best is None or beside is None:
                break
            model = best.plain.replace(beside.shapes | dict.fromkeys(beside.strengths, 0.0))
            start = dataclasses.replace(best.now, model=model)
            try:
                for names in filter(None, (beside.strengths, tuple(beside.shapes))):  # shapes mean nothing before
                    whole = linearised(self.evidence, start.model, (*start.names, *names), start.launches)
                    start = settle(self.evidence, whole, self.tick)
                look = _look(best.law, start, _moves(self.evidence, best.law, start.model, start.launches))
                trial = fill(self.evidence, look, self.base, self.tick)
            except ValueError:  # without the free law there is no motion
                break
            if trial.score >= best.score or look.sigma < policy.FREE_LAW_SIGMA:
                break
            self.fitted.append(trial)
            best = trial
        return best

    def _best(self, now: Fit, fewer: int) -> FittedLaw | None:
        """The best law, if better, of those beside a model of `fewer` effects less than the library's latest."""
        cost, most = self._cost(now), self._count(now)
        few = [f for f in self.fitted if most - self._count(f.now) >= fewer and self._needed(f)]
        fair = [
            f
            for f in few
            if self.refuted or most - self._count(f.now) > 1 or f.score < cost - policy.EFFECT_PREFERRED_BY
        ]
        best = min(fair, key=lambda f: f.score, default=None)
        return best if best and best.score < cost else None

    def _needed(self, fitted_law: FittedLaw) -> bool:
        """Is every library effect beside a free law needed, or does the free law hold it too?"""
        return all(sigma > policy.FREE_LAW_SIGMA for sigma in fitted_law.beside(self.base).values())

    def _cost(self, now: Fit) -> float:
        return min(price(f, self.base) for f in (now, *self.rivals))

    def _count(self, now: Fit) -> int:
        """Effects in a fit that are not in the base."""
        return len({n.rpartition(".")[0] or n for n in now.names if n not in self.base.names})

    def _consider(self, fits: Sequence[Fit]) -> bool:
        """Fill those free laws that to first order may be the best. Is any significant beside the last of the fits?"""
        seen = []
        for law in self.laws:
            moves = _moves(self.evidence, law, self.base.model, self.base.launches)  # near enough for all fits
            seen += [_look(law, now, moves) for now in fits]
            self.tick()
        leaders = sorted(
            (look for look in seen if look.sigma > policy.FREE_LAW_SIGMA), key=lambda look: look.score(self.base)
        )
        for look in leaders[:LEADERS]:
            slack = NEAR + LOOSE * (price(look.now, self.base) - look.score(self.base))
            if all(look.score(self.base) < f.score + slack for f in self.fitted):
                with suppress(ValueError):  # a curve on whose way there is no motion
                    self.fitted.append(fill(self.evidence, look, self.base, self.tick))
        return any(look.now is fits[-1] for look in leaders)

    def _next(self, fitted_law: FittedLaw) -> Candidate | None:
        """The library's effect that is still to be claimed beside a free law."""
        if self.asked is None or self.asked[0] is not fitted_law:
            contest = Contest.of(fitted_law.evidence, fitted_law.whole, self.tick, about=fitted_law.plain)
            ranking = contest.leaders(policy.FREE_LAW_SIGMA)
            claimed = ranking and ranking[0].sigma > policy.FREE_LAW_SIGMA and ranking[0].sigma > contest.claim()
            self.asked = fitted_law, ranking[0] if claimed else None
        return self.asked[1]


def refilled(
    evidence: Evidence, fitted_law: FittedLaw, gone: Suspect, base: Fit, tick: Callable[[], None]
) -> FittedLaw:
    """The free law fitted again without one of the effects beside it. Raises ValueError: no motion."""
    names = tuple(n for n in fitted_law.now.names if n not in gone.strengths + gone.shapes)
    start = linearised(evidence, gone.without(fitted_law.plain), names, fitted_law.now.launches)
    now = settle(evidence, start, tick)
    return fill(
        evidence, _look(fitted_law.law, now, _moves(evidence, fitted_law.law, now.model, now.launches)), base, tick
    )


def emptied(evidence: Evidence, fitted_law: FittedLaw, tick: Callable[[], None]) -> Fit:
    """The fit without the free law. Raises ValueError: no motion."""
    return settle(evidence, linearised(evidence, fitted_law.plain, fitted_law.now.names, fitted_law.now.launches), tick)


def scatter(fitted_law: FittedLaw, clips: Sequence[Measured], without: Fit, noise: Noise) -> tuple[float, float, float]:
    """Of numbers of each clip, in clips that the free law was not fitted to: the chi^2 that their likelihood gains.

    And what it was to gain, and with which standard deviation. The numbers are as large as those of the clips fitted.
    """
    evidence = Evidence.of(clips, noise)
    axis = dataclasses.replace(fitted_law.law.axes[0], high=len(clips) - 1.0, count=len(clips))
    law = dataclasses.replace(fitted_law.law, axes=(axis,))
    now = linearised(evidence, without.model, (), without.launches)
    information, pull = now.information(_moves(evidence, law, now.model, now.launches))
    size = fitted_law.prior.size * np.sqrt(law.spread(fitted_law.prior.length))
    values, axes = np.linalg.eigh(size[:, None] * information * size)
    values, pulls = np.maximum(values, 0.0), axes.T @ (size * pull)
    gain = float((pulls**2 / (1 + values) - np.log1p(values)).sum())
    return gain, float((values - np.log1p(values)).sum()), float(np.sqrt(2 * (values**2).sum()))


def unseen(fitted_law: FittedLaw, clips: Sequence[Measured], before: Fit, noise: Noise) -> Fit:
    """The fit of the launches of clips that the free law was not fitted to, what it moves taken out of them.

    before: their fit without it. Numbers of each clip are fitted to each.
    """
    plain = fitted_law.plain
    if fitted_law.law.each_clip:
        evidence = Evidence.of(clips, noise)
        there = settle(evidence, linearised(evidence, plain, (), before.launches))
        axis = dataclasses.replace(fitted_law.law.axes[0], high=len(clips) - 1.0, count=len(clips))
        law = dataclasses.replace(fitted_law.law, axes=(axis,))
        look = _look(law, there, _moves(evidence, law, plain, there.launches))
        return fill(evidence, look, there).now
    left = fitted_law.law.undone(clips, plain, before.launches, fitted_law.coefs)
    return fit(left, fitted_law.now.model, (), noise, before.launches)
