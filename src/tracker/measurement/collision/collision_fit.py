"""The tied and the free fit of one collision, and the choice among the motions of its striker."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from synthcam_shared.arrays import Array
from tracker.measurement.collision.adequacy import (
    SHORT_SLIDE,
    Flag,
    compute_p_of_rise,
    compute_p_value,
    find_impossible_values,
)
from tracker.measurement.collision.collision_model import AFTER, FREE, TARGET, TIED, tied_to_free
from tracker.measurement.collision.contacts import Contact, ContactCandidate, EarlierHit, guess_parameters
from tracker.measurement.collision.departures import (
    LawDeparture,
    average_over_departures,
    derive_quantities,
    find_p_of_motion,
    find_slope_of_friction,
)
from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues
from tracker.measurement.collision.lasting_contact import (
    MIN_SIGNIFICANCE,
    LastingContact,
    LastingFits,
    as_collision_fits,
    fit_lasting_contact,
)
from tracker.measurement.collision.least_squares import ROUGH_TOLERANCE, BallPair, CollisionFit, fit_motion
from tracker.measurement.collision.noise_correlation import with_correlated_noise
from tracker.measurement.collision.striker import is_believable_striker, list_alternative_strikers
from tracker.settings import FitSettings

ONCE_BOTH_ROLL = ("mu_k", "C", "energy_fraction", "momentum_fraction", "final_angle")  # known once both balls roll
AFTER_SLIDES = (*ONCE_BOTH_ROLL, "tau1", "tau2", "v1f", "v2f", "drag", "decel", "w1n", "w1t", "w2n", "w2t")


def name_quantities_of_slide(ball: int) -> set[str]:
    """Name the quantities of a collision that are measured once the slide of a ball has ended."""
    return {f"tau{ball}", f"v{ball}f", f"w{ball}n", f"w{ball}t", *ONCE_BOTH_ROLL}


@dataclass(frozen=True)
class CollisionFits:
    """Both fits of one collision, with the quantities that they determine."""

    contact: Contact
    tied: CollisionFit
    free: CollisionFit
    slide_ends_seen: tuple[bool, bool]
    tied_values: DerivedValues
    free_values: DerivedValues
    flags: tuple[Flag, ...] = ()
    unseen: frozenset[str] | None = None  # quantities that a lasting contact does not show
    fits: LastingFits | None = None  # those of a lasting contact
    # departures from laws that both fits assume, by the flag of their rejection
    tied_departures: Mapping[Flag, LawDeparture] = field(default_factory=dict)
    free_departures: Mapping[Flag, LawDeparture] = field(default_factory=dict)

    @property
    def tied_is_straight(self) -> bool:
        """True if straight lines describe the balls after the hit, without laws of friction."""
        return self.fits is not None and self.fits.tied is self.fits.free

    @property
    def lasting(self) -> LastingContact | None:
        """The contact, if its frames are left out because it lasts."""
        return None if self.fits is None else self.fits.contact

    @property
    def settings(self) -> FitSettings:
        """The settings of both fits."""
        return self.contact.pair.settings

    @property
    def noise_dof(self) -> float:
        """Degrees of freedom from which the errors' size was found; inf: it was given."""
        return self.contact.pair.striker.noise_dof

    @cached_property
    def p_tied(self) -> float:
        """p-value of the tied fit's chi^2."""
        return compute_p_value(self.tied.chi2, self.tied.dof, self.noise_dof)

    @cached_property
    def p_free(self) -> float:
        """p-value of the free fit's chi^2."""
        return compute_p_value(self.free.chi2, self.free.dof, self.noise_dof)

    @cached_property
    def p_agree(self) -> float:
        """p-value of what the tied fit's chi^2 has beyond the free one's."""
        return compute_p_of_rise(self.tied.chi2 - self.free.chi2, self.tied.dof - self.free.dof, self.noise_dof)

    @cached_property
    def p_motion(self) -> float:
        """p-value of the laws of sliding and rolling, beside others; NaN of a contact that lasts."""
        return np.nan if self.fits is not None else find_p_of_motion(self.free, self.noise_dof)

    @property
    def is_free_accepted(self) -> bool:
        """True if the data accept the free fit; they reject nothing if the size of the errors is unknown."""
        departs = any(map(self._rejects, self.free_departures.values()))
        return not (self.p_free < self.settings.rejection_level or departs)

    @property
    def is_tied_accepted(self) -> bool:
        """True if the data accept the tied fit, by itself and compared with the free one."""
        level = self.settings.rejection_level
        departs = any(map(self._rejects, self.tied_departures.values()))
        return self.is_free_accepted and not (self.p_tied < level or self.p_agree < level or departs)

    @property
    def rejected_law(self) -> Flag | None:
        """The law from which the tracks depart most, if they accept both fits otherwise or with this departure.

        Departures imitate each other in part, so that a large one may let the tracks reject another law too.
        """
        if self.is_tied_accepted:
            return None
        found = [*self.tied_departures.items(), *self.free_departures.items()]
        found = [(flag, one) for flag, one in found if one.is_shown]
        if not self._without_departures().is_tied_accepted:
            found = [(flag, one) for flag, one in self.tied_departures.items() if self.is_explained_by(one)]
        return max(found, key=lambda item: item[1].significance)[0] if found else None

    def is_explained_by(self, departure: LawDeparture) -> bool:
        """Test whether the data accept the tied fit with one departure as a further parameter.

        The free fit assumes the law too, so that the data may reject it.
        """
        least_p = 0.05  # small departures of other kinds, such as unequal friction or masses, leave less
        left = replace(self.tied, chi2=self.tied.chi2 - departure.significance**2, dof=self.tied.dof - 1)
        read = replace(self, tied=left)
        return min(read.p_tied, read.p_agree) > least_p

    def with_departures(self, tied: Mapping[Flag, LawDeparture], free: Mapping[Flag, LawDeparture]) -> CollisionFits:
        """Let the quantities of both fits carry possible departures from laws, as either fit shows them.

        The tied fit shows them better. Its departures count for the free fit too, where the data accept the tied fit
        otherwise. If they do not, other faults imitate a friction that changes, which is then left out.
        """
        is_accepted = self._without_departures().is_tied_accepted
        by_tied = [one for flag, one in tied.items() if is_accepted or flag is not Flag.FRICTION_CHANGES]
        by_free = {flag: one for flag, one in free.items() if one.is_shown or (is_accepted and flag in tied)}
        better = [tied.get(flag, one) for flag, one in by_free.items()] if is_accepted else None
        tied_values = average_over_departures(self.tied_values, by_tied)
        free_values = average_over_departures(self.free_values, list(by_free.values()), better)
        averaged = replace(self, tied_values=tied_values, free_values=free_values)
        return replace(averaged, tied_departures=tied, free_departures=free)

    def _without_departures(self) -> CollisionFits:
        return replace(self, tied_departures={}, free_departures={})

    def _rejects(self, departure: LawDeparture) -> bool:
        """Test whether the data reject the law from which this is a departure."""
        return departure.is_shown and self.noise_dof > 0 and departure.p_value < self.settings.rejection_level

    @cached_property
    def impossible_values(self) -> list[Flag]:
        """Quantities of the tied fit that two balls cannot have, its errors widened where it fits badly."""
        stretch = float(np.sqrt(max(1.0, self.tied.chi2 / self.tied.dof)))
        return find_impossible_values(self.tied_values, stretch, self.settings.impossible_sigma)

    @property
    def is_model_rejected(self) -> bool:
        """True if the data reject the tied fit, whatever its values.

        So does a contact that may last, or be one of smaller balls, and so do straight lines of unequal balls.
        """
        if self.lasting is not None and not self.lasting.is_certain:
            return True
        return not self.is_tied_accepted or (self.fits is not None and not self.fits.is_balanced)

    @property
    def is_misfit(self) -> bool:
        """True if the data reject the tied fit, or its values are physically impossible.

        Values count only where the size of the errors is known.
        """
        if self.is_model_rejected:
            return True
        return self.noise_dof > 0 and any(flag.is_impossible for flag in self.impossible_values)

    @property
    def is_convincing(self) -> bool:
        """True if the data accept both fits well, as they must if a parameter was added after a rejection."""
        return bool(min(self.p_tied, self.p_free, self.p_agree) > 1e-3)


