"""Describe the result of a search in sentences: verdict, claims, rejections, disagreements, gap and noise."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence

import numpy as np

from discrepancy.data.collisions import EvidenceUnit
from discrepancy.data.launch import V0, WITH_SPIN, B
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.fitting.gauss_newton import solve_step
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.parameters import BASE_PARAMETERS, find_parameter
from discrepancy.fitting.stretch_moves import StretchScatter
from discrepancy.noise.model import Noise
from discrepancy.outcome import SearchOutcome, Verdict
from discrepancy.policy import applied_policy, current_policy
from discrepancy.select.contact_effects import ContactClaim, ContactNumber
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.impact_laws import SPIN_NUMBER
from discrepancy.select.library_search import InterruptedSearch
from discrepancy.validate.claim_tests import ClaimTest, Rejection
from discrepancy.validate.gap import Gap
from discrepancy.validate.residual_map import Disagreement, is_unexplained
from synthcam.library import library
from synthcam.model import Model
from synthcam_shared.report.numbers import format_number, round_to_error

VERDICT_MEANINGS = {
    Verdict.NONE: "no effect passes the tests, and no disagreement of model and data is significant",
    Verdict.NAMED: "the model lacks one or more effects of the library, and each is distinguished from all others",
    Verdict.AMBIGUOUS: "the model lacks an effect, which these data do not distinguish from others",
    Verdict.OUTSIDE_LIBRARY: "the model lacks something that no effect of the library makes",
    Verdict.INADEQUATE: "something is missing, and no candidate passes all tests",
}
BASE_MEANINGS = {
    "restitution": "relative normal speed of the balls after the impact over that before it",
    "sliding_friction": "coefficient of friction between ball and plate",
    "spin_transfer": "share of the striker's rolling spin that the struck ball gets, in the opposite sense",
    "rolling_drag": "part of the rolling loss that is proportional to the speed",
    "rolling_decel": "constant part of the rolling loss",
}


def describe_search(found: SearchOutcome) -> str:
    """Describe the outcome of a search in a few sentences, the most important first.

    Parameters
    ----------
    found : SearchOutcome
        For example a `SearchResult`.

    Returns
    -------
    str
    """
    main = _describe_free_motion(found)
    return " ".join(
        [main, *describe_stretch_scatter(found.data.scatter), *describe_contacts(found.contacts, found.base_fit.model)]
    )


def describe_verdict(found: SearchOutcome) -> str:
    """Describe the verdict, which with stretches is about the motion between contacts, and what the contacts show."""
    if not found.data.is_cut:
        return str(found.verdict)
    shown = [
        f"{' or '.join((c.law, *c.rivals))} ({' or '.join(c.causes)}, {c.sigma:.1f} sigma)"
        for c in found.contacts
        if c.causes
    ]
    return f"{found.verdict} between contacts" + (f"; contacts show: {'; '.join(shown)}" if shown else "")


def _describe_free_motion(found: SearchOutcome) -> str:
    unit = found.data.unit
    with applied_policy(found.policy):
        slow = describe_slow_noise(found.data.noise) if found.data.scatter.is_none else ""
    failed = "; ".join(f"{t.name} ({describe_rejection(t, unit)})" for t in found.rejected)
    rejected, remaining, worst = f" Rejected: {failed}." if failed else "", found.disagreements, ""
    if is_unexplained(remaining, found.policy):
        worst = f"{describe_disagreement(remaining[0], found.base_fit.model)} ({remaining[0].sigma:.0f} sigma)"
    if found.interrupted:
        return describe_interruption(found.interrupted, found.base_fit, unit)
    unnamed = "The search names no effect for smoothed tracks"
    if found.data.is_smoothed:
        largest = "" if found.verdict is Verdict.NONE else f" The largest disagreement: {worst}."
        return f"{unnamed}: {SearchNote(SearchNoteKind.SMOOTHED)}.{largest}{slow}"
    if found.verdict is Verdict.NONE:
        within = "the noise" if found.data.scatter.is_none else "the noise and the scatter from stretch to stretch"
        where = " between contacts" if found.data.is_cut else ""
        return f"Nothing is missing{where}: model and measurement agree to within {within}.{rejected}{slow}"
    if found.verdict is Verdict.INADEQUATE:
        largest = f" The largest disagreement: {worst}." if worst else ""
        return f"Something is missing, and no candidate passes all tests.{largest}{rejected}{slow}"
    base, law = found.base_fit.model, found.law_summary
    missing = [describe_claim(c, base) for c in found.claims if not c.is_in(base)]
    wrong = [describe_claim(c, base) for c in found.claims if c.is_in(base)]
    parts = [part for part in [describe_small_closure(found.gap, unit)] if part]
    if found.free_law and law:
        parts.append(
            f"Missing law: {law.description}, which no effect of the library makes ({found.free_law.sigma:.0f} sigma)."
        )
    parts += [f"Missing effect: {words}." for words in missing] + [f"Wrong value: {words}." for words in wrong]
    if found.free_law and law:
        where = f"model.yaml {'holds its curve' if found.model_holds_law else 'cannot hold it'}"
        if found.free_law.law.frees:
            where = f"model.yaml leaves {found.free_law.law.frees} free"
        parts.append(f"Proposed formula: {law.formula}. {where}.")
    elif found.verdict is Verdict.OUTSIDE_LIBRARY:
        where = f": {worst}" if worst else ""
        parts.append(f"Something else is missing that no effect of the library and no free law explains{where}.")
    parts += filter(None, [describe_error_source(found), describe_gap(found.gap, unit)])
    return " ".join(parts) + rejected + slow


def describe_error_source(found: SearchOutcome) -> str:
    """Describe where the errors of claims come from; empty if they come from noise or are absent."""
    by_scatter = found.data.is_cut or not found.is_complete
    if not by_scatter or not any(math.isfinite(std) for c in found.claims for std in c.std.values()):
        return ""
    return "Errors follow from the scatter of the stretches; they lack a cause that changes all stretches equally."


def describe_interruption(interrupted: InterruptedSearch, base: ModelFit, unit: EvidenceUnit) -> str:
    """Describe how far a search came before its time was over, and what that means for its gap."""
    start = (
        f"The search stopped early, after {interrupted.seconds / 60:.3g} minutes, and names nothing: its gap is that "
        f"of the base model, and a finished search may give another. On the fitted {unit} the base model has chi^2 per "
        f"point {base.chi2 / base.points:.3g}"
    )
    if not interrupted.effects:
        return f"{start}; no model tried so far has less."
    effects = ", ".join(interrupted.effects)
    return f"{start}, with {effects} {interrupted.chi2:.3g}; that was not tested on held-out {unit}."


def describe_effect(name: str) -> str:
    """Describe an effect by the first sentence of its file: "plate_tilt (a plate that is not level)"."""
    kind = library().get(name)  # None: a base parameter
    module = sys.modules.get(kind.__module__) if kind else None
    about = (module.__doc__ or "" if module else "").partition("\n")[0].rstrip(".")
    return f"{name} ({about[:1].lower()}{about[1:]})" if about else name


def describe_claim(claim: EffectClaim, base: Model) -> str:
    """Describe an effect with its values, errors and significances.

    The joint significance comes last. Each of several strengths also gets its own, as a distance from zero in standard
    errors. A reader could take "(1 sigma)" after an error for the width of an interval.
    """
    rivals = f" or {' or '.join(claim.aliases[1:])}" if len(claim.aliases) > 1 else ""
    joint, several = f"{claim.sigma:.0f} sigma", len(claim.values) > 1
    joint = f"; jointly {joint}" if several else f" ({joint})"
    if claim.is_in(base):
        parts = [_describe_correction(claim, name, base) for name in claim.values]
        parts += [_describe_shape(claim, name) for name in claim.shapes]
        return f"{', '.join(parts)}{joint}{rivals and ','}{rivals}"
    parts = [_describe_strength(claim, name) for name in claim.values]
    parts += [_describe_shape(claim, name) for name in claim.shapes]
    return f"{describe_effect(claim.effect)}{rivals}: {_join(parts)}{joint}"


def _join(parts: Sequence[str]) -> str:
    """Join parts of a sentence; one that begins with the same words as the part before leaves them out."""
    words = [re.split(r"(?<= )[-+]?\d", part, maxsplit=1)[0] for part in parts]
    text = parts[0]
    for before, now, part in zip(words, words[1:], parts[1:], strict=False):
        text += f" and {part.removeprefix(now)}" if now and now == before else f", {part}"
    return text


def _describe_strength(claim: EffectClaim, name: str) -> str:
    """Describe a strength: in the words of its effect if it is significant, else as a number with its sign."""
    value, std, at_limit = claim.values[name], claim.std[name], claim.at_limit(name)
    is_known = math.isfinite(std) and std > 0 and not at_limit
    size = _describe_size(name, value, std if is_known else math.nan)
    meaning = find_parameter(Model(), name).meaning[value < 0]
    if is_known and not _is_significant(abs(value) / std):
        meaning = ""
    if "{}" in meaning:
        text = meaning.format(size.removeprefix("-"))
    else:
        text = f"{meaning}{meaning and ', '}{_last(name)} {size if value < 0 else f'+{size}'}"
    if not is_known:
        return f"{text}{',' if '{}' in meaning else ''} {'at its limit' if at_limit else 'without an error'}"
    return f"{text} ({_describe_distance(abs(value) / std)})" if len(claim.values) > 1 else text


def _describe_correction(claim: EffectClaim, name: str, base: Model) -> str:
    """Describe the value of a strength that the base model has with another value."""
    value, std, at_limit = claim.values[name], claim.std[name], claim.at_limit(name)
    number = round_to_error(value, 0.0 if at_limit else std, 1)
    is_known = math.isfinite(std) and not at_limit
    error = f"+- {std:.1g}" if is_known else "at its limit" if at_limit else "without an error"
    own = f" ({_describe_distance(abs(value) / std)})" if len(claim.values) > 1 and is_known and std else ""
    return f"{name} is {number}, not {base.value(name):.3g}, {error}{_unit(name)}{own}"


def _describe_shape(claim: EffectClaim, name: str) -> str:
    std = claim.shape_std[name]
    if not math.isfinite(std):
        return f"{_last(name)} undetermined"
    return f"{_last(name)} {_describe_size(name, claim.shapes[name], std)}"


def _describe_size(name: str, value: float, std: float) -> str:
    """Write a value with its error, if it has one, and its unit with a prefix: "1.0004 +- 0.0007 mrad"."""
    unit, factor, error = _unit(name), 1.0, std if math.isfinite(std) else 0.0
    if unit in (" m", " s", " rad"):
        prefixes = ((1.0, ""), (1e-3, "m"), (1e-6, "u"))
        factor, prefix = next((x for x in prefixes if 2 * max(abs(value), error) > x[0]), prefixes[-1])
        unit = f" {prefix}{unit[1:]}"
    number = round_to_error(value / factor, error / factor, 1)
    return f"{number} +- {error / factor:.1g}{unit}" if error else f"{number}{unit}"


def describe_rejection(test: ClaimTest, unit: EvidenceUnit = EvidenceUnit.COLLISION) -> str:
    """Describe why a claim is rejected, with the numbers that decided it; empty for a claim that passes.

    Parameters
    ----------
    test : ClaimTest
    unit : EvidenceUnit

    Returns
    -------
    str
    """
    if test.rejection is None:
        return ""
    if test.rejection is Rejection.SCATTERS:
        return (
            f"much more is missing, and it scatters from {unit.one} to {unit.one}: "
            f"{test.leave_one_out.sigma:.3g} sigma are left"
        )
    if test.rejection is Rejection.EXPLAINS_LITTLE:
        without, with_ = test.held_out.gap
        return f"much more is missing: held-out {unit} have chi^2 per point {with_:.3g} with it, {without:.3g} without"
    if test.rejection is Rejection.SHAPE_AT_LIMIT and test.shape_at_limit:
        name, value = test.shape_at_limit
        return f"its {_last(name)} is at {value:.3g}, the end of its allowed range"
    if test.rejection is Rejection.VARIES and test.variation:
        return f"its strength changes with the {test.variation.against} ({test.variation.sigma:.0f} sigma)"
    if test.rejection is Rejection.AGREES_WITH_ZERO:
        return (
            f"uncertain: the {unit} disagree by more than their errors, and by their scatter its size is only "
            f"{test.from_zero:.2g} sigma from zero"
        )
    return {
        Rejection.SIZE_UNKNOWN: "uncertain: its size agrees with zero within its error",
        Rejection.NOT_SIGNIFICANT: "not significant beside everything else",
        Rejection.REPLACED: "another effect that fits as well passes the tests",
        Rejection.ABSORBED: "everything else explains as much without it",
        Rejection.HELD_OUT_WORSE: f"it predicts held-out {unit} worse",
        Rejection.LEFT_OUT_WORSE: f"it predicts {unit} worse, each left out once",
        Rejection.LEFT_OUT_NOT_SIGNIFICANT: f"{unit}, each left out once, do not support it beyond chance",
    }[test.rejection]


def describe_disagreement(disagreement: Disagreement, base: Model) -> str:
    """Describe a disagreement in words: "ball 1 sliding, along its motion, changing with the speed"."""
    names = {"before": "before the contact", "contact": "at the contact"}
    if not base.sliding_friction:  # on air
        names["sliding"] = "gliding"
    phase = names.get(disagreement.phase, disagreement.phase)
    changing = f", changing with the {disagreement.against}" if disagreement.against else ""
    return f"{disagreement.ball} {phase}, {disagreement.observable} its motion{changing}"


def describe_gap(gap: Gap, unit: EvidenceUnit) -> str:
    """Describe how the claims change the gap on held-out collisions, or on held-out stretches."""
    before, after = f"{gap.before:.3g}", f"{gap.after:.3g}"
    if before == after:
        moved = f"stays at {before}"
    else:
        moved = f"{'falls' if gap.after < gap.before else 'does not fall but rises'} from {before} to {after}"
    less = f" Clips that count less, as neither model predicts them: {gap.outliers}." if gap.outliers else ""
    return f"On held-out {unit} chi^2 per point {moved}; noise alone leaves {gap.floor:.3g}.{less}"


def describe_small_closure(gap: Gap, unit: EvidenceUnit, most: float = 0.5) -> str:
    """Describe, as a warning, claims that close less than the share `most` of the gap, if there is one; else empty."""
    if math.isnan(gap.closure):
        return f"The base model already predicts held-out {unit} within the noise, so what follows is a small effect."
    if not gap.closure < most:
        return ""
    closed = f"close only {100 * max(gap.closure, 0.0):.0f} %" if gap.closure > 0 else "do not close any"
    return f"These claims {closed} of the gap on held-out {unit}: most of it has another cause."


def describe_stretch_scatter(scatter: StretchScatter) -> list[str]:
    """Describe in sentences what differs from stretch to stretch, and what to do about it; empty if nothing does."""
    parts = []
    if scatter.friction:
        parts.append(_describe_scatter_size("the sliding friction", scatter, "friction"))
    if scatter.speed_m_s:
        parts += _describe_scatter_on_air(scatter)
    elif scatter.loss_m_s2:
        parts.append(_describe_scatter_size("the rolling loss", scatter, "loss_m_s2"))
    if scatter.displacement_m:
        size, reach = (format_number(1e3 * x, 2) for x in (scatter.displacement_m, scatter.reach_m))
        parts.append(f"smooth displacements of the positions differ by {size} mm rms (they change over {reach} mm)")
    if not parts:
        return []
    lines = [f"From stretch to stretch {', '.join(parts[:-1])}{' and ' if parts[1:] else ''}{parts[-1]}."]
    if scatter.freedom:
        few = f"(Student's t with {scatter.freedom:.0f} degrees of freedom)"
        lines.append(f"A few stretches have far larger accelerations {few}.")
    lines.append("The search counts this scatter as noise, so it cannot see causes that are smaller.")
    if scatter.map_log_ratio > current_policy().min_claim_sigma ** 2 / 2:
        lines.append(
            "All stretches have the same displacements in the same place (the logarithm of the likelihood ratio is "
            f"{scatter.map_log_ratio:.0f}): the map of the camera is warped. tracker warp corrects it."
        )
    return lines


def _describe_scatter_size(text: str, scatter: StretchScatter, name: str) -> str:
    """Describe one size of the scatter, or that the data do not limit it."""
    if name in scatter.unlimited:
        return f"{text} scatters by an amount that the positions do not limit"
    value = getattr(scatter, name)
    return f"{text} scatters by " + (f"{100 * value:.2g} %" if name == "friction" else f"{value:.2g} m/s^2")


def _describe_scatter_on_air(scatter: StretchScatter) -> list[str]:
    """Describe how the accelerations of bodies that glide differ."""
    sizes = {"loss_m_s2": "the loss", "across_m_s2": "the acceleration across the motion"}
    parts = [_describe_scatter_size(text, scatter, size) for size, text in sizes.items() if getattr(scatter, size)]
    if parts:
        law = {0: "", 1: ", in proportion to the speed"}.get(scatter.speed_power, ", as a power of the speed")
        lasts = format_number(1e3 * scatter.lasts_s, 2)
        parts[-1] += f" (at {scatter.speed_m_s:.2g} m/s{law}; each changes within {lasts} ms)"
    return parts


def describe_contacts(claims: Sequence[ContactClaim], model: Model) -> list[str]:
    """Describe what contacts show of the impact, a sentence or more for each quantity, and the causes in the model."""
    lines = [_describe_contact_claim(claim) for claim in claims]
    if lines:
        lines.append("These laws were not compared with the impact of the model.")
        own = {effect.name() for effect in model.effects} | {n for n in BASE_PARAMETERS if getattr(model, n)}
        if known := dict.fromkeys(cause for claim in claims for cause in claim.causes if cause in own):
            lines.append(f"The model has {' and '.join(known)} already; compare its value.")
    return lines


def _describe_contact_claim(claim: ContactClaim) -> str:
    mean, several = _with_error(claim.mean), f"{claim.contacts} contacts"
    if claim.quantity == "restitution":
        first = f"Contacts: the mean restitution of {several} is {mean}"
    elif claim.quantity == "friction":
        first = f"The mean ratio of tangential to normal impulse of {several} is {mean}"
    else:
        share, std = 100 * math.expm1(claim.mean.value), 100 * claim.mean.std
        first = f"Recoil of {several}: the struck body has {share:+.2g} +- {std:.2g} % more mass than stated"
    scatter = f"from contact to contact it scatters by {claim.scatter:.2g}" if claim.scatter else "it does not scatter"
    if claim.odd:
        scatter += f"; {claim.odd} of them, perhaps disturbed by a third body, with a wide error"
    if not claim.causes:
        none = {
            "restitution": "It does not change significantly with speed or obliqueness",
            "friction": "That is not significant",
            "recoil": "That agrees with the stated masses",
        }
        return f"{first}; {scatter}. {none[claim.quantity]}."
    numbers = ", ".join(f"{n.name} {_with_error(n)}{'' if n.unit == '1' else f' {n.unit}'}" for n in claim.numbers)
    others = f" These fit nearly as well: {'; '.join(claim.rivals)}." if claim.rivals else ""
    others += f" Excluded: {'; '.join(claim.excluded)}." if claim.excluded else ""
    if any(number.name == SPIN_NUMBER for number in claim.numbers):
        others += (
            " w is a spin about the vertical. Strikers count as rolling; those that slide make the friction too large."
        )
    return (
        f"{first}. The law that fits best: {claim.law} ({numbers}; {claim.sigma:.1f} sigma); {scatter}.{others} "
        f"The contacts show {' or '.join(claim.causes)}.{_advise_measurement(claim.causes)}"
    )


def _with_error(number: ContactNumber) -> str:
    return f"{round_to_error(number.value, number.std, 2)} +- {number.std:.2g}"


def _advise_measurement(causes: Sequence[str]) -> str:
    """The measurement that would distinguish causes which the same contacts cannot; empty for one cause."""
    if len(causes) < 2:
        return ""
    if "mass_mismatch" in causes:
        return " Weigh the bodies, or let each strike the other, to distinguish these."
    if "hop" in causes:
        return " A view from the side would show a hop."
    return " Contacts at other speeds and angles would distinguish these."


def describe_slow_noise(noise: Noise) -> str:
    """Describe, as a warning, noise that is slow, so that it may hide missing physics; else empty."""
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


def _is_significant(errors: float, least: float = 3.0) -> bool:
    """Tell if a strength is so many standard errors from zero that its sign has a meaning."""
    return errors >= least


def _describe_distance(errors: float) -> str:
    """Say how far a strength is from zero, where that is significant; else the number would mislead."""
    return f"{errors:.0f} standard errors from zero" if _is_significant(errors) else "not significant"


def _last(name: str) -> str:
    return name.rpartition(".")[2]


def _unit(name: str) -> str:
    unit = find_parameter(Model(), name).unit
    return "" if unit in ("", "1") else f" {unit}"


def write_story(found: SearchOutcome) -> list[str]:
    """Write the four sentences, beside that of the outcome (`SearchResult.sentence`)."""
    return [_describe_fit(found), _describe_disagreement(found), _describe_gap(found), _describe_open_questions(found)]


def format_sigma(sigma: float) -> str:
    """Format a significance for a narrative: one decimal place, or four digits from 100 on."""
    return f"{sigma:.1f}" if sigma < 100 else format_number(sigma, 4)


def format_chi2(ratio: float) -> str:
    """Format chi^2 per point or degree of freedom for a narrative: at most four digits."""
    return f"{ratio:.3f}" if ratio < 9.9995 else format_number(ratio, 4)


def gain_of_next_step(fit: ModelFit) -> float:
    """Compute how far a narrative's fit is from its minimum: the decrease of chi^2 by one more step."""
    shared, own = solve_step(fit, 0.0, *fit.step_bounds())
    steps = [s @ shared + a @ o for s, a, o in zip(fit.slopes, fit.launch_slopes, own, strict=True)]
    return fit.chi2 - sum(float((r - s) @ (r - s)) for r, s in zip(fit.residuals, steps, strict=True))


