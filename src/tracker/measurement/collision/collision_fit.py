"""Tied and free fit of one collision, side by side: from every start that may lead to the best, by true errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tracker.measurement.collision.adequacy import LEVEL, agreement, p_value, questioned
from tracker.measurement.collision.collision_model import AFTER, FREE, SPIN, TARGET, TIED, release
from tracker.measurement.collision.contacts import Encounter, first_guesses
from tracker.measurement.collision.derived import NAMES, Values, of_free, of_tied
from tracker.measurement.collision.fitting import COARSE, Fit, Pair, fit_motion
from tracker.measurement.collision.noise_correlation import lasting
from tracker.measurement.collision.striker import CONVINCING, believable, strikers

Floats = NDArray[np.float64]

SEEN = 25.0  # chi^2 by which the end of a slide must beat a slide without end: five standard errors
POOR_FIT = 1e4  # chi^2 per degree of freedom: 100 sigma off everywhere is no description of the motion
ENDLESS = (0.9, 0.5)  # restitutions from which a fit of balls that slide on all the while starts
AS_GOOD = 10.0  # chi^2 by which a motion that is possible may fit worse than one that is not
WORTH_A_SPIN = 0.25  # of chi^2 per degree of freedom, under which a striker that does not roll describes tracks better


@dataclass(frozen=True)
class Reading:
    """Both fits of one collision and what they say."""

    meeting: Encounter
    tied: Fit
    free: Fit
    slides_seen: tuple[bool, bool]
    of_tied: Values
    of_free: Values
    flags: tuple[str, ...] = ()

    @property
    def known(self) -> float:
        """Degrees of freedom from which the errors' size was found; inf: it was given."""
        return self.meeting.pair.striker.known

    @cached_property
    def adequate(self) -> float:
        """p-value of the tied fit's chi^2."""
        return p_value(self.tied.chi2, self.tied.dof, self.known)

    @cached_property
    def adequate_free(self) -> float:
        """p-value of the free fit's chi^2."""
        return p_value(self.free.chi2, self.free.dof, self.known)

    @cached_property
    def agree(self) -> float:
        """p-value of what the tied fit's chi^2 has beyond the free one's."""
        return agreement(self.tied, self.free, self.known)

    @property
    def accepted(self) -> tuple[bool, bool]:
        """Whether the data accept tied and free fit; nothing is rejected where the errors' size is not known."""
        free = not self.adequate_free < LEVEL
        return free and not (self.adequate < LEVEL or self.agree < LEVEL), free

    @property
    def possible(self) -> bool:
        """Whether two balls can do what the tied fit says."""
        return not questioned(self.of_tied, float(np.sqrt(max(1.0, self.tied.chi2 / self.tied.dof))))

    @property
    def convincing(self) -> bool:
        """Whether the data accept both fits well, as they must where a freedom was added after a rejection."""
        return bool(min(self.adequate, self.adequate_free, self.agree) > CONVINCING)


def interpret(meeting: Encounter) -> Reading | str:
    """Tied and free fit of one collision; or the reason why there is none."""
    guesses = first_guesses(meeting)
    if not guesses:
        return "the approach does not lead to the other ball"
    guess, *others = guesses
    read = _read(meeting, [guess])
    if not _accepted(read):  # it may have gone astray
        again = _read(meeting, [*others, guess])
        read = min(read, again, key=_poor)
    if _accepted(read):
        return read
    least = np.inf if isinstance(read, str) else WORTH_A_SPIN * read.tied.chi2 / read.tied.dof
    for other in strikers(meeting, guess if isinstance(read, str) else read.tied.parameters):
        rough = fit_motion(other.meeting.pair, True, other.starts, COARSE)
        per = rough.chi2 / max(rough.dof, 1)
        if per > least and p_value(rough.chi2, rough.dof, other.meeting.pair.striker.known) < LEVEL:
            continue
        found = _read(other.meeting, [rough.parameters])
        if isinstance(found, str) or not (found.possible and believable(found.tied, found.free)):
            continue
        if found.convincing:
            return replace(found, flags=other.flags)
        if per < least:
            read, least = replace(found, flags=other.flags), WORTH_A_SPIN * per
    return read


def _accepted(read: Reading | str) -> bool:
    return isinstance(read, Reading) and read.accepted[0]


def _poor(read: Reading | str) -> float:
    return np.inf if isinstance(read, str) else read.tied.chi2 / read.tied.dof


def _read(meeting: Encounter, starts: list[Floats]) -> Reading | str:
    """Both fits, by errors as large and as lasting as the tracks show."""
    read = _fitted(meeting, starts)
    pair = None if isinstance(read, str) else lasting(meeting.pair, read.free)
    if pair is None or isinstance(read, str):
        return read
    return _fitted(replace(meeting, pair=pair), [*starts, read.tied.parameters])


