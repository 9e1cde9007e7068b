"""The page of a combined set: means, forest plot, funnel plot, slopes, and the joint fit of the paper."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from synthcam_shared.outputs import replace_folder, write_atomically
from synthcam_shared.report.numbers import format_number, format_percent, format_with_error
from synthcam_shared.report.page import (
    Block,
    PageFigure,
    PageList,
    PageSection,
    PageTable,
    make_axes,
    typeset_symbol,
    write_page,
)
from tracker.report.quantities import QUANTITIES, Quantity
from tracker.sets.combined_quantity import CombinedQuantity, describe_scatter, name_collision

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FILES = ("set.json", "index.html")
COLOURS = {"tied": "#14508c", "free": "#c1440e", "local": "#5b7f1c"}
CAPTION = (
    "Left, forest plot: each collision with one standard error, in the order of v_n. Below them: the mean of each "
    "result, and that of all, with intervals of 95 %. Dark band: the interval of the mean. Light band: 95 % of the "
    "true values of further collisions lie in it. Middle, funnel plot: 95 % of the points lie within the solid lines "
    "if there is no scatter, and within the dashed ones with it. Right: values against v_n, the speed along the line "
    "of centres, with the fitted line."
)
METHOD = (
    "Each value is the mean, plus a deviation of its collision, plus its error.",
    "The scatter τ is the standard deviation of these deviations. It makes the weighted sum of squares equal to its "
    "degrees of freedom (Paule and Mandel 1982). Its interval is that of the Q profile (Viechtbauer 2007).",
    "The error of a mean is that of Hartung, Knapp, Sidik and Jonkman, and their factor is at least one. Intervals use "
    "Student's t.",
    "Errors of camera.json that several collisions share do not average out; they are part of the error of the mean.",
    "I²: share of the scatter in the variance of a typical value. Birge ratio: sqrt(χ²/dof) without scatter.",
    "Slope: regression of the values on v_n. It ignores the errors of v_n.",
)
CHI2 = (
    "The fit of Painter and Behringer: r, μ_k and C that minimise χ² over the speeds and times at the ends of the "
    "slides. It uses free fits of collisions that are ok, and has no scatter between collisions. Its errors are "
    "multiplied by sqrt(χ²/dof)."
)


def write_set(
    document: Mapping[str, Any], quantities: Mapping[str, CombinedQuantity], folder: Path, command: str
) -> Path:
    """Write the page of a set, and set.json, which is `document`, into a folder, which replaces an earlier set."""
    sections = [
        PageSection("", [_means_table(quantities)]),
        *(
            PageSection(f"{name}: {find_quantity(name).meaning}", _blocks(one, "" if number else CAPTION))
            for number, (name, one) in enumerate(quantities.items())
        ),
        PageSection("Joint fit of the paper", _chi2_blocks(document["chi2"]["chi2"])),
        PageSection("Method", [PageList(METHOD)]),
    ]
    with replace_folder(folder, FILES, "an earlier set of tracker combine") as aside:
        write_atomically(aside / FILES[0], json.dumps(document, indent=1) + "\n")
        count = f"{document['used']} collision{'s' * (document['used'] != 1)}"
        title = f"Means and scatter of {count}: {folder.resolve().name}"
        summary = summarise_set(document, quantities)[:1]
        write_page(aside / FILES[1], title, sections, command, summary, document["notes"])
    return folder / FILES[1]


def summarise_set(document: Mapping[str, Any], quantities: Mapping[str, CombinedQuantity]) -> list[str]:
    """Summarise a set in lines for a terminal: how many collisions enter, then each quantity."""
    several = len(document["results"])
    out = ", ".join(f"{count} {status}" for status, count in document["left_out"].items())
    first = f"{document['used']} of {document['collisions']} collisions of {several} result{'s' * (several != 1)} enter"
    lines = [f"{first}; left out: {out}." if out else f"{first}."]
    for name, one in quantities.items():
        quantity, mean = find_quantity(name), one.mean
        value = _format(mean.coefficients[0], mean.std[0], quantity)
        unit = f" {quantity.unit}" if quantity.unit else ""
        slope = ""
        if one.slope is not None:
            slope = f", slope {_format(one.slope.coefficients[1], one.slope.std[1], quantity)} per m/s"
        scatter = describe_scatter(one, quantity.factor)
        lines.append(f"  {quantity.plain_symbol:<7} {value:>12}{unit}, {scatter}{slope}, n {len(one.values)}")
    return lines


def find_quantity(name: str) -> Quantity:
    """Find symbol, unit and meaning of a quantity for the page of a set; its column where nothing is known."""
    return QUANTITIES.get(name) or Quantity(name, "", 1.0, "of estimates.parquet")


def _format(value: float, std: float, quantity: Quantity) -> str:
    return format_with_error(float(value) * quantity.factor, float(std) * quantity.factor)


def _means_table(quantities: Mapping[str, CombinedQuantity]) -> PageTable:
    heads = ["symbol", "unit", "n", "mean", "95 %", "scatter τ", "τ, 95 %", "slope per m/s", "p", "I²", "Birge ratio"]
    rows = []
    for name, one in quantities.items():
        quantity, mean, slope = find_quantity(name), one.mean, one.slope
        k = quantity.factor
        digits = max(1 - math.floor(math.log10(mean.std[0] * k)), 0)
        ends = f"{mean.low[0] * k:.{digits}f} to {mean.high[0] * k:.{digits}f}"
        spread = f"{format_number(mean.scatter_low * k, 2)} to {format_number(mean.scatter_high * k, 2)}"
        lines = ["–", "–"]
        if slope is not None:
            lines = [_format(slope.coefficients[1], slope.std[1], quantity), format_number(slope.p_value[1], 2)]
        start = [typeset_symbol(quantity.symbol), quantity.unit, str(len(one.values))]
        value = _format(mean.coefficients[0], mean.std[0], quantity)
        middle = [value, ends, format_number(mean.scatter * k, 2), spread if mean.dof else "–"]
        rows.append([*start, *middle, *lines, format_percent(mean.i2), format_number(mean.birge)])
    note = "0.9027(12) means 0.9027 ± 0.0012, one standard error."
    return PageTable(heads, rows, "Random-effects means", note)


def _blocks(one: CombinedQuantity, caption: str) -> list[Block]:
    quantity = find_quantity(one.name)
    blocks: list[Block] = [PageFigure.of(draw_set(one), f"{one.name} of all collisions", caption)]
    if len(one.by_result) > 1:
        rows = []
        for name, fit in one.by_result.items():
            mean, scatter = _format(fit.coefficients[0], fit.std[0], quantity), fit.scatter * quantity.factor
            rows.append((name, str(len(fit.weights)), mean, format_number(scatter, 2)))
        note = "Results of one collision each cannot differ by more than the scatter of the collisions."
        if math.isfinite(one.difference_p):
            note = f"Probability of such differences, if there are none: {format_number(one.difference_p, 2)}."
        blocks.append(PageTable(["result", "n", "mean", "scatter τ"], rows, "Each result", note))
    known = one.values.dropna(subset=["influence"])
    if len(known):
        order = known["influence"].abs().sort_values(ascending=False, kind="stable").index[:5]
        lines = [
            (
                name_collision(row),
                str(row["fit"]),
                _format(row["value"], row["std"], quantity),
                f"{row['z']:.2f}",
                format_percent(row["weight"]),
                f"{row['mean_without'] * quantity.factor:.5g}",
                f"{row['influence']:+.2f}",
            )
            for _, row in known.loc[order].iterrows()
        ]
        heads = ["collision", "fit", "value", "z", "weight", "mean without it", "influence"]
        note = (
            "z: distance from the mean of the others in standard errors, with the scatter. Influence: change of the "
            "mean by this collision, in errors of the mean."
        )
        blocks.append(PageTable(heads, lines, "Most influential collisions", note))
    return blocks


def _chi2_blocks(fit: Mapping[str, Any]) -> list[Block]:
    if not fit["dof"]:
        return ["No collision has a free fit that is ok and shows the ends of both slides."]
    rows = [
        [typeset_symbol(QUANTITIES[name].symbol), format_with_error(fit[name], fit[f"{name}_std"])]
        for name in ("r", "mu_k", "C")
    ]
    note = f"χ²/dof {fit['chi2'] / fit['dof']:.3g}, dof {fit['dof']}."
    return [CHI2, PageTable(["symbol", "value"], rows, "", note)]


def draw_set(one: CombinedQuantity) -> Figure:
    """Draw the forest plot, the funnel plot and the values against v_n."""
    named = len(one.values) <= 40  # of a forest plot, whose collisions then have a name
    rows = len(one.values) + len(one.by_result) * (len(one.by_result) > 1) + 2
    height = float(np.clip(0.7 + (0.17 if named else 0.06) * rows, 3.6, 9.5))
    figure, (forest, funnel, line) = make_axes(1, 3, figsize=(11.2, height), width_ratios=[1.5, 1, 1])
    quantity = find_quantity(one.name)
    label = f"{quantity.formula} / ({quantity.unit})" if quantity.unit else quantity.formula
    _draw_forest(forest, one, quantity, label, named)
    _draw_funnel(funnel, one, quantity, label)
    _draw_slope(line, one, quantity, label)
    return figure


def _draw_forest(axes: Axes, one: CombinedQuantity, quantity: Quantity, label: str, named: bool) -> None:
    k, mean = quantity.factor, one.mean
    middle, low, high = (float(ends[0]) * k for ends in (mean.coefficients, mean.low, mean.high))
    values = one.values.sort_values("v_n", kind="stable", ascending=False)
    height = np.arange(len(values))
    if np.isfinite(mean.prediction):
        axes.axvspan(middle - mean.prediction * k, middle + mean.prediction * k, color="0.93", lw=0)
    axes.axvspan(low, high, color="0.8", lw=0)
    size = 6 + 60 * values["weight"].to_numpy(float).clip(0) / values["weight"].max()
    for fit, colour in COLOURS.items():
        rows = (values["fit"] == fit).to_numpy()
        if rows.any():
            at, std = (values[column].to_numpy(float)[rows] * k for column in ("value", "std"))
            axes.errorbar(at, height[rows], xerr=std, fmt="none", ecolor=colour, lw=0.8)
            marks = size[rows] if named else 8
            axes.scatter(at, height[rows], s=marks, marker="s", color=colour, label=f"{fit} fit", zorder=3)
    ticks: dict[float, str] = {}
    if named:
        ticks |= {float(at): f"{row.result} {row.clip}.{row.collision}" for at, row in enumerate(values.itertuples())}
    below = -1.0
    for name, group in one.by_result.items() if len(one.by_result) > 1 else ():
        at_mean, ends = float(group.coefficients[0]), (float(group.low[0]), float(group.high[0]))
        half = [[(at_mean - ends[0]) * k], [(ends[1] - at_mean) * k]]
        axes.errorbar([at_mean * k], [below], xerr=half, fmt="D", ms=5, color="0.35", lw=1.2)
        ticks[below], below = name, below - 1
    below -= 0.5
    ticks[below] = "mean"
    axes.fill([low, middle, high, middle], [below, below + 0.4, below, below - 0.4], color="0.1", zorder=4)
    axes.set_yticks(list(ticks), list(ticks.values()), fontsize=7)
    ends_of_bars = np.concatenate([values["value"] - values["std"], values["value"] + values["std"]]) * k
    first, last = (float(end) for end in np.percentile(ends_of_bars, [1, 99] if len(values) > 20 else [0, 100]))
    if len(values) > 2:  # with two, Student's t makes the interval twelve times as wide as their errors
        first, last = min(first, low), max(last, high)
    axes.set_xlim(first - 0.08 * (last - first), last + 0.08 * (last - first))
    axes.set(xlabel=label, ylim=(below - 1, len(values)))
    axes.locator_params(axis="x", nbins=5)
    value = _format(mean.coefficients[0], mean.std[0], quantity)
    axes.set_title(f"mean {value}, {describe_scatter(one, k)}", fontsize=8)
    axes.legend(fontsize=7, loc="best")


def _draw_funnel(axes: Axes, one: CombinedQuantity, quantity: Quantity, label: str) -> None:
    k, mean = quantity.factor, one.mean
    std = one.values["std"].to_numpy(float) * k
    middle, grid = mean.coefficients[0] * k, np.linspace(0, 1.08 * std.max(), 200)
    for fit, colour in COLOURS.items():
        rows = (one.values["fit"] == fit).to_numpy()
        axes.plot(one.values["value"][rows] * k, std[rows], "o", color=colour, ms=3.5, mfc="white")
    for scatter, style in ((0.0, "-"), (np.nan_to_num(mean.scatter) * k, "--")):
        for sign in (-1, 1):
            axes.plot(middle + sign * 1.96 * np.hypot(grid, scatter), grid, style, color="0.5", lw=0.9)
    axes.axvline(middle, color="0.2", lw=0.9)
    axes.set(xlabel=label, ylabel=f"standard error{f' / ({quantity.unit})' if quantity.unit else ''}")
    axes.set_ylim(grid[-1], 0)
    axes.locator_params(axis="x", nbins=3)  # long numbers, narrow axes
    axes.set_title("funnel", fontsize=8)


def _draw_slope(axes: Axes, one: CombinedQuantity, quantity: Quantity, label: str) -> None:
    k, values = quantity.factor, one.values
    for fit, colour in COLOURS.items():
        part = values[values["fit"] == fit]
        if part["v_n"].notna().any():
            speed, value, std = (part[column].to_numpy(float) for column in ("v_n", "value", "std"))
            axes.errorbar(speed, value * k, std * k, fmt="o", ms=3, lw=0.7, mfc="white", color=colour)
    if one.slope is not None:
        grid = np.linspace(values["v_n"].min(), values["v_n"].max(), 100)
        (start, slope), (start_std, slope_std) = one.slope.coefficients, one.slope.std
        middle, error = start + slope * (grid - one.speed), np.hypot(start_std, slope_std * (grid - one.speed))
        axes.plot(grid, middle * k, "-", color="0.2", lw=1)
        axes.fill_between(grid, (middle - error) * k, (middle + error) * k, color="0.7", alpha=0.5, lw=0)
        axes.set_title(f"slope {_format(slope, slope_std, quantity)} per m/s", fontsize=8)
    axes.set(xlabel="$v_n$ / (m/s)", ylabel=label)