def _describe_fit(found: SearchOutcome, converged: float = 0.1) -> str:
    """converged: decrease of chi^2 by a further step below which the fit counts as converged."""
    base, data, noise = found.base_fit, found.data, found.data.noise
    speeds = [float(c.launch[V0]) for c in data.clips]
    widest = max(abs(float(c.launch[B])) for c in data.clips)
    oblique = "" if data.is_cut else f" with |b| up to {widest:.2f}"
    shared = ", ".join(base.names) or "nothing"
    numbers = "six" if base.launches.shape[1] < WITH_SPIN else "six to nine"
    gain = gain_of_next_step(base)
    state = "converged" if gain < converged else f"did not converge: a further step would lower chi^2 by {gain:.2g}"
    common = f", {1e6 * noise.common_mode_rms:.2g} um of it common to both balls" if noise.shared else ""
    return (
        f"The search fitted {len(data.clips)} {data.unit} together, at {min(speeds):.2f} to {max(speeds):.2f} m/s"
        f"{oblique}. They share {shared}; each has {numbers} launch parameters; the fit {state}. "
        f"{len(data.held_out)} more {data.unit} were held out. The noise is {noise.scale:.3g} times the errors with "
        f"which the search began, with a correlation of {noise.correlation:+.2f} between frames{common}."
    )


