"""REPORT: discrepancy.json, model.yaml and a self-contained index.html."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from discrepancy.find import Found
from discrepancy.fit import Fit
from discrepancy.forecast import forecast
from discrepancy.measured import Measured
from discrepancy.name import CLAIM
from synthcam.model import write_model

BEFORE, AFTER, FLOOR = "#b2182b", "#2166ac", "#4d4d4d"
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}


def write(found: Found, folder: Path, left_out: Sequence[str]) -> None:
    """Write the report into an existing, empty folder."""
    document = found.document()
    (folder / "discrepancy.json").write_text(json.dumps(_plain(document), indent=1, allow_nan=False) + "\n")
    write_model(found.model, folder / "model.yaml")
    with plt.rc_context(STYLE):
        figures = [_figure(title, draw(found), note) for title, draw, note in _FIGURES]
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(
        files("discrepancy").joinpath("report.html").read_text(encoding="utf-8")
    )
    (folder / "index.html").write_text(
        template.render(found=found, document=document, story=_story(found), figures=figures, left_out=left_out),
        encoding="utf-8",
    )


def _plain(value: Any) -> Any:
    """For JSON: no numpy, NaN as null."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value


def _story(found: Found) -> list[str]:
    """The search in five plain sentences."""
    gap, noise, base = found.shown.gap, found.noise, found.search.base
    speeds = [float(c.launch[3]) for c in found.clips]
    first = (
        f"{len(found.clips)} collisions at {min(speeds):.2f} to {max(speeds):.2f} m/s were fitted together; "
        f"{len(found.kept_out)} more were kept out of every fit."
    )
    second = (
        f"The tracks' own noise is {noise.scale:.2f} times what the tracker claims, with a correlation of "
        f"{noise.correlation:+.2f} from frame to frame; both were taken into account."
    )
    worst = found.where[0] if found.where else None
    third = (
        f"The base model leaves chi^2 = {base.chi2 / base.points:.3f} a point, and disagrees most with {worst.ball} "
        f"{worst.phase}, {worst.observable} its motion ({worst.sigma:.1f} sigma after {len(found.where)} looks)."
        if worst and worst.sigma > 0
        else f"The base model leaves chi^2 = {base.chi2 / base.points:.3f} a point and no place that stands out."
    )
    ranking = found.search.ranking
    fourth = (
        f"Of the {len(ranking)} candidates {ranking[0].effect} scores highest, {ranking[0].sigma:.1f} sigma; "
        f"{CLAIM:.0f} are needed for a claim."
        if ranking
        else "Every effect of the library is in the model and free already: there was no candidate."
    )
    um = f"{gap.before_um:.2f} um to {gap.after_um:.2f} um rms, where noise alone leaves {gap.floor_um:.2f} um"
    fifth = found.sentence() + (f" That is {um}." if found.search.named else "")
    return [first, second, third, fourth, fifth]


def _figure(title: str, figure: Figure, note: str) -> dict[str, str]:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, bbox_inches="tight", metadata={"Software": ""})
    plt.close(figure)
    return {"title": title, "note": note, "png": base64.b64encode(buffer.getvalue()).decode()}


def _residuals(found: Found) -> Figure:
    """rms of the held-out residuals against time since the contact, before and after, per ball."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 3), sharey=True, constrained_layout=True)
    for ball, ax in enumerate(axes):
        for now, colour, label in ((found.shown.before, BEFORE, "before"), (found.shown.after, AFTER, "after")):
            time, error = _stacked(found.kept_out, now, ball)
            edges = np.quantile(time, np.linspace(0, 1, 25))
            which = np.clip(np.searchsorted(edges, time, "right") - 1, 0, 23)
            bins = [k for k in range(24) if np.any(which == k)]
            rms = np.array([np.sqrt(np.mean(error[which == k] ** 2)) for k in bins])
            counts = np.array([2 * np.sum(which == k) for k in bins])
            centres = np.array([time[which == k].mean() for k in bins])
            spread = rms / np.sqrt(2 * counts)
            ax.errorbar(1e3 * centres, 1e6 * rms, 1e6 * spread, fmt="o", ms=3, lw=1, color=colour, label=label)
        ax.axhline(found.shown.gap.floor_um, color=FLOOR, lw=1, ls="--", label="noise")
        ax.axvline(0, color=FLOOR, lw=0.5)
        ax.set(xlabel="time since the contact (ms)", title=f"ball {ball + 1}")
    axes[0].set(ylabel="rms residual, each axis (um)", ylim=(0, None))
    axes[1].legend()
    return figure


def _stacked(clips: Sequence[Measured], now: Fit, ball: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    times, errors = [], []
    expected = forecast(now.model, now.launches, clips)
    for clip, launch, centres in zip(clips, now.launches, expected, strict=True):
        rows = clip.ball == ball
        left = (clip.xy - centres)[rows]
        times.append(clip.frame[rows] / clip.fps - launch[2])
        errors.append(np.sqrt((left**2).mean(axis=1)))
    return np.concatenate(times), np.concatenate(errors)


def _ranking(found: Found) -> Figure:
    ranking = found.search.ranking[::-1]
    figure, ax = plt.subplots(figsize=(6, 0.6 + 0.3 * len(ranking)), constrained_layout=True)
    claimed = {n.effect for n in found.search.named}
    colours = [AFTER if c.effect in claimed else "#bdbdbd" for c in ranking]
    ax.barh([c.effect for c in ranking], [c.sigma for c in ranking], color=colours)
    ax.axvline(CLAIM, color=BEFORE, lw=1, ls="--", label=f"needed for a claim, {CLAIM:.0f}")
    ax.set(xlabel="score against the base model (sigma)")
    if max((c.sigma for c in ranking), default=0.0) > 50:
        ax.set_xscale("symlog", linthresh=10)
    ax.legend(loc="lower right")
    return figure


def _kept_out(found: Found) -> Figure:
    figure, ax = plt.subplots(figsize=(6, 3), constrained_layout=True)
    speeds = [float(c.launch[3]) for c in found.kept_out]
    for now, colour, label in ((found.shown.before, BEFORE, "before"), (found.shown.after, AFTER, "after")):
        points = np.array([len(r) for r in now.residuals])
        chi2 = np.array([r @ r for r in now.residuals]) / points
        ax.errorbar(speeds, chi2, chi2 * np.sqrt(2 / points), fmt="o", ms=4, lw=1, color=colour, label=label)
    ax.axhline(found.shown.gap.floor, color=FLOOR, lw=1, ls="--", label="noise")
    _log_if_wide(ax, found.shown.gap.before / max(found.shown.gap.floor, 1e-9))
    ax.set(xlabel="speed before the contact (m/s)", ylabel="chi^2 a point, clips kept out")
    ax.legend()
    return figure


def _log_if_wide(ax: Axes, ratio: float) -> None:
    if ratio > 5:
        ax.set_yscale("log")


_FIGURES = (
    ("Residuals on collisions kept out", _residuals, "Shared parameters frozen, each clip's launch refitted."),
    ("Candidates", _ranking, "Score test of every effect of the library from the base fit alone."),
    ("The gap, clip by clip", _kept_out, "Collisions that no fit has seen."),
)