def _fitted(meeting: Encounter, starts: list[Floats]) -> Reading | str:
    """Tied and free fit by the errors that the positions have."""
    pair = meeting.pair
    tied = fit_motion(pair, True, starts)
    free, seen = _free(pair, tied)
    if tied.chi2 > free.chi2 + 50:  # the free fit has no impact to get wrong: let it lead
        again = fit_motion(pair, True, [_tied_from(free, tied, pair.diameter)])
        if again.chi2 < tied.chi2:
            tied = again
            free, seen = _free(pair, tied)
    tied = _possible(pair, tied)
    if tied.dropped or free.dropped:
        tied, free, seen = _on_the_same(tied, free, seen)
    read = Reading(
        meeting, tied, free, seen,
        of_tied(tied.parameters, tied.cov, pair.diameter, pair.spin), of_free(free.parameters, free.cov, pair.diameter),
    )  # fmt: skip
    if free.chi2 > POOR_FIT * free.dof:
        return "no collision of two rolling balls fits the tracks"
    return read if tied.converged or not read.accepted[0] else "the fit did not converge"


def _on_the_same(tied: Fit, free: Fit, seen: tuple[bool, bool]) -> tuple[Fit, Fit, tuple[bool, bool]]:
    """Fit both to the same positions, less the outliers of the fit that has fewer; with the slide ends seen."""
    fewer = min(tied, free, key=lambda fit: fit.dropped)
    if fewer is tied:
        free, seen = _free(fewer.pair, tied, whole=True)
    else:
        tied = fit_motion(fewer.pair, True, [tied.parameters], whole=True)
    return replace(tied, dropped=fewer.dropped), replace(free, dropped=fewer.dropped), seen


def _possible(pair: Pair, tied: Fit) -> Fit:
    """The tied fit, or one as good by which the balls slide on all the while.

    Balls that go straight on after the hit either did all their sliding at once or never roll: the positions do not
    decide, but the first may take a restitution that cannot be.
    """
    if not questioned(of_tied(tied.parameters, tied.cov, pair.diameter, pair.spin), 1.0):
        return tied
    start = tied.parameters.copy()
    for r in ENDLESS:
        start[[TIED.index(name) for name in ("r", "log_mu", "C")]] = r, np.log(1e-3), 0.0
        other = fit_motion(pair, True, [start])
        values = of_tied(other.parameters, other.cov, pair.diameter, pair.spin)
        if other.dropped <= tied.dropped and other.chi2 < tied.chi2 + AS_GOOD and not questioned(values, 1.0):
            return other
    return tied


def _free(pair: Pair, tied: Fit, whole: bool = False) -> tuple[Fit, tuple[bool, bool]]:
    """The free fit, and for each ball whether its slide's end shows.

    Short slides have several minima: other slide times are tried. One without end is the null hypothesis.
    """
    start = np.asarray(release(tied.parameters, pair.spin), dtype=np.float64)
    ends = [FREE.index(name) for name in ("log_tau1", "log_tau2")]
    starts = [start]
    for shift in (-0.5, 0.5):
        other = start.copy()
        other[ends] += shift
        starts.append(other)
    best = fit_motion(pair, False, starts, whole=whole)
    seen = [True, True]
    for i, (end, (_, course)) in enumerate(zip(ends, pair.balls, strict=True)):
        left = course.start[-1] + course.exposure - best.parameters[0]
        if np.exp(best.parameters[end]) > left:
            seen[i] = False
        elif np.exp(best.parameters[end]) > 0.5 * left:
            endless = _endless(best.parameters, 1 + i, left)
            without = fit_motion(pair, False, [endless], COARSE, whole)
            if without.chi2 < best.chi2:
                best = without = fit_motion(pair, False, [without.parameters], whole=whole)
            seen[i] = without.chi2 - best.chi2 > SEEN and bool(np.exp(best.parameters[end]) < left)
    return best, (seen[0], seen[1])


def _endless(free: Floats, ball: int, left: float) -> Floats:
    """The same start of a slide, but one that goes on after the ball is last seen."""
    out, at = free.copy(), AFTER[ball]
    tau, longer = np.exp(free[at + 4]), 1.5 * left
    out[at + 2 : at + 4] = free[at : at + 2] + (free[at + 2 : at + 4] - free[at : at + 2]) * longer / tau
    out[at + 4] = np.log(longer)
    return out


def _tied_from(free: Fit, tied: Fit, diameter: float) -> Floats:
    """Tied parameters nearest to a free motion: its launch, the r, mu_k and C it implies, the spin of another fit."""
    said = dict(zip(NAMES, of_free(free.parameters, free.cov, diameter).value, strict=True))
    impact = [np.clip(said["r"], 0, 1), np.log(np.clip(said["mu_k"], 1e-3, 10)), np.clip(said["C"], -0.5, 1)]
    spin = tied.parameters[TIED.index(SPIN[0]) : -len(TARGET)]
    return np.concatenate([free.parameters[:8], impact, spin, free.parameters[-len(TARGET) :]])
