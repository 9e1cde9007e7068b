"""A page for each recording: the answer, the film with the tracks drawn on it, figures, warnings, how it was made."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from synthcam_shared.outputs import write_atomically
from tracker.camera.camera import Camera
from tracker.camera.frames import Frames
from tracker.detection.link import Tracks
from tracker.measurement.collision.adequacy import MEASURED, warnings
from tracker.measurement.positions import to_ball_tracks
from tracker.report.collision_figures import (
    CollisionView,
    all_tracks_figure,
    energy_figure,
    residuals_figure,
    separation_figure,
    speed_figure,
    tracks_figure,
)
from tracker.report.estimates_text import (
    KINDS,
    QuantityLine,
    describe_fit,
    describe_frames,
    describe_status,
    list_quantities,
)
from tracker.report.html import HERE, describe_creation, embed_figure, make_data_uri, render
from tracker.report.overlay import RATE, Overlay, choose_frames, encode_mp4

PAGE, FILM = "index.html", "overlay.mp4"
MOST_FRAMES = 750  # of the film on a page
NO_FILM = "Tracks only: they came without a film."
CAPTIONS = {
    "tracks": "The tracks of both balls, and the moment of contact enlarged. Errors are smaller than the lines.",
    "residuals": "Measured position less the tied fit, with one standard error. Dotted: the contact, and the ends of "
    "both slides. Where the model holds, the residuals scatter about zero as far as their errors say.",
    "separation": "Separation of the centres against time; below, what the tied fit leaves over.",
    "energy": "Translational energy against time, from differences of neighbouring frames less what noise adds. "
    "Dashed: what the impact alone would leave of a head-on hit. Sliding takes the rest.",
    "speed": "Speed of each ball, from differences of neighbouring frames.",
    "to_ball_tracks": "All tracks as they lie in the picture.",
}


@dataclass(frozen=True)
class RecordingPage:
    """One recording and what was measured of it, as its page shows it.

    rows: of estimates, one a collision; motion: as in motion.parquet; frames: None of tracks made elsewhere; name: of
    the recording; notes: what was assumed or converted.
    """

    name: str
    camera: Camera
    tracks: Tracks
    rows: Sequence[Mapping[str, Any]]
    motion: pd.DataFrame
    frames: Frames | None = None
    notes: Sequence[str] = ()


def write_page(recorded: RecordingPage, folder: Path, command: str) -> Path:
    """Write FOLDER/index.html, and FOLDER/overlay.mp4, the film that is also within the page.

    Parameters
    ----------
    recorded : Recorded
    folder : Path
        Made where it is missing.
    command : str
        What the page says that made it.

    Returns
    -------
    Path
        Of index.html.
    """
    folder.mkdir(parents=True, exist_ok=True)
    film, steps, span = b"", list[dict[str, Any]](), (0, 0)
    if recorded.frames is not None:
        contacts = [row["t_c"] * recorded.camera.fps for row in recorded.rows if _is_measured(row)]
        span = choose_frames(len(recorded.frames), contacts, MOST_FRAMES)
        film = encode_mp4(Overlay(recorded.frames, recorded.tracks, recorded.camera, *span, list_events(recorded.rows)))
        steps = list_frames(recorded, *span)
        write_atomically(folder / FILM, film)
    estimates = pd.DataFrame([{"clip": 0, **row} for row in recorded.rows])
    html = render(
        HERE / "page.html",
        recorded=recorded,
        collisions=[_collision_content(row, recorded) for row in recorded.rows],
        kinds=list(KINDS.values()),
        frames_of=describe_frames,
        overview={name: (embed_figure(figure), CAPTIONS[name]) for name, figure in draw_overview(recorded).items()},
        warnings=[*warnings(estimates), *recorded.notes],
        film=make_data_uri(film, "video/mp4") if film else "",
        steps=json.dumps(steps).replace("<", "\\u003c"),  # within a script
        span=span,
        rate=RATE,
        no_film=NO_FILM,
        made=describe_creation(command),
    )
    write_atomically(folder / PAGE, html)
    return folder / PAGE


def list_events(rows: Iterable[Mapping[str, Any]]) -> tuple[tuple[float, str], ...]:
    """What happens when (s), in order: contacts, and the ends of the slides."""
    found = []
    for row in filter(_is_measured, rows):
        ends = [(row[f"tau{ball}"], f"ball {ball} rolls again") for ball in (1, 2)]
        found += [(row["t_c"], "after the contact"), *((row["t_c"] + tau, said) for tau, said in ends)]
    return tuple(sorted((float(t), said) for t, said in found if np.isfinite(t)))


def list_frames(recorded: RecordingPage, first: int, last: int) -> list[dict[str, Any]]:
    """What the page lists of each frame shown: for each ball its position, errors, residuals (µm) and flags."""
    off = _residuals(recorded)
    tracks, out = recorded.tracks, []
    for k in range(first, last + 1):
        balls = []
        for row in np.flatnonzero(tracks.frame == k):
            particle = int(tracks.particle[row])
            sides = [f"{v:.3f}" for v in (tracks.x[row], tracks.y[row])]
            errors = [f"{np.sqrt(tracks.cov[row, a, a]):.3f}" for a in (0, 1)]
            rest = [f"{v:.1f}" for v in off.get((particle, k), ())] or ["–", "–"]
            balls.append([particle, *sides, *errors, f"{tracks.flux[row]:.4g}", *rest, str(tracks.flags[row])])
        out.append({"frame": k, "balls": balls})
    return out


def draw_overview(recorded: RecordingPage) -> dict[str, Figure]:
    """The figures of the whole recording."""
    out = {}
    if len(recorded.motion):
        contacts = [float(row["t_c"]) for row in recorded.rows if _is_measured(row)]
        out["speed"] = speed_figure(recorded.motion, contacts)
    if len(recorded.tracks):
        out["to_ball_tracks"] = all_tracks_figure(recorded.tracks, recorded.camera)
    return out


def measured_collision(row: Mapping[str, Any], recorded: RecordingPage) -> CollisionView | None:
    """A collision with its balls' to_ball_tracks; None where the tied fit does not say everything."""
    if not _is_measured(row):
        return None
    course = {c.particle: c for c in to_ball_tracks(recorded.tracks, recorded.camera)}
    balls = {k: course[int(row[f"particle{k}"])] for k in (1, 2)}
    one = CollisionView(0, pd.Series(row), balls, recorded.camera)
    return one if np.isfinite(one.parameters).all() else None


