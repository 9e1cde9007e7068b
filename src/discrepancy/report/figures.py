"""The report's figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, T_C, V0
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.predict import predict_tracks
from discrepancy.found import SearchResult
from discrepancy.free_laws.law_summary import LawSummary
from discrepancy.validate.gap import Gap
from synthcam_shared.report.page import embed_figure

BEFORE, AFTER, FLOOR, OTHER = "#b2182b", "#2166ac", "#4d4d4d", "#bdbdbd"
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}
STAGES = ("before", "sliding", "rolling")
BINS = 8  # of a stage
FEWEST = 3  # points of a bin
SHOWN = 20  # candidates, at most


def drawn(found: SearchResult) -> list[dict[str, str]]:
    """title, note and png of each."""
    with matplotlib.rc_context(STYLE):
        out = [
            inline(
                "What is left, before and after",
                _stacked(found),
                "Residuals of the collisions fitted, mean over clips with its standard error. Each stage from its "
                "beginning to its end; across: to the side that the ball is deflected to.",
            ),
            inline(
                "Its size",
                _sizes(found),
                "Root mean square of the same residuals. What changes sign from clip to clip shows here only.",
            ),
        ]
        if found.answer:
            note = "The law left free: fitted curve, with bands of 68 and 95 %."
            if len(found.answer.x) == 2:
                note = (
                    "The law left free, and the half width of its band of 68 %; where no ball came by the band is wide."
                )
            out.append(inline(found.answer.formula, _curve(found.answer), note))
        if found.selected.ranking:
            note = "Score of every effect of the library against the base model alone, before any refit."
            out.append(inline("Candidates", _ranking(found), note))
        note = "Collisions that no fit has seen, each one's launch refitted."
        out.append(inline("The gap by phase", _by_phase(found), note))
        out.append(inline("The gap, clip by clip", _by_clip(found), note))
    return out


def _subplots(rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **shared: Any) -> tuple[Figure, Any]:
    """As pyplot's, but known to nobody else: in a notebook pyplot would show what is drawn for the page."""
    figure = Figure(figsize=figsize, layout="constrained")
    return figure, figure.subplots(rows, columns, **shared)


def inline(title: str, figure: Figure, note: str) -> dict[str, str]:
    """A figure for a self-contained page; title and note (what it shows) stand beside it."""
    return {"title": title, "note": note, "address": embed_figure(figure)}


def _sets(found: SearchResult) -> list[tuple[Sequence[MeasuredCollision], ModelFit, str, str]]:
    sets: list[tuple[Sequence[MeasuredCollision], ModelFit, str, str]] = [
        (found.data.clips, found.base, BEFORE, "before")
    ]
    if found.anything:
        sets.append((found.free_law.evidence.clips if found.free_law else found.data.clips, found.best, AFTER, "after"))
    return sets


