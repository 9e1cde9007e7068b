"""Figures of a search's page: residuals, free law, candidates, and the gap on held-out collisions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, T_C, V0
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.law_summary import LawSummary
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.outcome import SearchOutcome
from discrepancy.validate.gap import Gap
from synthcam_shared.arrays import Array, Ints
from synthcam_shared.report.page import PageFigure, make_axes

# colours of the base model, of the best model, of noise alone, and of all else
COLOURS = {"base": "#b2182b", "best": "#2166ac", "noise": "#4d4d4d", "other": "#bdbdbd"}  # by what is drawn
MAX_RANKED_EFFECTS = 20  # in the chart of candidates
LINEAR_UP_TO = 10.0  # sigma, on an axis that is logarithmic above
MIN_CLUSTERS = 3  # collisions whose scatter gives an error bar
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}


def name_best_model(found: SearchOutcome) -> str:
    """Name the best model for the figures, after what it has beside the base model: "with plate_tilt"."""
    effects = sorted({claim.effect for claim in found.claims})
    return f"with {' and '.join([*(['a free law'] if found.free_law else []), *effects])}"


def list_models(found: SearchOutcome) -> list[str]:
    """List the models that the figures show: the base model and, where anything was found, the best one."""
    return ["base model"] if found.is_empty else ["base model", name_best_model(found)]


@matplotlib.rc_context(STYLE)
def draw_search_figures(found: SearchOutcome) -> list[PageFigure]:
    """Draw all figures of a search's page."""
    unit = found.data.unit
    compared = f", base model and model {name_best_model(found)}" if not found.is_empty else " of the base model"
    early = " stopped early and" if found.interrupted else ""
    only = "" if not found.is_empty else f" The search{early} names no effect, so the base model is shown alone."
    means, sizes = _residual_figures(found)
    bars = f"Error bars: standard error from the scatter between {unit}; none with fewer than {MIN_CLUSTERS}."
    times = "Each phase of a ball is divided into eight equal times."
    path, heading = "after the contact", "the heading of the striker"
    if found.data.is_cut:
        path, heading = "in its stretch", "its first direction"
    figures = [
        (
            f"Mean residuals{compared}",
            means,
            f"Residual: measured less predicted position, of the fitted {unit}. A point is the average of the means of "
            f"the {unit}. {bars} {times} Along: along the path of the ball {path}. Across: to the side to which this "
            f"path deviates from {heading}. The significances on this page compare each {unit.one} with its "
            f"measurement noise. A wrong model makes {unit} differ; these significances are then larger than the error "
            "bars suggest.",
        ),
        (
            f"Size of the residuals{compared}",
            sizes,
            f"Root mean square of the same residuals, of one coordinate. {bars} {times} The rms also shows a "
            f"disagreement whose sign changes between {unit}.",
        ),
    ]
    if found.law_summary:
        caption = "Law without an assumed form: fitted curve with bands of 68 and 95 %."
        if len(found.law_summary.x) == 2:
            caption = "Law without an assumed form, and half the width of its 68 % band: wide where no ball passed."
        figures.append((f"Free law: {found.law_summary.formula}", _law_figure(found.law_summary), caption))
    if found.scores:
        figures.append(("Significance of each candidate effect", _ranking_figure(found), _caption_ranking(found)))
    caption = f"Held-out {unit} enter no fit of shared parameters; only their launches are fitted.{only}"
    figures.append((f"Residuals of held-out {unit} by phase", _gap_by_phase_figure(found), caption))
    each = "Error bars: scatter of χ² per point by noise; many are smaller than the marks."
    if not found.is_empty:
        each = f"{each} The marks of one {unit.one} stand side by side."
    figures.append((f"Residuals of each held-out {unit.one}", _gap_by_clip_figure(found), f"{caption} {each}"))
    return [PageFigure.of(figure, title, caption) for title, figure, caption in figures]


def _fits_to_draw(found: SearchOutcome) -> list[tuple[Sequence[MeasuredCollision], ModelFit, str, str]]:
    """Clips, fit, colour and label of the base model and, where anything was found, of the best one."""
    best_clips = found.free_law.evidence.clips if found.free_law else found.data.clips
    clips, fits = (found.data.clips, tuple(best_clips)), (found.base_fit, found.best_fit)
    return list(zip(clips, fits, (COLOURS["base"], COLOURS["best"]), list_models(found), strict=False))


