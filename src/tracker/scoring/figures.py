"""All clips of a suite held to the truth, drawn."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tracker.measurement.collision.derived import QUANTITY_NAMES

Floats = NDArray[np.float64]

TIED_COLOUR, FREE_COLOUR, PAPER_COLOUR = "#14508c", "#c1440e", "#5b7f1c"
# name: (symbol, unit in which errors are shown, how many of it in one SI unit)
SHOWN: dict[str, tuple[str, str, float]] = {
    "v0": ("$v_0$", "mm/s", 1e3), "b": ("$b/2R$", "$10^{-3}$", 1e3), "t_c": ("$t_c$", "µs", 1e6),
    "r": ("$r$", "$10^{-3}$", 1e3), "s": ("$s$", "$10^{-3}$", 1e3), "mu_k": (r"$\mu_k$", "$10^{-3}$", 1e3),
    "C": ("$C$", "$10^{-3}$", 1e3), "tau1": (r"$\tau_1$", "µs", 1e6), "tau2": (r"$\tau_2$", "µs", 1e6),
    "v1f": ("$v_{1f}$", "mm/s", 1e3), "v2f": ("$v_{2f}$", "mm/s", 1e3),
    "energy_fraction": ("energy fraction", "$10^{-3}$", 1e3),
    "momentum_fraction": ("momentum fraction", "$10^{-3}$", 1e3),
    "final_angle": ("final angle", "mrad", 1e3), "drag": ("drag", "1/s", 1.0),
    "decel": ("decel", "mm/s²", 1e3), "w1n": (r"$\omega_{1n}$", "rad/s", 1.0),
    "w1t": (r"$\omega_{1t}$", "rad/s", 1.0), "w2n": (r"$\omega_{2n}$", "rad/s", 1.0),
    "w2t": (r"$\omega_{2t}$", "rad/s", 1.0),
}  # fmt: skip


def residual_figure(table: pd.DataFrame, kind: str) -> Figure:
    """Estimate - truth with error bars against v0, one panel a quantity; kind: "", "_free" or "_paper"."""
    colour = {"": TIED_COLOUR, "_free": FREE_COLOUR, "_paper": PAPER_COLOUR}[kind]
    names = [n for n in QUANTITY_NAMES if f"{n}_true" in table and _claims(table, n, kind) is not None]
    columns, rows = 4, max(1, -(-len(names) // 4))
    height = 1.9 * rows + 0.3
    figure = Figure(figsize=(10.2, height))
    figure.subplots_adjust(0.055, 0.5 / height, 0.99, 1 - 0.25 / height, wspace=0.3, hspace=0.32)
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True)).ravel()
    for axes, name in zip(panels, names, strict=False):
        symbol, unit, factor = SHOWN[name]
        claims = _claims(table, name, kind)
        assert claims is not None
        speed, off, std = claims
        axes.errorbar(speed * 100, off * factor, std * factor, fmt="o", ms=2, lw=0.7, color=colour, mfc="white")
        axes.axhline(0, color="0.2", lw=0.8)
        low, high = (float(np.percentile(off + sign * std, q)) * factor for sign, q in ((-1, 2), (1, 98)))
        low, high = min(low, 0.0), max(high, 0.0)
        axes.set_ylim(low - 0.2 * (high - low), high + 0.2 * (high - low))
        axes.set_title(f"{symbol}: error / {unit}", fontsize=9)
        axes.tick_params(labelsize=7)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    figure.supxlabel("$v_0$ / (cm/s)", fontsize=9)
    return figure


def error_bars_figure(table: pd.DataFrame) -> Figure:
    """Errors in units of the claimed standard error, all quantities together, against the normal law."""
    figure = Figure(figsize=(8.2, 3.0), layout="constrained")
    bins = np.linspace(-5, 5, 41)
    grid = np.linspace(-5, 5, 300)
    kinds = (("", TIED_COLOUR, "tied fit"), ("_free", FREE_COLOUR, "free fit"))
    for axes, (kind, colour, title) in zip(figure.subplots(1, 2, sharey=True), kinds, strict=True):
        z = [c[1][c[2] > 0] / c[2][c[2] > 0] for n in QUANTITY_NAMES if (c := _claims(table, n, kind)) is not None]
        values = np.concatenate([*z, np.empty(0)])
        axes.hist(values.clip(-5, 5), bins=bins.tolist(), density=True, color=colour, alpha=0.55)
        axes.plot(grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), "-", color="0.1", lw=1, label="normal law")
        axes.set(xlabel="error / claimed standard error", title=f"{title}, all quantities")
        axes.legend(fontsize=8)
    figure.axes[0].set_ylabel("density")
    return figure


def _claims(table: pd.DataFrame, name: str, kind: str) -> tuple[Floats, Floats, Floats] | None:
    """v0, error, standard error of the clips that claim a quantity; None if none does, or it is fixed."""
    columns = (f"{name}{kind}", f"{name}{kind}_std", f"{name}_true", "v0_true")
    if not set(columns) <= set(table.columns):
        return None
    value, std, true, speed = (table[c].to_numpy(float) for c in columns)
    use = np.isfinite(value) & np.isfinite(std) & np.isfinite(true) & (table["status"] == "ok").to_numpy()
    if not use.any() or not (std[use] > 1e-12).any():
        return None
    return speed[use], (value - true)[use], std[use]
