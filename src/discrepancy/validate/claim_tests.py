"""Which claims stand: each significant beside all others, and borne by collisions that it had no part in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.gauss_newton import fit_model, linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate, candidates_by_name
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.noise.model import Noise
from discrepancy.policy import current_policy
from discrepancy.select.beside_free_law import find_replacements
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.law_fit import compare_scatter, fit_unseen_clips, fit_without_law, refit_without_effect
from discrepancy.select.library_search import Selection, Stepwise
from discrepancy.select.model_cost import cost_of
from discrepancy.validate.constancy import find_variation
from discrepancy.validate.held_out import (
    ClaimTest,
    HeldOutTest,
    leave_one_out_residuals,
    leave_one_out_with_law,
    reason_to_reject,
)
from discrepancy.validate.residual_map import locate, unexplained

Parts = Sequence[Array]
Pair = tuple[Parts, Parts]
Left = dict[str, tuple[Selection, FittedLaw | None]]
Weighed = tuple[list[ClaimTest], Left, tuple[EffectClaim, ...]]

UNSURE = "not significant beside all else"
EXCHANGED = "another that fits as well is borne"  # a class is claimed, and collisions kept out may tell which of it
ABSORBED = "all else explains as much without it"
NO_LOSS = {EXCHANGED, ABSORBED}  # with what takes their place nothing is missing


@dataclass(frozen=True)
class ValidatedSelection:
    """What stands of a search. claims, withdrawn: those that stand and those that do not."""

    selected: Selection
    free_law: FittedLaw | None
    named: tuple[EffectClaim, ...]
    claims: tuple[ClaimTest, ...]
    withdrawn: tuple[ClaimTest, ...] = ()

    def unsure(self) -> tuple[EffectClaim, ...]:
        """What is named, where more is missing."""
        sigma = {claim.name: claim.turns.sigma for claim in self.claims}
        return tuple(n.unsure(sigma.get(n.effect, n.sigma)) for n in self.named)


@dataclass(frozen=True)
class Validation:
    """Clips fitted and kept out, and how claims are held to them."""

    steps: Stepwise
    evidence: WhitenedClips
    kept_out: Sequence[MeasuredCollision]
    before: ModelFit  # of the clips kept out, by the base model
    noise: Noise
    progress: Callable[[], None]

    def standing(self, selected: Selection, free_law: FittedLaw | None) -> ValidatedSelection:
        """Withdraw claims, the weakest first, until the clips bear all that are left.

        Parameters
        ----------
        selected : Selection
            The effects named.
        free_law : FittedLaw or None
            The free law declared.

        Returns
        -------
        ValidatedSelection
        """
        withdrawn: list[ClaimTest] = []
        while True:
            beside = free_law is not None or any(c.free for c in withdrawn) or self._lacks(selected)
            level = current_policy().beside_free_law_sigma if beside else selected.claim
            claims, without, named = self._claims(selected, free_law, level)
            falls = [c for c in claims if c.why]
            if not falls:
                stand = {claim.name for claim in claims}  # in the place of another, where it had fallen beside it
                return ValidatedSelection(
                    selected, free_law, named, tuple(claims), tuple(c for c in withdrawn if c.name not in stand)
                )
            worst = min(falls, key=lambda c: (c.why != ABSORBED, c.turns.sigma))
            if worst.why not in NO_LOSS:
                withdrawn.append(worst)
            selected, free_law = without[worst.name]

    def _lacks(self, selected: Selection) -> bool:
        """Whether effects were named and yet something is left unexplained."""
        return bool(selected.state) and unexplained(locate(self.evidence.clips, selected.best, self.noise))

    def _claims(self, selected: Selection, free_law: FittedLaw | None, level: float) -> Weighed:
        """Each claim, what is left without it, and the effects named. level: the sigma that an effect needs."""
        if free_law is None:
            return self._named(selected, level)
        claims, left, named = [], Left(), []
        whole, base = free_law.joint_fit, selected.base
        with_, turned = self._unseen(free_law), leave_one_out_with_law(free_law)
        known = candidates_by_name(free_law.model_without_law, base.model, base.names)
        for effect, sigma in free_law.significances_of_effects(base).items():
            own = selected.paid(effect, sigma)
            one = EffectClaim.of(known[effect], whole, whole.std, own)
            named.append(one)
            try:
                less = refit_without_effect(self.evidence, free_law, known[effect], base, self.progress)
            except ValueError:  # the clips have no motion without it
                continue
            left[effect] = selected, less
            held = self._held(own, (self._unseen(less), with_), (leave_one_out_with_law(less), turned))
            sure, absorbed = own > max(level, selected.claim), less.score <= free_law.score
            why = (ABSORBED if absorbed else reason_to_reject(*held) or one.at_end_of_range()) if sure else UNSURE
            others = [] if why else self._in_its_place(less, known[effect], free_law.score, base)
            named[-1] = replace(one, aliases=(effect, *(name for name, _ in others)))
            if others and others[0][1].score < free_law.score - current_policy().rival_excluded_chi2:
                left[effect], why = (selected, others[0][1]), EXCHANGED
            claims.append(ClaimTest(effect, own, *held, why))
        left[free_law.law.name] = selected, None
        return [*claims, self._free_law(selected, free_law, with_, turned)], left, tuple(named)

    def _in_its_place(
        self, less: FittedLaw, named: Candidate, score: float, base: ModelFit
    ) -> list[tuple[str, FittedLaw]]:
        """What fits as well beside a free law as an effect, better ones first. score: of the fit with the effect."""
        absorbed = self.steps.absorbed
        others = find_replacements(self.evidence, less, named, absorbed, base, self.progress)
        return [(name, other) for name, other in others if other.score < score + current_policy().rival_excluded_chi2]

    def _named(self, selected: Selection, level: float) -> Weighed:
        claims, left, every = [], Left(), self.steps.named(selected.state)
        for candidate, named in zip(selected.state, every, strict=True):
            less = self.steps.less(selected, candidate)
            left[candidate.name] = less, None
            held = self._between(named.sigma, less.best, selected.best)
            sure = named.sigma > max(level, selected.claim)
            why = reason_to_reject(*held) or named.at_end_of_range() if sure else UNSURE
            for alias in named.aliases[1:] if why and why != UNSURE else ():
                other = self.steps.instead(selected, candidate, alias)
                if other and not reason_to_reject(*self._between(named.sigma, less.best, other.best)):
                    left[candidate.name], why = (other, None), EXCHANGED
                    break
            why = why or find_variation(self.evidence, selected.best, candidate.strengths).refuses(named.sigma)
            claims.append(ClaimTest(candidate.name, named.sigma, *held, why))
        return claims, left, every

    def _between(self, own: float, without: ModelFit, with_: ModelFit) -> tuple[HeldOutTest, HeldOutTest]:
        """Two models of the library."""
        fits = self._launched(without), self._launched(with_)
        return self._held(own, fits, (leave_one_out_residuals(without), leave_one_out_residuals(with_)), with_)

    def _free_law(self, selected: Selection, free_law: FittedLaw, with_: ModelFit | None, turned: Parts) -> ClaimTest:
        name, own = free_law.law.name, free_law.sigma
        try:
            empty = fit_without_law(self.evidence, free_law, self.progress)
        except ValueError:  # no motion without the free law
            held = self._held(own, (None, with_), (turned, turned))
            return ClaimTest(name, own, *held, reason_to_reject(*held), free=True)
        without = self._launched(empty)
        if without is None or not free_law.law.is_per_clip:
            held = self._held(own, (without, with_), (leave_one_out_residuals(empty), turned))
            return ClaimTest(name, own, *held, reason_to_reject(*held), free=True)
        gain, promised, std = compare_scatter(free_law, self.kept_out, without, self.noise)
        before, std = without.chi2 / without.points, max(std, 1e-9)
        one = HeldOutTest((before, before - gain / without.points), gain / std, promised / std)
        gain += cost_of(empty, selected.base) - free_law.score  # in the clips fitted
        every = HeldOutTest((before, before - gain / without.points), own, own)
        return ClaimTest(name, own, one, every, reason_to_reject(one, every), free=True)

    def _held(
        self, own: float, fits: tuple[ModelFit | None, ModelFit | None], turned: Pair, fit: ModelFit | None = None
    ) -> tuple[HeldOutTest, HeldOutTest]:
        """In the clips kept out, and in all. A model that has no motion for those kept out is refused by them."""
        without, with_ = fits
        if with_ is None:
            nothing = HeldOutTest((self.before.chi2 / self.before.points, np.inf), -np.inf, own)
            return nothing, nothing
        if without is None:
            nothing = HeldOutTest((np.inf, with_.chi2 / with_.points), own, own)
            return nothing, nothing
        parts = without.residuals, with_.residuals
        every = [[*seen, *left] for seen, left in zip(turned, parts, strict=True)]
        there = (
            linearise(WhitenedClips.of(self.kept_out, self.noise), fit.model, fit.names, with_.launches)
            if fit
            else None
        )
        return HeldOutTest.of(*parts, own, there, fit.covariance if fit else None), HeldOutTest.of(
            every[0], every[1], np.inf
        )

    def _launched(self, fit: ModelFit) -> ModelFit | None:
        """The clips kept out, by a model of the library; None where it has no motion for them."""
        try:
            return fit_model(self.kept_out, fit.model, (), self.noise, self.before.launches, self.progress)
        except ValueError:
            return None

    def _unseen(self, free_law: FittedLaw) -> ModelFit | None:
        try:
            return fit_unseen_clips(free_law, self.kept_out, self.before, self.noise)
        except ValueError:
            return None