def _stacked(found: SearchResult) -> Figure:
    figure, axes = _subplots(2, 2, figsize=(8, 4.6), sharex=True)
    for k, (clips, fit, colour, label) in enumerate(_sets(found)):
        stage, ball, left = _residuals(clips, fit)
        for (b, axis), ax in np.ndenumerate(axes):
            centres, values = _binned(stage[ball == b], left[ball == b, axis])
            means = [v.mean() for v in values]
            errors = [v.std(ddof=1) / np.sqrt(len(v)) for v in values]
            ax.errorbar(centres + 0.02 * k, means, errors, fmt="o", ms=3, lw=1, color=colour, label=label)
    for (b, axis), ax in np.ndenumerate(axes):
        ax.axhline(0, color=FLOOR, lw=0.5)
        _staged(ax, f"ball {b + 1}, {('along', 'across')[axis]}")
    for ax in axes[:, 0]:
        ax.set_ylabel("mean residual (um)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _sizes(found: SearchResult) -> Figure:
    figure, axes = _subplots(1, 2, figsize=(8, 2.8), sharey=True)
    for k, (clips, fit, colour, label) in enumerate(_sets(found)):
        stage, ball, left = _residuals(clips, fit)
        for b, ax in enumerate(axes):
            centres, values = _binned(stage[ball == b], np.sqrt((left[ball == b] ** 2).mean(axis=1)))
            sizes = np.array([np.sqrt(np.mean(v**2)) for v in values])
            errors = sizes / np.sqrt([4 * len(v) for v in values])
            ax.errorbar(centres + 0.02 * k, sizes, errors, fmt="o", ms=3, lw=1, color=colour, label=label)
    for b, ax in enumerate(axes):
        ax.axhline(found.shown.gap.floor_um, color=FLOOR, lw=1, ls="--", label="noise alone")
        _staged(ax, f"ball {b + 1}")
    axes[0].set(ylabel="rms residual, each axis (um)", ylim=(0, None))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _staged(ax: Axes, title: str) -> None:
    for edge in (0, 1):
        ax.axvline(edge, color=FLOOR, lw=0.5, ls=":")
    ax.set(title=title, xlim=(-1.05, 2.05))
    ax.set_xticks([-0.5, 0.5, 1.5], STAGES)
    ax.tick_params(axis="x", length=0)


def _residuals(clips: Sequence[MeasuredCollision], fit: ModelFit) -> tuple[Array, Array, Array]:
    """Of each row of all clips: -1 to 0 before, to 1 sliding, to 2 rolling; ball; residual along and across, um."""
    stages, balls, lefts = [], [], []
    expected = predict_tracks(fit.model, fit.launches, clips)
    for clip, launch, xy in zip(clips, fit.launches, expected, strict=True):
        time = (clip.frame + 0.0) / clip.fps + clip.exposure / 2
        stage = np.zeros(len(time))
        left, out = clip.xy - xy, np.zeros((len(time), 2))
        for b in range(2):
            rows = clip.ball == b
            when = time[rows]
            t_c, over = launch[T_C], max(clip.slide_ends[b], launch[T_C] + 1e-6)
            edges = [min(when[0], t_c - 1e-6), t_c, over, max(when[-1], over + 1e-6)]
            stage[rows] = np.interp(when, edges, [-1, 0, 1, 2])
            after = rows & (time > t_c)
            way = xy[after][-1] - xy[after][0] if np.any(after) else np.zeros(2)
            rolls_in = np.array([np.cos(launch[HEADING]), np.sin(launch[HEADING])])
            way = way / np.hypot(*way) if np.hypot(*way) > 1e-5 else rolls_in
            side = np.array([-way[1], way[0]]) * (np.sign(rolls_in[0] * way[1] - rolls_in[1] * way[0]) or 1.0)
            out[rows] = 1e6 * np.stack([left[rows] @ way, left[rows] @ side], axis=1)
        stages.append(stage)
        balls.append(clip.ball)
        lefts.append(out)
    return np.concatenate(stages), np.concatenate(balls), np.concatenate(lefts)


def _binned(stage: Array, left: Array) -> tuple[Array, list[Array]]:
    """Middles of the bins, and what falls into each."""
    which = np.floor((np.clip(stage, -1, 2 - 1e-9) + 1) * BINS).astype(int)
    kept = [k for k in range(3 * BINS) if np.sum(which == k) >= FEWEST]
    return (np.array(kept) + 0.5) / BINS - 1, [left[which == k] for k in kept]


def _curve(answer: LawSummary) -> Figure:
    law = answer.law
    if len(answer.x) == 2:
        return _map(answer)
    figure, ax = _subplots(figsize=(6, 3.2))
    axis, x = law.axes[0], answer.x[0]
    for part, (word, colour) in enumerate(zip(law.part_names, (AFTER, BEFORE), strict=False)):
        y = answer.curve[:, part]
        if law.is_per_clip:
            ax.errorbar(x, y, np.abs(answer.bands["band"][:, part].T - y), fmt="o", ms=3, lw=1, color=colour)
            continue
        for name, alpha in (("band", 0.2), ("band68", 0.35)):
            ax.fill_between(x, *answer.bands[name][:, part].T, color=colour, alpha=alpha, lw=0)
        ax.plot(x, y, color=colour, lw=1.2, label=word)
    if law.parts > 1:
        ax.legend()
    unit = "" if axis.unit == "1" else f" ({axis.unit})"
    ax.set(xlabel=f"{axis.name}{unit}", ylabel=f"{law.title}" + ("" if law.unit == "1" else f" ({law.unit})"))
    return figure


def _map(answer: LawSummary) -> Figure:
    law = answer.law
    side = round(np.sqrt(len(answer.x[0])))
    scale = 1e3 if law.axes[0].unit == "m" else 1.0
    extent = tuple(scale * v for a in law.axes for v in (a.low, a.high))
    shown = [(answer.curve[:, p], word) for p, word in enumerate(law.part_names)]
    shown.append((np.ptp(answer.bands["band68"], axis=-1).max(axis=1) / 2, "+-"))
    figure, axes = _subplots(1, len(shown), figsize=(3.4 * len(shown), 3))
    for ax, (values, label) in zip(axes, shown, strict=True):
        picture = ax.imshow(values.reshape(side, side).T, origin="lower", extent=extent, aspect="equal")
        figure.colorbar(picture, ax=ax, shrink=0.8)
        ax.set(title=f"{law.title} {label}", xlabel=f"x ({'mm' if scale > 1 else law.axes[0].unit})", ylabel="y")
    return figure


def _ranking(found: SearchResult) -> Figure:
    ranking = found.selected.ranking[:SHOWN][::-1]
    figure, ax = _subplots(figsize=(6, 0.6 + 0.25 * len(ranking)))
    claimed = {n.effect for n in found.named}
    rivals = {a for n in found.named for a in n.aliases} - claimed
    colours = [AFTER if c.effect in claimed else "#92c5de" if c.effect in rivals else OTHER for c in ranking]
    ax.barh([c.effect for c in ranking], [c.sigma for c in ranking], color=colours)
    claim = found.selected.claim
    ax.axvline(claim, color=BEFORE, lw=1, ls="--", label=f"needed for a claim, {claim:.1f}")
    ax.set(xlabel="score against the base model (sigma)")
    if max(c.sigma for c in ranking) > 50:
        ax.set_xscale("symlog", linthresh=10)
    ax.legend(loc="lower right")
    return figure


def _by_phase(found: SearchResult) -> Figure:
    gap = found.shown.gap
    figure, axes = _subplots(1, 2, figsize=(8, 3))
    for ax, ending in zip(axes, ("", "_um"), strict=True):
        gap_bars(ax, gap, ending)
    _log_if_wide(axes[0], gap.before / max(gap.floor, 1e-9))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def gap_bars(ax: Axes, gap: Gap, ending: str, labels: Sequence[str] = ("before", "after", "noise alone")) -> None:
    """The gap by phase, in chi^2 a point (ending ""), or rms in um ("_um"), as bars; after them those of all phases."""
    parts = {**gap.by_phase, "all": gap}
    place = np.arange(len(parts))
    kinds = zip(("before", "after", "floor"), (BEFORE, AFTER, FLOOR), labels, strict=True)
    for k, (key, colour, label) in enumerate(kinds):
        values = [getattr(p, key + ending) for p in parts.values()]
        ax.bar(place + 0.27 * (k - 1), values, 0.25, color=colour, label=label)
    ax.set_xticks(place, list(parts))
    ax.set(ylabel="rms residual, each axis (um)" if ending else "chi^2 a point")


def _by_clip(found: SearchResult) -> Figure:
    figure, ax = _subplots(figsize=(6, 3))
    speeds = [float(c.launch[V0]) for c in found.data.kept_out]
    for fit, colour, label in ((found.shown.before, BEFORE, "before"), (found.shown.after, AFTER, "after")):
        points = np.array([len(r) for r in fit.residuals])
        chi2 = np.array([r @ r for r in fit.residuals]) / points
        ax.errorbar(speeds, chi2, chi2 * np.sqrt(2 / points), fmt="o", ms=4, lw=1, color=colour, label=label)
    ax.axhline(found.shown.gap.floor, color=FLOOR, lw=1, ls="--", label="noise alone")
    _log_if_wide(ax, found.shown.gap.before / max(found.shown.gap.floor, 1e-9))
    ax.set(xlabel="speed before the contact (m/s)", ylabel="chi^2 a point, clips kept out")
    ax.legend()
    return figure


def _log_if_wide(ax: Axes, ratio: float) -> None:
    if ratio > 5:
        ax.set_yscale("log")
