"""Put the results of a search into sentences: claims, rejections, disagreements, the gap and the noise."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from discrepancy.fitting.parameters import find_parameter
from discrepancy.noise.model import Noise
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.validate.claim_tests import ClaimTest, Rejection
from discrepancy.validate.gap import Gap
from discrepancy.validate.residual_map import Disagreement
from synthcam.library import library
from synthcam.model import Model

NO_EFFECT_NAMED_WHEN_SMOOTHED = "The search names no effect for smoothed tracks"


def format_with_error(value: float, std: float, digits: int) -> str:
    """A value as text, to the decimal place of the last of `digits` digits of its error; without one, three digits."""
    if not (math.isfinite(std) and std > 0 and value):
        return f"{value:.3g}"
    places = digits - 1 - math.floor(math.log10(float(f"{std:.{digits - 1}e}")))
    figures = max(places + math.floor(math.log10(abs(value))) + 1, 1)
    if abs(value) < 1e-4:
        return f"{value:.{figures - 1}e}"
    return f"{value:.{places}f}" if places > 0 else f"{value:.{figures}g}"


def describe_effect(name: str) -> str:
    """An effect with the first sentence of its file: "plate_tilt (a plate that is not level)"."""
    kind = library().get(name)  # None: a base parameter
    module = sys.modules.get(kind.__module__) if kind else None
    about = (module.__doc__ or "" if module else "").partition("\n")[0].rstrip(".")
    return f"{name} ({about[:1].lower()}{about[1:]})" if about else name


def describe_claim(claim: EffectClaim, base: Model) -> str:
    """An effect with its values, errors and significances.

    The joint significance stands last. Of several strengths each has its own, its distance from zero in standard
    errors, so that "(1 sigma)" after an error is not read as the width of an interval.
    """
    rivals = f" or {' or '.join(claim.aliases[1:])}" if len(claim.aliases) > 1 else ""
    joint = f"{claim.sigma:.0f} sigma"
    is_correction, several = claim.is_in(base), len(claim.values) > 1
    parts = []
    for name, value in claim.values.items():
        at_limit = claim.at_limit(name)
        number = format_with_error(value, 0.0 if at_limit else claim.std[name], 1)
        number = number if number.startswith("-") or is_correction else f"+{number}"
        known = math.isfinite(claim.std[name]) and not at_limit
        error = f"+- {claim.std[name]:.1g}" if known else "at its limit" if at_limit else "without an error"
        own = f" ({_describe_distance(abs(value) / claim.std[name])})" if several and known and claim.std[name] else ""
        what = f"{name} is {number}, not {base.value(name):.3g}," if is_correction else f"{_last(name)} {number}"
        parts.append(f"{what} {error}{_unit(name)}{own}")
    for name, value in claim.shapes.items():
        std = claim.shape_std[name]
        if math.isfinite(std):
            parts.append(f"{_last(name)} {format_with_error(value, std, 1)} +- {std:.1g}{_unit(name)}")
        else:
            parts.append(f"{_last(name)} undetermined")
    joint = f"; jointly {joint}" if several else f" ({joint})"
    if is_correction:
        return f"{', '.join(parts)}{joint}{rivals and ','}{rivals}"
    return f"{describe_effect(claim.effect)}{rivals}, {', '.join(parts)}{joint}"


def describe_rejection(test: ClaimTest) -> str:
    """Why a claim is rejected, with the numbers that decided it; empty for a claim that passes."""
    if test.rejection is None:
        return ""
    if test.rejection is Rejection.SCATTERS:
        return (
            "much more is missing, and it scatters from collision to collision: "
            f"{test.leave_one_out.sigma:.3g} sigma are left"
        )
    if test.rejection is Rejection.EXPLAINS_LITTLE:
        without, with_ = test.held_out.gap
        return (
            f"much more is missing: held-out collisions have chi^2 per point {with_:.3g} with it, {without:.3g} without"
        )
    if test.rejection is Rejection.SHAPE_AT_LIMIT and test.shape_at_limit:
        name, value = test.shape_at_limit
        return f"its {_last(name)} is at {value:.3g}, the end of its allowed range"
    if test.rejection is Rejection.VARIES and test.variation:
        return f"its strength changes with the {test.variation.against} ({test.variation.sigma:.0f} sigma)"
    return {
        Rejection.NOT_SIGNIFICANT: "not significant beside everything else",
        Rejection.REPLACED: "another effect that fits as well passes the tests",
        Rejection.ABSORBED: "everything else explains as much without it",
        Rejection.HELD_OUT_WORSE: "it predicts held-out collisions worse",
        Rejection.LEFT_OUT_WORSE: "it predicts collisions worse, each left out once",
        Rejection.LEFT_OUT_NOT_SIGNIFICANT: "collisions, each left out once, do not support it beyond chance",
    }[test.rejection]


def describe_rejections(tests: Sequence[ClaimTest]) -> str:
    """A sentence that lists rejected claims; empty without any."""
    return f" Rejected: {'; '.join(f'{t.name} ({describe_rejection(t)})' for t in tests)}." if tests else ""


def describe_disagreement(disagreement: Disagreement) -> str:
    """Where a disagreement lies: "ball 1 sliding, along its motion, changing with the speed"."""
    phase = {"before": "before the contact", "contact": "at the contact"}.get(disagreement.phase, disagreement.phase)
    changing = f", changing with the {disagreement.against}" if disagreement.against else ""
    return f"{disagreement.ball} {phase}, {disagreement.observable} its motion{changing}"


def describe_gap(gap: Gap) -> str:
    """How the gap on held-out collisions changes."""
    before, after = f"{gap.before:.3g}", f"{gap.after:.3g}"
    if before == after:
        moved = f"stays at {before}"
    else:
        moved = f"{'falls' if gap.after < gap.before else 'does not fall but rises'} from {before} to {after}"
    return f"On held-out collisions chi^2 per point {moved}; noise alone leaves {gap.floor:.3g}."


def describe_slow_noise(noise: Noise) -> str:
    """A sentence if much of what is taken for noise is slow, so that it may hide missing physics; else empty."""
    if noise.whole_phase_scale:
        return (
            f" The noise is {noise.scale:.3g} times the claimed errors within "
            f"{current_policy().min_short_stretch_positions} positions. Over whole phases of motion it would be "
            f"{noise.whole_phase_scale:.3g} times; that is missing physics."
        )
    if not noise.is_slow:
        return ""
    return (
        f" The noise is {noise.scale:.3g} times the claimed errors; {noise.innovation_scale:.3g} times are new from "
        "frame to frame. The slow rest may be missing physics."
    )


def _describe_distance(errors: float, significant: float = 3.0) -> str:
    """How far a strength is from zero; significant: below so many standard errors the number would mislead."""
    return f"{errors:.0f} standard errors from zero" if errors >= significant else "not significant"


def _last(name: str) -> str:
    return name.rpartition(".")[2]


def _unit(name: str) -> str:
    unit = find_parameter(Model(), name).unit
    return "" if unit in ("", "1") else f" {unit}"