def fit_collision(contact: Contact) -> CollisionFits | str:
    """Fit one collision by the tied and the free motion, or give the reason why there is no fit."""
    # a striker that does not roll must lower chi^2 per degree of freedom by this factor, if the data accept neither
    better_striker = 0.25
    guesses = guess_parameters(contact)
    if not guesses:
        return "the approach does not lead to the other ball"
    guess, *others = guesses
    first = fit_motion(contact.pair, True, [guess])
    read = _fit_with_noise(contact, [guess], first)
    if isinstance(read, str) or not read.is_tied_accepted:  # the descent may have ended in another minimum
        second = fit_motion(contact.pair, True, [*others, guess])
        if not _is_same_minimum(first, second):
            again = _fit_with_noise(contact, [*others, guess], second)
            read = min(read, again, key=_reduced_chi2)
    if not isinstance(read, str):
        # Friction that changes with the speed of slip explains the residuals without another striker. Unequal rolling
        # losses do not count here: a fit without the first positions of the striker then gives right values.
        slope = None if read.is_tied_accepted else find_slope_of_friction(read.tied)
        if read.is_tied_accepted or (slope is not None and read.is_explained_by(slope)):
            return read
    least = better_striker * _reduced_chi2(read)
    for other in list_alternative_strikers(contact, guess if isinstance(read, str) else read.tied.parameters):
        pair = other.contact.pair
        if pair.striker_slides and _is_too_bad(pair, *_bound_chi2_of_sliding(pair, other.starts[0]), least):
            continue
        rough = fit_motion(pair, True, other.starts, tolerance=ROUGH_TOLERANCE)
        per = rough.chi2 / max(rough.dof, 1)
        if _is_too_bad(pair, rough.chi2, rough.dof, least):
            continue
        found = _fit_with_noise(other.contact, [rough.parameters])
        if isinstance(found, str) or found.impossible_values or not is_believable_striker(found.tied, found.free):
            continue
        if found.is_convincing:
            return replace(found, flags=other.flags)
        if per < least:
            read, least = replace(found, flags=other.flags), better_striker * per
    return read