def _is_measured(row: Mapping[str, Any]) -> bool:
    return row["status"] in MEASURED


def _collision_content(
    row: Mapping[str, Any], recorded: RecordingPage
) -> tuple[Mapping[str, Any], str, str, list[QuantityLine], Any]:
    """A collision for the template: row, what it is, how well it fits, its quantities, its figures."""
    one = measured_collision(row, recorded)
    figures = {}
    if one is not None:
        drawn = {
            "tracks": tracks_figure(one),
            "residuals": residuals_figure(one),
            "separation": separation_figure(one),
            "energy": energy_figure(one, recorded.tracks, recorded.camera),
        }
        figures = {name: (embed_figure(figure), CAPTIONS[name]) for name, figure in drawn.items()}
    return row, describe_status(row), describe_fit(row), list_quantities(row), figures


def _residuals(recorded: RecordingPage) -> dict[tuple[int, int], tuple[float, float]]:
    """By particle and frame: position less the tied fit of the first collision that has one, µm, along x and y."""
    out: dict[tuple[int, int], tuple[float, float]] = {}
    for row in recorded.rows:
        one = measured_collision(row, recorded)
        for ball, course in one.balls.items() if one is not None else ():
            off = (course.position - one.predict(ball, course.start)) * 1e6  # type: ignore[union-attr]
            for frame, (x, y) in zip(course.frame.tolist(), off.tolist(), strict=True):
                out.setdefault((course.particle, frame), (x, y))
    return out
