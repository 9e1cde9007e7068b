"""The course of a search in four sentences: the fit, the disagreement, the gap, and the open questions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.data.launch import V0, WITH_SPIN, B
from discrepancy.fitting.gauss_newton import solve_step
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.outcome import SearchOutcome
from discrepancy.wording import describe_disagreement
from synthcam_shared.report.numbers import format_number


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
        f"{len(data.held_out)} more {data.unit} were held out. The noise is {noise.scale:.2f} times the standard "
        f"errors of the positions, with a correlation of {noise.correlation:+.2f} between frames{common}."
    )


def _describe_disagreement(found: SearchOutcome) -> str:
    base = found.base_fit
    per_degree = format_chi2(base.chi2 / (base.points - base.parameters))
    fitted = f"On the {len(found.data.clips)} fitted {found.data.unit}"
    chi2 = f"{fitted} the base model has chi^2 per degree of freedom {per_degree}"
    worst = found.base_disagreements[0] if found.base_disagreements else None
    if worst is None or worst.sigma == 0:
        return f"{chi2} and no significant disagreement."
    size = f", {format_number(worst.size, 2)} um rms" if np.isfinite(worst.size) else ""
    where = describe_disagreement(worst, base.model)
    return (
        f"{chi2}. Its largest disagreement is {where}: {format_sigma(worst.sigma)} sigma, "
        f"corrected for {len(found.base_disagreements)} tests{size}."
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
    classes = [_join_words(claim.aliases, "and") for claim in found.claims if len(claim.aliases) > 1]
    if classes:
        lines.append(f"{fitted} cannot distinguish {'; nor '.join(classes)} (see the experiment below).")
    if found.law_summary and found.law_summary.formula_rejected:
        lines.append("None of the short formulas that were tried describes the free curve.")
    undetermined = [name for claim in found.claims for name, std in claim.shape_std.items() if not np.isfinite(std)]
    if undetermined:
        lines.append(f"{fitted} do not determine {_join_words(undetermined, 'and')}.")
    if found.undetectable:
        lines.append(f"{fitted} cannot show {_join_words(found.undetectable, 'or')} at a realistic size.")
    if not lines:
        lines.append("Every effect of the library would have been detected at a realistic size.")
    return " ".join(
        [*lines, *(f"{note[:1].upper()}{note[1:]}." for note in map(str, (*found.uniform, *found.processed)))]
    )


def _join_words(words: Sequence[str], last: str) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