def _is_too_bad(pair: BallPair, chi2: float, dof: int, least: float) -> bool:
    """Decide whether a fit is rejected, and its chi^2 per degree of freedom is not below `least` either."""
    p = compute_p_value(chi2, dof, pair.striker.noise_dof)
    return chi2 / max(dof, 1) > least and p < pair.settings.rejection_level


def _bound_chi2_of_sliding(pair: BallPair, start: Array) -> tuple[float, int]:
    """A lower bound on chi^2 of a tied fit whose striker slides, and that fit's degrees of freedom.

    It is the least chi^2 of the free motion, of which the tied motions are a part. From a bad start, a descent of the
    tied motion takes long and ends far above it.
    """
    free = fit_motion(pair, False, [np.asarray(tied_to_free(start, pair.spin), dtype=np.float64)], ROUGH_TOLERANCE)
    return free.chi2, free.dof + len(FREE) - len(TIED)


@dataclass(frozen=True)
class HiddenSlide:
    """A contact that lasts as long as the balls may slide, from frame `first` to `last`: it hides how they part."""

    first: int
    last: int


def fit_lasting_collision(
    candidate: ContactCandidate,
    diameter: float,
    earlier: Mapping[int, EarlierHit],
    settings: FitSettings,
    least_sigma: float = MIN_SIGNIFICANCE,
) -> CollisionFits | HiddenSlide | str | None:
    """Fit one collision that lasts, or that balls leave in straight lines, as `fit_lasting_contact` does.

    Quantities that are measured once both balls roll are unseen if the tracks do not show the ends of the slides. All
    that the slides determine is unseen if the balls move in straight lines.
    """
    fits = fit_lasting_contact(candidate, diameter, earlier, settings, least_sigma)
    if fits is None or isinstance(fits, str):
        return fits
    if fits.hides_slide:
        return SHORT_SLIDE if fits.contact is None else HiddenSlide(fits.contact.first, fits.contact.last)
    tied, free = as_collision_fits(fits)
    is_straight = fits.free is fits.tied
    unseen = set(AFTER_SLIDES if is_straight else ())
    for ball, seen in enumerate(fits.slide_ends_seen, 1):
        if not seen:
            unseen |= name_quantities_of_slide(ball)
    # the laws that tie v0 and b hold less exactly while a contact lasts
    tied_values, free_values = fits.tied.values, fits.free.values
    value, cov = tied_values.value.copy(), tied_values.cov.copy()
    for k in (QUANTITY_NAMES.index("v0"), QUANTITY_NAMES.index("b")):
        value[k], cov[k], cov[:, k] = free_values.value[k], 0.0, 0.0
        cov[k, k] = free_values.cov[k, k]
    flag = Flag.STRAIGHT
    if fits.contact is not None:
        flag = Flag.LASTS if fits.contact.is_certain else Flag.LASTS_OR_SMALLER
    return CollisionFits(
        contact=Contact(fits.pair, candidate.frame),
        tied=tied,
        free=free,
        slide_ends_seen=fits.slide_ends_seen,
        tied_values=replace(tied_values, value=value, cov=cov),
        free_values=free_values,
        flags=(flag,),
        unseen=frozenset(unseen),
        fits=fits,
    )


