"""REPORT/index.html: what was measured, how far from the truth, and whether the error bars hold. Self-contained."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile
from matplotlib.figure import Figure
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import write_atomically
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.positions import to_ball_tracks
from tracker.report.collision_figures import (
    CollisionView,
    energy_figure,
    frame_figure,
    separation_figure,
    tracks_figure,
)
from tracker.report.html import describe_creation, embed_figure, render
from tracker.results import read_clip
from tracker.scoring.figures import SHOWN, error_bars_figure, residual_figure
from tracker.scoring.score import DetectorScore

Floats = NDArray[np.float64]
KINDS = {"": "tied fit", "_free": "free fit", "_paper": "the paper's differences"}
TYPICAL_SPEED = 0.3  # m/s; the clip shown is the one nearest to it
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def write_report(
    score: DetectorScore, results: Path | str, dataset: Path | str, report: Path | str, command: str = "tracker score"
) -> Path:
    """Write REPORT/index.html beside score.json: one self-contained file.

    Parameters
    ----------
    score : Score
    results, dataset : str or Path
        Where the tracks and the pictures of the clip shown are read. A dataset without video, or results without a
        collision, leave their figures out and say so.
    report : str or Path
        REPORT.
    command : str
        What the page says that made it.

    Returns
    -------
    Path
        Of index.html.
    """
    drawn = draw_figures(score, Path(results), Path(dataset))
    images = {name: embed_figure(figure) for name, figure in drawn.items()}
    values = {
        "tables": make_tables(score),
        "clip": choose_clip(score),
        "kinds": KINDS,
        "made": describe_creation(command),
    }
    html = render(Path(__file__).with_name("report.html"), score=score, images=images, **values)
    folder = Path(report)
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / "index.html", html)
    return folder / "index.html"


def draw_figures(score: DetectorScore, results: Path, dataset: Path) -> dict[str, Figure]:
    """The report's figures by name; those that the data do not allow are absent."""
    out: dict[str, Figure] = {}
    clip = choose_clip(score)
    if clip is not None:
        tracks, camera = read_clip(results, clip)
        row = score.table[score.table["clip"] == clip].iloc[0]
        course = {c.particle: c for c in to_ball_tracks(tracks, camera)}
        specimen = CollisionView(clip, row, {k: course[int(row[f"particle{k}"])] for k in (1, 2)}, camera)
        spots = _at_contact(results, clip, specimen)
        image = _picture(dataset, clip, int(spots["frame"].iloc[0]))
        if image is not None:
            out["frame"] = frame_figure(image, spots, int(spots["frame"].iloc[0]), camera)
        out["tracks"] = tracks_figure(specimen)
        out["separation"] = separation_figure(specimen)
        out["energy"] = energy_figure(specimen, tracks, camera)
        for name, kind in (("tied", ""), ("free", "_free"), ("paper", "_paper")):
            out[name] = residual_figure(score.table, kind)
        out["honesty"] = error_bars_figure(score.table)
    return out


def choose_clip(score: DetectorScore) -> int | None:
    """The clip looked at closely: the one nearest to TYPICAL_SPEED whose tied fit gives everything."""
    table = score.table[score.table["status"] == "ok"]
    if len(table):
        table = table.dropna(subset=[n for n in QUANTITY_NAMES if n in table and n != "final_angle"])
    if not len(table):
        return None
    nearest = int(np.argmin(np.abs(table["v0"].to_numpy(float) - TYPICAL_SPEED)))
    return int(table["clip"].to_numpy(int)[nearest])


def make_tables(score: DetectorScore) -> dict[str, Any]:
    """Numbers for the template: rows of (label, unit, figures) by kind, as text."""
    out: dict[str, Any] = {}
    for kind in KINDS:
        rows = []
        for name in QUANTITY_NAMES:
            values = score.quantities.get(f"{name}{kind}")
            if values is None or not values["n"]:
                continue
            _, unit, factor = SHOWN[name]
            shown = {k: _text(values[k] * factor) for k in ("bias", "rmse", "bound")}
            shown |= {k: _text(values[k]) for k in ("ratio", "z_mean", "z_std")}
            shown |= {k: _percent(values[k]) for k in ("cover68", "cover95")}
            rows.append({"name": name, "unit": _plain_unit(unit), "n": values["n"], **shown})
        out[kind] = rows
    out["localisation"] = {k: _text(v) for k, v in score.localisation.items()}
    out["tracking"] = {k: _text(v, 5) for k, v in score.tracking.items()}
    return out


def _at_contact(results: Path, clip: int, specimen: CollisionView) -> pd.DataFrame:
    """Detections of the frame nearest to the contact in which both balls are seen, and both are apart."""
    table = pd.read_parquet(results / "clips" / f"{clip:06d}" / "tracks.parquet")
    camera = specimen.camera
    after = (specimen.row["t_c"] * camera.fps) + 2
    seen = table.groupby("frame")["particle"].nunique()
    both = seen.index[seen.to_numpy() >= 2].to_numpy()
    frame = int(both[np.argmin(np.abs(both - after))])
    return table[table["frame"] == frame]


def _picture(dataset: Path, clip: int, frame: int) -> Floats | None:
    path = dataset / "clips" / f"{clip:06d}" / "frames.tif"
    if not path.is_file():
        return None
    try:
        return np.asarray(tifffile.imread(path, key=frame), dtype=np.float64)
    except Exception as error:  # decoders raise their own kinds
        raise InputError(f"{path}: damaged ({' '.join(str(error).split())[:120]})") from None


def _text(value: float | None, digits: int = 3) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, int):
        return str(value)
    if value != 0 and (abs(value) < 1e-3 or abs(value) >= 1e5):
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa}·10{str(int(exponent)).translate(RAISED)}"
    return f"{value:.{digits}g}".replace("e+0", "e")


def _percent(value: float) -> str:
    return f"{100 * value:.0f} %" if math.isfinite(value) else "–"


def _plain_unit(unit: str) -> str:
    return unit.replace("$10^{-3}$", "10⁻³")
