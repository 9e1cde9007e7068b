"""REPORT/index.html of a score: errors against the truth, in figures and tables, on a self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from synthcam_shared.report.numbers import format_number, format_percent
from synthcam_shared.report.page import Block, PageFigure, PageSection, PageTable, make_axes, write_page
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.report.collision_figures import CollisionView, draw_energy, draw_frame, draw_separation, draw_tracks
from tracker.report.estimates_text import METHODS
from tracker.report.pages import CAPTIONS
from tracker.report.quantities import QUANTITIES
from tracker.results import read_clip
from tracker.scoring.external_tables import MEASURES
from tracker.scoring.score import DetectorScore, format_ratio

POSITION_HEADS = ("balls found", "missed", "false", "rmse / px", "bound / px", "rmse / bound", "phase bias / px")
COLOURS = {"": "#14508c", "_free": "#c1440e", "_local": "#6a3d9a", "_paper": "#5b7f1c"}  # by the suffix of a column
FIGURES = {
    "frame": (
        "Frame after the contact",
        "A frame just after the contact, with its detections. The glint is not at the centre of the ball: lamp, camera "
        "and position decide where it is. The measured centre is corrected for that.",
    ),
    "tracks": ("Tracks of both balls", f"{CAPTIONS['tracks']} (As figure 2 of Painter & Behringer, 2000.)"),
    "separation": (
        "Separation of the balls",
        f"{CAPTIONS['separation']} Dotted: the contact, and the ends of both slides. (As figure 3 of Painter & "
        "Behringer, 2000.)",
    ),
    "energy": ("Translational energy", CAPTIONS["energy"]),
    "tied": (
        "Errors of the tied fit",
        "Tied fit, one physical model of impact, sliding and rolling: estimate minus truth with one standard error, "
        "against the speed of the striker.",
    ),
    "free": (
        "Errors of the free fit",
        "Free fit, with any velocities and slide times after the impact: estimate minus truth. A clip is left out "
        "where the fit does not determine a quantity.",
    ),
    "local": (
        "Errors of the local estimate",
        "Local estimate, free motion near the contact without a law of the impact: estimate minus truth. Its errors "
        "hold for real tracks, whose velocities have errors beyond the residuals; simulated tracks lack these.",
    ),
    "honesty": (
        "Errors over standard errors",
        "Errors divided by their claimed standard errors, all quantities together. Correct error bars follow the "
        "curve. Those of the local estimate are wider on simulated tracks, because they allow for errors of real ones.",
    ),
    "paper": (
        "Errors of finite differences",
        "Finite differences at the frame of least separation, as in Painter & Behringer (2000). Restitution is too "
        "low, most for slow balls, because sliding has already changed the velocities in that frame.",
    ),
}


def write_report(
    score: DetectorScore, results: Path | str, dataset: Path | str, report: Path | str, command: str = "tracker score"
) -> Path:
    """Write the page of a score, REPORT/index.html, one self-contained file, and return its path.

    results, dataset: tracks and pictures of the example clip are read here. The page says so where there is no video or
    no collision. command: that which made the page.
    """
    figures = {
        name: PageFigure.of(figure, *FIGURES[name])
        for name, figure in draw_score_figures(score, Path(results), Path(dataset)).items()
    }
    clip = choose_example_clip(score)
    if clip is None:
        misfits = score.statuses.get("misfit", 0)
        why = (
            f"The tied fit describes the collision of no clip ({misfits} misfits). The tracks reject two equal balls "
            "that roll, collide and slide. The tied fit therefore claims no errors and is not scored; the free fit "
            "assumes no law for the impact."
            if misfits
            else "No clip shows a collision that could be measured."
        )
        example: list[Block] = [why]
    else:
        example = [] if "frame" in figures else ["There is no picture, because the dataset holds no video."]
        example += [figures[name] for name in ("frame", "tracks", "separation", "energy") if name in figures]
    counts = [f"{count} {status}" for status, count in score.statuses.items() if status != "n"]
    summary = f"Dataset {score.suite}, detector {score.detector}. {score.statuses['n']} clips: {', '.join(counts)}."
    if score.ms_per_frame is not None:
        summary += f" {score.ms_per_frame:.2f} ms per frame."
    sections = [
        PageSection("Positions and tracks", make_position_tables(score)),
        PageSection("Example of a collision" + ("" if clip is None else f": clip {clip}"), example),
        PageSection(
            "Estimates minus truth", [figures[n] for n in ("tied", "free", "local", "honesty", "paper") if n in figures]
        ),
        PageSection("Accuracy of each quantity", make_quantity_tables(score)),
    ]
    return write_page(Path(report) / "index.html", "Tracker results against the truth", sections, command, [summary])


def draw_score_figures(score: DetectorScore, results: Path, dataset: Path) -> dict[str, Figure]:
    """Draw the figures of a score's page that the data allow, by name."""
    out: dict[str, Figure] = {}
    clip = choose_example_clip(score)
    if clip is not None:
        tracks, camera = read_clip(results, clip)
        row = score.table[score.table["clip"] == clip].iloc[0]
        view = CollisionView.of(row, tracks, camera)
        spots = _detections_after_contact(results, clip, view)
        frame = int(spots["frame"].iloc[0])
        image = _read_picture(dataset, clip, frame)
        if image is not None:
            out["frame"] = draw_frame(image, spots, frame, camera)
        out["tracks"] = draw_tracks(view)
        out["separation"] = draw_separation(view)
        out["energy"] = draw_energy(view, tracks)
        for name, method in (("tied", ""), ("free", "_free"), ("local", "_local"), ("paper", "_paper")):
            if measured := list_measured(score.table, method):
                out[name] = draw_quantity_errors(score.table, method, measured)
        out["honesty"] = draw_error_bars(score.table)
    return out