def _reduced_chi2(read: CollisionFits | str) -> float:
    return np.inf if isinstance(read, str) else read.tied.chi2 / read.tied.dof


def _is_same_minimum(one: CollisionFit, other: CollisionFit) -> bool:
    """Test whether two fits of the same positions ended in one minimum, within what ends a descent."""
    is_alike = abs(one.chi2 - other.chi2) <= 1e-6 * one.chi2 and one.dropped == other.dropped
    errors = np.sqrt(np.diag(one.cov) * max(1.0, one.chi2 / max(one.dof, 1)))
    return is_alike and bool((abs(one.parameters - other.parameters) <= 0.01 * errors).all())


def _fit_with_noise(contact: Contact, starts: list[Array], tied: CollisionFit | None = None) -> CollisionFits | str:
    """Both fits, by errors as the tracks show them, in size and correlation; tied: that from the starts, if known."""
    read = _fit_both(contact, starts, tied)
    pair = None if isinstance(read, str) else with_correlated_noise(contact.pair, read.free)
    if pair is None or isinstance(read, str):
        return read
    return _fit_both(replace(contact, pair=pair), [*starts, read.tied.parameters])


def _fit_both(contact: Contact, starts: list[Array], tied: CollisionFit | None = None) -> CollisionFits | str:
    """Tied and free fit by the errors that the positions have."""
    pair = contact.pair
    tied = tied or fit_motion(pair, True, starts)
    free, seen = _fit_free(pair, tied)
    if tied.chi2 > free.chi2 + 50:  # the free fit has no impact to get wrong: start at its launch, r, mu_k and C
        r, mu, c = (derive_quantities(free).value[QUANTITY_NAMES.index(name)] for name in ("r", "mu_k", "C"))
        start, launch, target = tied.parameters.copy(), slice(8), slice(-len(TARGET), None)
        start[launch], start[target] = free.parameters[launch], free.parameters[target]
        start[8:11] = np.clip(r, 0, 1), np.log(np.clip(mu, 1e-3, 10)), np.clip(c, -0.5, 1)
        again = fit_motion(pair, True, [start])
        if again.chi2 < tied.chi2:
            tied = again
            free, seen = _fit_free(pair, tied)
    tied = _prefer_possible(pair, tied)
    if tied.dropped or free.dropped:  # fit both to the same positions, less the outliers of the fit that has fewer
        fewer = min(tied, free, key=lambda fit: fit.dropped)
        if fewer is tied:
            free, seen = _fit_free(fewer.pair, tied, whole=True)
        else:
            tied = fit_motion(fewer.pair, True, [tied.parameters], whole=True)
        tied, free = (replace(fit, dropped=fewer.dropped) for fit in (tied, free))
    read = CollisionFits(contact, tied, free, seen, derive_quantities(tied), derive_quantities(free))
    if free.chi2 > 1e4 * free.dof:  # 100 sigma off everywhere: this is another motion
        return "no collision of two rolling balls fits the tracks"
    return read if tied.converged or not read.is_tied_accepted else "the fit did not converge"


