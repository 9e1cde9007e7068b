"""The search in plain sentences: what was fitted, where it disagrees, what closes, what stays open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.data.launch import V0, WITH_SPIN, B
from discrepancy.fitting.gauss_newton import solve_step
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.found import SearchResult

SETTLED = 0.1  # of chi^2 that a further step may gain


def story(found: SearchResult) -> list[str]:
    """Four sentences, beside that of the outcome (`SearchResult.sentence`)."""
    return [_fitted(found), _where(found), _closed(found), _open(found)]


def rest(fit: ModelFit) -> float:
    """What a further step of everything fitted would gain, in chi^2, to first order and within its limits."""
    shared, own = solve_step(fit, 0.0, *fit.step_bounds())
    steps = [s @ shared + a @ o for s, a, o in zip(fit.slopes, fit.launch_slopes, own, strict=True)]
    return fit.chi2 - sum(float((r - s) @ (r - s)) for r, s in zip(fit.residuals, steps, strict=True))


def _fitted(found: SearchResult) -> str:
    base, data, noise = found.base, found.data, found.data.noise
    speeds = [float(c.launch[V0]) for c in data.clips]
    widest = max(abs(float(c.launch[B])) for c in data.clips)
    shared = ", ".join(base.names) or "nothing"
    numbers = "six" if base.launches.shape[1] < WITH_SPIN else "six to nine"
    gain = rest(base)
    settled = (
        "converged" if gain < SETTLED else f"did not fully converge: a further step would gain {gain:.2g} in chi^2"
    )
    return (
        f"{len(data.clips)} collisions at {min(speeds):.2f} to {max(speeds):.2f} m/s, |b| up to {widest:.2f}, were "
        f"fitted together ({shared} shared, {numbers} numbers of launch each; the fit {settled}), and "
        f"{len(data.kept_out)} more were kept out; noise is {noise.scale:.2f} times what the tracks claim, its "
        f"correlation from frame to frame {noise.correlation:+.2f}{_common_mode(found)}."
    )


def _common_mode(found: SearchResult) -> str:
    return (
        f", {1e6 * found.data.noise.common_mode_rms:.2g} um of it common to both balls"
        if found.data.noise.shared
        else ""
    )


def _where(found: SearchResult) -> str:
    base = found.base
    left = f"leaves chi^2 = {base.chi2 / (base.points - base.parameters):.3f} per degree of freedom"
    worst = found.where[0] if found.where else None
    if worst is None or worst.sigma == 0:
        return f"The base model {left} and disagrees in no place that stands out."
    size = f", {rounded(worst.size, 2)} um rms" if np.isfinite(worst.size) else ""
    return (
        f"The base model {left} and disagrees most with {worst}: {worst.sigma:.1f} sigma after {len(found.where)} "
        f"trials{size}."
    )


def rounded(value: float, digits: int) -> str:
    """A number of so many digits, without an exponent up to a million."""
    return f"{float(f'{value:.{digits}g}'):g}"


def _closed(found: SearchResult) -> str:
    gap = found.shown.gap
    if not found.anything:
        return (
            f"On collisions that no fit has seen the base model leaves {gap.before_um:.2f} um rms, where noise alone "
            f"leaves {gap.floor_um:.2f} um."
        )
    if np.isfinite(gap.closure):
        closed = f"{100 * gap.closure:.1f} % of the gap in chi^2 is closed"
    else:
        closed = "too small a gap to tell what share of it is closed"
    return (
        f"On collisions that no fit has seen, residuals go from {gap.before_um:.2f} to {gap.after_um:.2f} um rms, "
        f"where noise alone leaves {gap.floor_um:.2f} um: {closed}."
    )


def _open(found: SearchResult) -> str:
    parts = []
    classes = [n.aliases for n in found.named if len(n.aliases) > 1]
    if classes:
        parts.append(f"{_listed([' from '.join(c) for c in classes], 'nor')} (see the experiment below)")
    if found.answer and found.answer.formula_rejected:
        parts.append("which short formula the free curve follows, since none of those tried does")
    undetermined = [s for n in found.named for s, std in n.shape_std.items() if not np.isfinite(std)]
    if undetermined:
        parts.append(f"the value of {_listed(undetermined, 'and')}")
    if found.unidentifiable:
        parts.append(f"whether there is any {_listed(found.unidentifiable, 'or')}")
    if parts:
        said = f"These collisions cannot tell {'; nor '.join(parts)}"
    else:
        said = "Every effect of the library would have shown at a realistic size"
    return "; ".join([said, *found.alike, *found.processed]) + "."


def _listed(words: Sequence[str], last: str) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