def _residual_figures(found: SearchOutcome) -> tuple[Figure, Figure]:
    """The mean residuals of each ball, along and across its path, and their size, by the stage of the motion."""
    shown = (1,) if found.data.is_cut else (0, 1)  # only a "striker" is seen in a stretch
    means, grid = make_axes(len(shown), 2, figsize=(8, 0.2 + 2.2 * len(shown)), sharex=True, squeeze=False)
    sizes, ((*row,),) = make_axes(1, len(shown), figsize=(4 * len(shown), 2.8), sharey=True, squeeze=False)
    for k, (clips, fit, colour, label) in enumerate(_fits_to_draw(found)):
        stage, ball, clip, left = _residuals(clips, fit, found.data.noise)
        style: Any = {"fmt": "o", "ms": 3, "lw": 1, "color": colour, "label": label}
        for b, both, ax in zip(shown, grid, row, strict=True):
            mine = ball == b
            for axis in range(2):
                centres, mean, error = _average_bins(stage[mine], clip[mine], left[mine, axis])
                both[axis].errorbar(centres + 0.02 * k, mean, error, **style)
            centres, square, error = _average_bins(stage[mine], clip[mine], (left[mine] ** 2).mean(axis=1))
            rms = np.sqrt(square)
            ax.errorbar(centres + 0.02 * k, rms, error / (2 * rms), **style)
    for b, both, ax in zip(shown, grid, row, strict=True):
        name = "all stretches" if found.data.is_cut else f"ball {b + 1}"
        for axis, word in enumerate(("along", "across")):
            both[axis].axhline(0, color=COLOURS["noise"], lw=0.5)
            _mark_stages(both[axis], f"{name}, {word}", found.data.is_cut)
        both[0].set_ylabel("mean residual (µm)")
        ax.axhline(found.gap.floor_um, color=COLOURS["noise"], lw=1, ls="--", label="noise alone (held-out)")
        _mark_stages(ax, name, found.data.is_cut)
    row[0].set(ylabel="rms residual in x and y (µm)", ylim=(0, None))
    means.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    sizes.legend(*row[0].get_legend_handles_labels(), loc="outside upper center", ncols=1 + len(shown))
    return means, sizes


def _mark_stages(ax: Axes, title: str, is_cut: bool) -> None:
    for edge in (0, 1):
        ax.axvline(edge, color=COLOURS["noise"], lw=0.5, ls=":")
    ax.set(title=title, xlim=(-0.05 if is_cut else -1.05, 2.05))
    ax.set_xticks([-0.5, 0.5, 1.5], ("before contact", "sliding", "rolling"))
    ax.tick_params(axis="x", length=0)


def _residuals(clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise) -> tuple[Array, Ints, Ints, Array]:
    """Residuals of positions along and across the path, µm, with their stage, ball and number of the clip.

    The stage is -1 to 0 before the contact, to 1 in sliding, and to 2 in rolling.
    """
    stages, balls, numbers, lefts = [], [], [], []
    expected = predict_tracks(fit.model, fit.launches, clips)
    for number, (clip, launch, xy, white) in enumerate(zip(clips, fit.launches, expected, fit.residuals, strict=True)):
        time = (clip.frame + 0.0) / clip.fps + clip.exposure / 2
        stage = np.zeros(len(time))
        left, out = ClipWhitener.of(clip, noise).undo_noise(white), np.zeros((len(time), 2))
        for b in range(2):
            rows = clip.ball == b
            if not rows.any():
                continue
            when = time[rows]
            t_c, over = launch[T_C], max(clip.slide_ends[b], launch[T_C] + 1e-6)
            edges = [min(when[0], t_c - 1e-6), t_c, over, max(when[-1], over + 1e-6)]
            stage[rows] = np.interp(when, edges, [-1, 0, 1, 2])
            after = rows & (time > t_c)
            path = xy[after][-1] - xy[after][0] if np.any(after) else np.zeros(2)
            rolls_in = np.array([np.cos(launch[HEADING]), np.sin(launch[HEADING])])
            path = path / np.hypot(*path) if np.hypot(*path) > 1e-5 else rolls_in
            side = np.array([-path[1], path[0]]) * (np.sign(rolls_in[0] * path[1] - rolls_in[1] * path[0]) or 1.0)
            out[rows] = 1e6 * np.stack([left[rows] @ path, left[rows] @ side], axis=1)
        stages.append(stage)
        balls.append(clip.ball)
        numbers.append(np.full(len(stage), number))
        lefts.append(out)
    return np.concatenate(stages), np.concatenate(balls), np.concatenate(numbers), np.concatenate(lefts)