def choose_example_clip(score: DetectorScore, typical_speed: float = 0.3) -> int | None:
    """Choose the example on the page of a score: a clip of typical speed (m/s) whose tied fit gives every quantity."""
    table = score.table[score.table["status"] == "ok"]
    if len(table):
        table = table.dropna(subset=[n for n in QUANTITY_NAMES if n in table and n != "final_angle"])
    if not len(table):
        return None
    nearest = int(np.argmin(np.abs(table["v0"].to_numpy(float) - typical_speed)))
    return int(table["clip"].to_numpy(int)[nearest])


def make_position_tables(score: DetectorScore) -> list[PageTable]:
    """Make the tables on the page of a score with errors of positions and measures of tracking."""
    note = (
        "Errors of x and y, over all balls that are wholly in view. Bound: the Cramér-Rao bound, the smallest standard "
        "deviation of an unbiased estimate. The ratio has its sampling error in brackets, for independent errors. "
        "Phase bias: peak-to-peak error that follows the position of the glint within its pixel."
    )
    return [
        PageTable(list(POSITION_HEADS), [format_positions(score.localisation)], "Positions", note),
        PageTable(
            list(score.tracking),
            [[format_number(value, 5) for value in score.tracking.values()]],
            "Tracks, gate 5 px",
            "; ".join(f"{name}: {meaning}" for name, meaning in MEASURES.items()) + ".",
        ),
    ]


def format_positions(where: Mapping[str, Any]) -> list[str]:
    """Format the errors of positions for the page of a score, in the order of `POSITION_HEADS`."""
    keys = ("n", "missed", "false", "rmse_px", "bound_px", "ratio", "phase_bias_px")
    return [format_ratio(where, 2) if key == "ratio" else format_number(where[key]) for key in keys]


def make_quantity_tables(score: DetectorScore) -> list[PageTable]:
    """Make a table for the page of a score with the errors of all quantities, for each method that has any."""
    heads = ["quantity", "unit", "clips", "bias", "rmse", "bound", "rmse / bound", "z mean", "z sd", "68 %", "95 %"]
    note = (
        "z: error over claimed standard error; its sd is 1 where error bars are correct. Bound: Cramér-Rao bound of "
        "the fit at the true motion, root mean square over the clips. In brackets is the sampling error of the "
        "ratio from the number of clips. A ratio below 1 by a few of these errors agrees with the bound. 68 %, 95 %: "
        "share of clips within 1 and 1.96 standard errors."
    )
    tables: list[PageTable] = []
    for suffix, method in METHODS.items():
        rows = []
        for name in QUANTITY_NAMES:
            values = score.quantities.get(f"{name}{suffix}")
            if values is None or not values["n"]:
                continue
            quantity = QUANTITIES[name]
            errors = [format_number(values[key] * quantity.error_factor) for key in ("bias", "rmse", "bound")]
            spread = [format_number(values[key]) for key in ("z_mean", "z_std")]
            covered = [format_percent(values[key]) for key in ("cover68", "cover95")]
            start = [f"{name}{suffix}", quantity.error_unit, str(values["n"])]
            rows.append([*start, *errors, format_ratio(values), *spread, *covered])
        if rows:
            tables.append(PageTable(heads, rows, method.capitalize(), "" if tables else note))
    return tables


def _detections_after_contact(results: Path, clip: int, view: CollisionView) -> pd.DataFrame:
    """Detections in the frame nearest to two frames after the contact in which both balls are detected."""
    table = pd.read_parquet(results / "clips" / f"{clip:06d}" / "tracks.parquet")
    wanted = view.row["t_c"] * view.camera.fps + 2
    balls = table.groupby("frame")["particle"].nunique()
    both = balls.index[balls.to_numpy() >= 2].to_numpy()
    frame = int(both[np.argmin(np.abs(both - wanted))])
    return table[table["frame"] == frame]


def _read_picture(dataset: Path, clip: int, frame: int) -> Array | None:
    path = dataset / "clips" / f"{clip:06d}" / "frames.tif"
    if not path.is_file():
        return None
    try:
        return np.asarray(tifffile.imread(path, key=frame), dtype=np.float64)
    except Exception as error:  # decoders raise errors of many types
        raise InputError(f"{path}: damaged ({' '.join(str(error).split())[:120]})") from None


def list_measured(table: pd.DataFrame, kind: str) -> list[str]:
    """List the quantities that a method measures in any clip; kind: as in `draw_quantity_errors`."""
    return [name for name in QUANTITY_NAMES if _claims(table, name, kind) is not None]


def draw_quantity_errors(table: pd.DataFrame, kind: str, names: Sequence[str]) -> Figure:
    """Draw estimate minus truth with error bars against v0, one panel for each quantity of `list_measured`.

    kind: "" for the tied fit, "_free" for the free fit, "_local" for the local estimate, "_paper" for finite
    differences.
    """
    columns, rows = 4, -(-len(names) // 4)
    height = 1.9 * rows + 0.3
    figure = Figure(figsize=(10.2, height))
    figure.subplots_adjust(0.055, 0.5 / height, 0.99, 1 - 0.25 / height, wspace=0.3, hspace=0.32)
    panels = list[Axes]()
    for number, name in enumerate(names, 1):
        axes = figure.add_subplot(rows, columns, number, sharex=panels[0] if panels else None)
        panels.append(axes)
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
        axes.tick_params(labelsize=7, labelbottom=number + columns > len(names))
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


def _claims(table: pd.DataFrame, name: str, kind: str) -> tuple[Array, Array, Array] | None:
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