def _describe_disagreement(found: SearchOutcome) -> str:
    base = found.base_fit
    per_degree = format_chi2(base.chi2 / (base.points - base.parameters))
    fitted = f"On the {len(found.data.clips)} fitted {found.data.unit}"
    chi2 = f"{fitted} the base model has chi^2 per degree of freedom {per_degree}"
    worst = found.base_disagreements[0] if found.base_disagreements else None
    if worst is None or worst.sigma == 0:
        return f"{chi2} and no significant disagreement."
    size = f" ({format_number(worst.size, 2)} um rms of the terms that this test fits)" if worst.size > 0 else ""
    where = describe_disagreement(worst, base.model)
    return (
        f"{chi2}. Its largest disagreement is {where}: {format_sigma(worst.sigma)} sigma after a correction for "
        f"{len(found.base_disagreements)} tests{size}."
    )


def _describe_gap(found: SearchOutcome) -> str:
    gap, where = found.gap, f"On the {len(found.data.held_out)} held-out {found.data.unit}"
    noise = f"noise alone would leave {gap.floor_um:.2f} um"
    if found.is_empty:
        early = "The search stopped early: a finished one may leave out clips, estimate noise again or name effects."
        base = f"{where} the base model leaves residuals of {gap.before_um:.2f} um rms; {noise}."
        return f"{base} {early}" if found.interrupted else base
    closed = "The excess of chi^2 over noise is too small to say what share of it the best model removes"
    if np.isfinite(gap.closure):
        closed = f"The best model removes {100 * gap.closure:.1f} % of the excess of chi^2 over noise"
    return (
        f"{where} the residuals go from {gap.before_um:.2f} um rms with the base model to "
        f"{gap.after_um:.2f} um; {noise}. {closed}."
    )