def _prefer_possible(pair: BallPair, tied: CollisionFit) -> CollisionFit:
    """Prefer a tied fit with possible values by which the balls slide until they are last seen.

    Balls that move on in a straight line after the hit either slid for a very short time or never roll. The positions
    do not decide, but the first may need an impossible restitution.
    """
    worse = 10.0  # chi^2 by which the other fit may be worse

    def is_possible(fit: CollisionFit) -> bool:
        return not find_impossible_values(derive_quantities(fit), 1.0, pair.settings.impossible_sigma)

    if is_possible(tied):
        return tied
    start = tied.parameters.copy()
    for r in (0.9, 0.5):
        start[[TIED.index(name) for name in ("r", "log_mu", "C")]] = r, np.log(1e-3), 0.0
        rough = fit_motion(pair, True, [start], ROUGH_TOLERANCE)
        if rough.chi2 > (1 + 10 * ROUGH_TOLERANCE) * (tied.chi2 + worse):
            continue
        other = fit_motion(pair, True, [rough.parameters])
        if other.dropped <= tied.dropped and other.chi2 < tied.chi2 + worse and is_possible(other):
            return other
    return tied


def _fit_free(pair: BallPair, tied: CollisionFit, whole: bool = False) -> tuple[CollisionFit, tuple[bool, bool]]:
    """The free fit, and for each ball whether the tracks show the end of its slide.

    Short slides have several minima, so other slide times are tried, unless the tracks accept those of the tied fit. A
    slide without end is the null hypothesis.
    """
    start = np.asarray(tied_to_free(tied.parameters, pair.spin), dtype=np.float64)
    ends = [FREE.index(name) for name in ("log_tau1", "log_tau2")]
    best = fit_motion(pair, False, [start], whole=whole)
    if not _is_accepted(tied, best):
        shift = 0.5 * np.isin(np.arange(len(FREE)), ends)
        best = fit_motion(pair, False, [best.parameters, start - shift, start + shift], whole=whole)
    seen = [True, True]
    for i, (end, (_, track)) in enumerate(zip(ends, pair.balls, strict=True)):
        left = track.start[-1] + track.exposure - best.parameters[0]
        if np.exp(best.parameters[end]) > left:
            seen[i] = False
        elif np.exp(best.parameters[end]) > 0.5 * left:
            endless = _without_slide_end(best.parameters, 1 + i, left)
            without = fit_motion(pair, False, [endless], ROUGH_TOLERANCE, whole)
            if without.chi2 < best.chi2:
                best = without = fit_motion(pair, False, [without.parameters], whole=whole)
            ends_in_view = bool(np.exp(best.parameters[end]) < left)
            seen[i] = ends_in_view and without.chi2 - best.chi2 > pair.settings.slide_end_chi2
    return best, (seen[0], seen[1])


def _is_accepted(tied: CollisionFit, free: CollisionFit) -> bool:
    """Decide whether the tracks accept a tied fit, by itself and beside a free one of the same positions."""
    least_p, noise_dof = 0.01, tied.pair.striker.noise_dof
    by_itself = compute_p_value(tied.chi2, tied.dof, noise_dof)
    rise = compute_p_of_rise(tied.chi2 - free.chi2, tied.dof - free.dof, noise_dof)  # NaN without a known noise
    return tied.dropped == free.dropped and by_itself > least_p and rise > least_p


def _without_slide_end(free: Array, ball: int, left: float) -> Array:
    """The same start of a slide, but one that continues after the ball is last seen."""
    out, at = free.copy(), AFTER[ball]
    tau, longer = np.exp(free[at + 4]), 1.5 * left
    out[at + 2 : at + 4] = free[at : at + 2] + (free[at + 2 : at + 4] - free[at : at + 2]) * longer / tau
    out[at + 4] = np.log(longer)
    return out