def _average_bins(
    stage: Array, clip: Ints, values: Array, bins: int = 8, min_points: int = 3
) -> tuple[Array, Array, Array]:
    """Average values in bins of the stage: the middles of the bins, the means, and their standard errors.

    bins: of a stage; min_points: in a bin that is shown.
    """
    which = np.floor((np.clip(stage, -1, 2 - 1e-9) + 1) * bins).astype(int)
    kept = [k for k in range(3 * bins) if np.sum(which == k) >= min_points]
    averages = [average_clusters(clip[which == k], values[which == k]) for k in kept]
    mean, error = np.reshape(averages, (-1, 2)).T
    return (np.array(kept) + 0.5) / bins - 1, mean, error


def average_clusters(cluster: Ints, values: Array) -> tuple[float, float]:
    """Average the means of clusters; return this average and its standard error, by the scatter of the means.

    Values of one cluster may depend on each other, as the residuals of a collision do with a wrong model. Different
    clusters are independent. The error is NaN with fewer than `MIN_CLUSTERS` clusters.
    """
    _, which = np.unique(cluster, return_inverse=True)
    means = np.bincount(which, values) / np.bincount(which)
    if len(means) < MIN_CLUSTERS:
        return float(means.mean()), np.nan
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means)))


def _law_figure(answer: LawSummary) -> Figure:
    law = answer.law
    if len(answer.x) == 2:
        return _law_map_figure(answer)
    figure, ax = make_axes(figsize=(6, 3.2))
    axis, x = law.axes[0], answer.x[0]
    for part, (word, colour) in enumerate(zip(law.part_names, (COLOURS["best"], COLOURS["base"]), strict=False)):
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


def _law_map_figure(answer: LawSummary) -> Figure:
    law = answer.law
    side = round(np.sqrt(len(answer.x[0])))
    scale = 1e3 if law.axes[0].unit == "m" else 1.0
    extent = tuple(scale * v for a in law.axes for v in (a.low, a.high))
    shown = [(answer.curve[:, p], word) for p, word in enumerate(law.part_names)]
    shown.append((np.ptp(answer.bands["band68"], axis=-1).max(axis=1) / 2, "+-"))
    figure, axes = make_axes(1, len(shown), figsize=(3.4 * len(shown), 3))
    for ax, (values, label) in zip(axes, shown, strict=True):
        picture = ax.imshow(values.reshape(side, side).T, origin="lower", extent=extent, aspect="equal")
        figure.colorbar(picture, ax=ax, shrink=0.8)
        ax.set(title=f"{law.title} {label}", xlabel=f"x ({'mm' if scale > 1 else law.axes[0].unit})", ylabel="y")
    return figure


def _caption_ranking(found: SearchOutcome) -> str:
    shown, total = len(found.scores[:MAX_RANKED_EFFECTS]), len(found.scores)
    which = f"The {shown} most significant of {total} effects" if shown < total else f"All {total} effects"
    scale = f" The axis is linear up to {LINEAR_UP_TO:g} and logarithmic above." if _is_wide(found) else ""
    colours = " Dark blue: claimed effects. Light blue: effects that fit as well." if found.claims else ""
    return (
        f"{which}, each added alone to the base model (score test on the {len(found.data.clips)} fitted "
        f"{found.data.unit}). A wrong base model makes many significant; refits and tests decide.{colours}{scale}"
    )


def _ranking_figure(found: SearchOutcome) -> Figure:
    ranking = found.scores[:MAX_RANKED_EFFECTS][::-1]
    figure, ax = make_axes(figsize=(6, 0.6 + 0.25 * len(ranking)))
    claimed = {n.effect for n in found.claims}
    rivals = {a for n in found.claims for a in n.aliases} - claimed
    colours = [
        COLOURS["best"] if c.effect in claimed else "#92c5de" if c.effect in rivals else COLOURS["other"]
        for c in ranking
    ]
    bars = ax.barh([c.effect for c in ranking], [c.sigma for c in ranking], color=colours)
    ax.bar_label(bars, [f"{c.sigma:.4g}" for c in ranking], padding=2, fontsize=7)
    claim = found.required_sigma
    ax.axvline(claim, color=COLOURS["base"], lw=1, ls="--", label=f"required for a claim: {claim:.1f}")
    ax.set(xlabel="significance (sigma)")
    if _is_wide(found):
        ax.set_xscale("symlog", linthresh=LINEAR_UP_TO)
    ax.legend(loc="lower right")
    return figure