def _describe_open_questions(found: SearchOutcome) -> str:
    lines, fitted = [], f"These {len(found.data.clips)} fitted {found.data.unit}"
    sizes = f"{found.policy.max_detection_limit:g} times its"
    classes = [_join_words(claim.aliases, "and") for claim in found.claims if len(claim.aliases) > 1]
    if classes:
        lines.append(f"{fitted} cannot distinguish {'; nor '.join(classes)} (see the experiment below).")
    if found.law_summary and found.law_summary.formula_rejected:
        lines.append("None of the short formulas that were tried describes the free curve.")
    undetermined = [name for claim in found.claims for name, std in claim.shape_std.items() if not np.isfinite(std)]
    if undetermined:
        lines.append(f"{fitted} do not determine {_join_words(undetermined, 'and')}.")
    if found.undetectable:
        lines.append(
            f"{fitted} would show {_join_words(found.undetectable, 'or')} only above {sizes} realistic size, or not at "
            "all."
        )
    elif not lines:
        lines.append(f"{fitted} would show every effect of the library at {sizes} realistic size, or at less.")
    return " ".join(
        [*lines, *(f"{note[:1].upper()}{note[1:]}." for note in map(str, (*found.uniform, *found.processed)))]
    )


def _join_words(words: Sequence[str], last: str) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
