"""Figures of the errors of all clips: estimate minus truth, and errors over standard errors."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from synthcam_shared.report.page import make_axes
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.report.quantities import QUANTITIES

Floats = NDArray[np.float64]

COLOURS = {"": "#14508c", "_free": "#c1440e", "_local": "#6a3d9a", "_paper": "#5b7f1c"}  # by the suffix of a column


def draw_quantity_errors(table: pd.DataFrame, kind: str) -> Figure:
    """Draw estimate minus truth with error bars against v0, one panel for each quantity.

    kind: "" for the tied fit, "_free" for the free fit, "_local" for the local estimate, "_paper" for finite
    differences.
    """
    names = [n for n in QUANTITY_NAMES if f"{n}_true" in table and _claims(table, n, kind) is not None]
    columns, rows = 4, max(1, -(-len(names) // 4))
    height = 1.9 * rows + 0.3
    figure = Figure(figsize=(10.2, height))
    figure.subplots_adjust(0.055, 0.5 / height, 0.99, 1 - 0.25 / height, wspace=0.3, hspace=0.32)
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True)).ravel()
    for axes, name in zip(panels, names, strict=False):
        quantity, factor = QUANTITIES[name], QUANTITIES[name].error_factor
        claims = _claims(table, name, kind)
        assert claims is not None
        speed, off, std = claims
        axes.errorbar(speed * 100, off * factor, std * factor, fmt="o", ms=2, lw=0.7, color=COLOURS[kind], mfc="white")
        axes.axhline(0, color="0.2", lw=0.8)
        low, high = (float(np.percentile(off + sign * std, q)) * factor for sign, q in ((-1, 2), (1, 98)))
        low, high = min(low, 0.0), max(high, 0.0)
        axes.set_ylim(low - 0.2 * (high - low), high + 0.2 * (high - low))
        axes.set_title(f"{quantity.formula}: error / {quantity.error_unit}", fontsize=9)
        axes.tick_params(labelsize=7)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    figure.supxlabel("speed of the striker, $v_0$ / (cm/s)", fontsize=9)
    return figure


def draw_error_bars(table: pd.DataFrame) -> Figure:
    """Draw a histogram of errors over standard errors, all quantities together, and the normal distribution."""
    figure, panels = make_axes(1, 3, figsize=(11.0, 3.0))
    bins = np.linspace(-5, 5, 41)
    grid = np.linspace(-5, 5, 300)
    kinds = (("", "tied fit"), ("_free", "free fit"), ("_local", "local estimate"))
    for axes, (kind, title) in zip(panels, kinds, strict=True):
        z = [c[1][c[2] > 0] / c[2][c[2] > 0] for n in QUANTITY_NAMES if (c := _claims(table, n, kind)) is not None]
        if z:
            values = np.concatenate(z).clip(-5, 5)
            axes.hist(values, bins=bins.tolist(), density=True, color=COLOURS[kind], alpha=0.55)
        else:
            axes.text(0.02, 0.97, "no clip has this estimate", transform=axes.transAxes, va="top", fontsize=8)
        axes.plot(
            grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), "-", color="0.1", lw=1, label="normal distribution"
        )
        axes.set(xlabel="error / claimed standard error", title=f"{title}, all quantities")
        if z:
            axes.legend(fontsize=8)
    figure.axes[0].set_ylabel("density")
    return figure


def _claims(table: pd.DataFrame, name: str, kind: str) -> tuple[Floats, Floats, Floats] | None:
    """v0, error and standard error of clips that measure a quantity; None where none does, or it is fixed."""
    columns = (f"{name}{kind}", f"{name}{kind}_std", f"{name}_true", "v0_true")
    if not set(columns) <= set(table.columns):
        return None
    value, std, true, speed = (table[c].to_numpy(float) for c in columns)
    use = np.isfinite(value) & np.isfinite(std) & np.isfinite(true)
    if kind != "_local":  # which holds for misfits too
        use &= (table["status"] == "ok").to_numpy()
    if not use.any() or not (std[use] > 1e-12).any():
        return None
    return speed[use], (value - true)[use], std[use]