def _is_wide(found: SearchOutcome, wide: float = 50.0) -> bool:
    """Tell if the significances of the candidates need a logarithmic axis."""
    return max(c.sigma for c in found.scores) > wide


def _gap_by_phase_figure(found: SearchOutcome) -> Figure:
    gap = found.gap
    figure, axes = make_axes(1, 2, figsize=(8, 3))
    for ax, ending in zip(axes, ("", "_um"), strict=True):
        _draw_gap_bars(ax, gap, ending, list_models(found))
    _scale_log_if_wide(axes[0], gap)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _draw_gap_bars(ax: Axes, gap: Gap, ending: str, models: list[str]) -> None:
    """Draw the gap by phase as bars, of each model and of noise; ending: "" for χ² per point, "_um" for rms in µm."""
    parts = {**gap.by_phase, "all": gap}
    kinds = [
        *zip(("before", "after"), (COLOURS["base"], COLOURS["best"]), models, strict=False),
        ("floor", COLOURS["noise"], "noise alone"),
    ]
    width = 0.81 / len(kinds)
    for k, (key, colour, label) in enumerate(kinds):
        values = [getattr(part, key + ending) for part in parts.values()]
        place = np.arange(len(parts)) + width * (k - (len(kinds) - 1) / 2)
        ax.bar(place, values, 0.9 * width, color=colour, label=label)
    ax.set_xticks(range(len(parts)), ["before contact" if name == "before" else name for name in parts])
    ax.set(ylabel="rms residual in x and y (µm)" if ending else "χ² per point")


def _gap_by_clip_figure(found: SearchOutcome) -> Figure:
    figure, ax = make_axes(figsize=(6, 3))
    speeds = np.array([float(c.launch[V0]) for c in found.data.held_out])
    models = list_models(found)
    fits = zip(
        (found.gap_fits.before, found.gap_fits.after), (COLOURS["base"], COLOURS["best"]), "os", models, strict=False
    )
    for k, (fit, colour, marker, label) in enumerate(fits):
        points = np.array([len(r) for r in fit.residuals])
        chi2 = np.array([r @ r for r in fit.residuals]) / points
        at = speeds + 0.006 * np.ptp(speeds) * (2 * k - len(models) + 1)  # side by side: neither hides the other
        errors = find_chi2_scatter(chi2, points)
        ax.errorbar(at, chi2, errors, fmt=marker, ms=4, lw=1, color=colour, mfc="white", label=label)
    ax.axhline(found.gap.floor, color=COLOURS["noise"], lw=1, ls="--", label="noise alone")
    _scale_log_if_wide(ax, found.gap)
    ax.set(xlabel="speed before the contact (m/s)", ylabel=f"χ² per point, held-out {found.data.unit}")
    ax.legend()
    return figure


def find_chi2_scatter(chi2: Array, points: Ints) -> Array:
    """Standard deviation, by noise alone, of chi^2 per point of models that may be wrong.

    A residual with mean m and variance 1 has a square with the mean 1 + m^2 and the variance 2 + 4 m^2, so `chi2`
    estimates 1 + m^2 (the noncentral chi^2 distribution).
    """
    return np.asarray(np.sqrt(2 * np.maximum(2 * chi2 - 1, 1) / points))


def _scale_log_if_wide(ax: Axes, gap: Gap, wide: float = 5.0) -> None:
    """Use a logarithmic axis where the base model leaves over `wide` times what noise leaves."""
    if gap.before / max(gap.floor, 1e-9) > wide:
        ax.set_yscale("log")


def plot_gap(gap: Gap, ax: Axes | None = None) -> Axes:
    """Plot the gap on held-out collisions by phase, as `SearchResult.plot_gap` does.

    Parameters
    ----------
    gap : Gap
        Of a `SearchResult`.
    ax : Axes, optional
        Where to draw; default: a new figure.

    Returns
    -------
    Axes
        Residuals, rms, each axis, um.

    Examples
    --------
    >>> import discrepancy
    >>> found = discrepancy.find("out/results", "painter_behringer")  # doctest: +SKIP
    >>> discrepancy.plot_gap(found.gap)  # doctest: +SKIP
    """
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
    _draw_gap_bars(ax, gap, "_um", ["base model", "with what was found"])
    ax.set(xlabel="phase of the collision")
    ax.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return ax
