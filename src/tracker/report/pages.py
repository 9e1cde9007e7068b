"""The pages of RESULTS: one for each recording, and of several recordings a table that links to them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from synthcam_shared.outputs import as_input_error, write_atomically
from synthcam_shared.report.numbers import format_with_error
from synthcam_shared.report.page import (
    Block,
    PageFigure,
    PageSection,
    PageTable,
    make_data_uri,
    render,
    typeset_symbol,
    write_page,
)
from tracker import results
from tracker.camera.camera import Camera
from tracker.camera.frames import Frames
from tracker.camera.recordings import RecordingSource
from tracker.detection.link import Tracks
from tracker.measurement.collision.adequacy import CROWD, MEASURED
from tracker.measurement.crowd.contact_table import summarise_contacts, tabulate_contacts
from tracker.measurement.local.recommendation import find_recommended_suffix
from tracker.measurement.messages import list_messages
from tracker.notes import Note
from tracker.report import collision_figures as figures
from tracker.report import estimates_text as text
from tracker.report.overlay import Overlay, choose_frames, encode_mp4
from tracker.report.quantities import QUANTITIES
from tracker.report.refusals import REFUSALS
from tracker.results import rows_as_dicts

PAGE = "index.html"
CAPTIONS = {
    "tracks": "Tracks of both balls. Right: the balls at the moment of contact. Error bars are smaller than the lines.",
    "separation": "Distance between the centres of the balls against time. Below: measurement minus tied fit.",
    "energy": "Translational energy against time, from differences of neighbouring frames, corrected for noise. "
    "Dashed: energy that a head-on impact alone would leave. Sliding on the plate takes the rest.",
}
MODELS = (
    "The tied fit uses one physical model of impact, sliding and rolling. The free fit assumes no law for the impact. "
    "The local estimate assumes no law of the impact either, and no more than free motion near the contact."
)


@dataclass(frozen=True)
class RecordingPage:
    """The content of the page of one recording.

    rows: of estimates, one for each collision.
    motion: the table of motion.parquet.
    frames: None for tracks that came without a film.
    notes: assumptions and conversions.
    found_contacts: those of contacts.parquet; None: those of the tracks.
    """

    name: str
    camera: Camera
    tracks: Tracks
    rows: Sequence[Mapping[str, Any]]
    motion: pd.DataFrame
    frames: Frames | None = None
    notes: Sequence[Note] = ()
    refusals: bytes = b""  # a picture as PNG, of a film that failed
    found_contacts: pd.DataFrame | None = None

    @property
    def collisions(self) -> list[Mapping[str, Any]]:
        """The rows of collisions that were measured."""
        return [row for row in self.rows if row["status"] in MEASURED]

    def write(self, folder: Path, command: str) -> Path:
        """Write FOLDER/index.html, and FOLDER/overlay.mp4, the film that it also holds; return the path of the page."""
        fitted = [row for row in self.rows if row["status"] != CROWD]
        views = [figures.view_collision(row, self.tracks, self.camera) for row in fitted]
        results_tables = [block for row in fitted for block in self._results(row)]
        titles = [f"Collision {row['collision']}" for row in fitted]
        sections = [
            PageSection("", results_tables),
            *([self._refusals(folder)] if self.refusals else []),
            *([] if self.contacts.empty else [PageSection("Contacts", self._contacts())]),
            PageSection("How to read the table", [self._how_to_read()] if results_tables else []),
            PageSection("Film with measured positions", [self._film(folder, views)]),
            *(PageSection(title, self._figures(view)) for title, view in zip(titles, views, strict=True)),
            PageSection("Whole recording", self._overview()),
            PageSection("Camera settings used", [self._camera_table()]),
        ]
        summary = [] if self.contacts.empty else [text.describe_contact_count(self.contacts)]
        summary += [self._describe(row) for row in fitted]
        estimates = pd.DataFrame([{"clip": 0, **row} for row in self.rows])
        warnings = [*map(str, list_messages(estimates)), *map(str, self.notes)]
        return write_page(folder / PAGE, self.name, sections, command, summary, warnings)

    @cached_property
    def contacts(self) -> pd.DataFrame:
        """All contacts of a film of more than two balls."""
        found = self.found_contacts
        return tabulate_contacts(self.tracks, self.camera, self.rows) if found is None else found

    def _contacts(self) -> list[Block]:
        """The physics that the contacts share, and a table of them."""
        means = [
            (name, str(len(mean.weights)), format_with_error(mean.coefficients[0], mean.std[0]), f"{mean.scatter:.2g}")
            for name, mean in summarise_contacts(self.contacts, self.rows).items()
        ]
        shared = PageTable(["quantity", "contacts", "mean", "scatter"], means, "Random-effects means over the contacts")
        columns = {  # heads, and the number of their units in one SI unit
            "v_n": ("v_n / cm/s", 1e2),
            "r": ("r", 1.0),
            "mu_bb": ("mu_bb", 1.0),
            "impulse": ("impulse / cm/s", 1e2),
            "energy_lost": ("energy lost / cm²/s²", 1e4),
        }
        rows = []
        most = 300  # on a page; contacts.csv has all
        for row in self.contacts.head(most).to_dict("records"):
            other = "wall" if row["kind"] == "wall" else str(row["particle2"])
            at = format_with_error(1e3 * row["t_s"], 1e3 * row["t_s_std"])
            values = [format_with_error(f * row[name], f * row[f"{name}_std"]) for name, (_, f) in columns.items()]
            rows.append((str(row["contact"]), at, str(row["particle1"]), other, *values, row["why"]))
        heads = ["contact", "t / ms", "ball", "with", *(head for head, _ in columns.values()), "estimate"]
        title = "Contacts in order of time; impulse and energy per unit mass"
        return [*([shared] if means else []), PageTable(heads, rows, title)]

    def _how_to_read(self) -> str:
        straight = [str(row["collision"]) for row in self.collisions if text.is_straight(row)]
        which = f" of collision {', '.join(straight)}" if len(self.rows) > 1 else ""
        lines = f"Both fits{which} are straight lines after the contact, without a law of friction." if straight else ""
        models = MODELS if len(straight) < len(self.collisions) or not straight else ""
        models = " ".join(filter(None, [models, lines]))
        return (
            f"0.9027(12) means 0.9027 ± 0.0012, one standard error. A value without brackets claims no error. {models} "
            "Finite differences take velocities from neighbouring frames. If χ²/dof is near 1, the residuals of "
            "the tied fit are as large as the errors of the positions. The value p is the "
            "probability of a χ² at least as large."
        )

    def _describe(self, row: Mapping[str, Any]) -> str:
        number = f"Collision {row['collision']}{text.describe_frames(row)}: " if len(self.rows) > 1 else ""
        parts = [text.describe_status(row), text.describe_recommendation(row), text.describe_velocities(row)]
        parts += [text.describe_contact(row), text.describe_rolling(row), text.describe_fit(row)]
        return number + " ".join(f"{part}." for part in parts if part)

    def _refusals(self, folder: Path) -> PageSection:
        write_atomically(folder / REFUSALS, self.refusals)
        caption = "Green circles: balls that were found. Red boxes: what differs from the other frames and was refused."
        picture = PageFigure("Found and refused", make_data_uri(self.refusals, "image/png"), caption)
        return PageSection("Why this film could not be measured", [picture])

    def _results(self, row: Mapping[str, Any]) -> list[Block]:
        rows = [
            (typeset_symbol(q.symbol), q.meaning, q.unit, *values, Markup("<code>{}</code>").format(name))
            for name, q, values in text.list_quantities(row)
        ]
        title = f"Collision {row['collision']}" if len(self.rows) > 1 else ""
        if not rows:
            return []
        reasons = [f"– {reason}." for reason in text.explain_dashes(row)]
        methods = text.order_methods(row)
        late = [n for n in QUANTITIES if f"{n}_std" in row and text.is_extrapolated(row, n, "")]
        if late and "" in methods:
            reasons.append(
                "Extrapolated in the tied fit, because a ball slides for longer than it is seen, or may do so: "
                f"{', '.join(late)}."
            )
        table = PageTable(["symbol", "quantity", "unit", *methods.values(), "column"], rows, title)
        return [table, *([" ".join(reasons)] if reasons else [])]

    def _film(self, folder: Path, views: Sequence[figures.CollisionView | None]) -> str:
        if self.frames is None:
            return "The tracks came without a film."
        numbers = self.frames.numbers
        contacts = [float(np.searchsorted(numbers, row["t_c"] * self.camera.fps)) for row in self.collisions]
        first, last = choose_frames(len(self.frames), contacts)
        overlay = Overlay(self.frames, self.tracks, self.camera, first, last, list_page_events(self.collisions))
        film = encode_mp4(overlay)
        write_atomically(folder / "overlay.mp4", film)
        steps = json.dumps(self._list_frames(first, last, views)).replace("<", "\\u003c")  # safe within a script
        values = {"first": first, "last": last, "frames": len(self.frames), "rate": Overlay.rate, "steps": steps}
        template = Path(__file__).with_name("film.html")
        return Markup(
            render(template, film=make_data_uri(film, "video/mp4"), outlined=self.camera.knows_diameter, **values)
        )

    def _list_frames(
        self, first: int, last: int, views: Sequence[figures.CollisionView | None]
    ) -> list[dict[str, Any]]:
        """List for each frame of the film the balls: position, errors, light, residuals (µm) and flags."""
        residuals = figures.list_residuals(views)
        tracks, steps = self.tracks, []
        shown = self.frames.numbers[first : last + 1] if self.frames is not None else range(first, last + 1)
        for k in map(int, shown):
            balls = []
            for row in np.flatnonzero(tracks.frame == k):
                particle = int(tracks.particle[row])
                position = [f"{v:.3f}" for v in (tracks.x[row], tracks.y[row])]
                errors = [f"{np.sqrt(tracks.cov[row, axis, axis]):.3f}" for axis in (0, 1)]
                off = [f"{1e6 * v:.1f}" for v in residuals.get((particle, k), ())] or ["–", "–"]
                balls.append([particle, *position, *errors, f"{tracks.flux[row]:.4g}", *off, str(tracks.flags[row])])
            steps.append({"frame": k, "balls": balls})
        return steps

    def _figures(self, view: figures.CollisionView | None) -> list[Block]:
        if view is None:
            return []
        tracks = PageFigure.of(figures.draw_tracks(view), "Tracks of both balls", CAPTIONS["tracks"])
        if not view.is_instantaneous:
            return [tracks]
        residuals = (
            "Residuals: measured position minus tied fit, with one standard error. Dotted: the contact, and the ends "
            "of both slides. If the model is right, the residuals scatter about zero by their errors."
        )
        return [
            tracks,
            PageFigure.of(figures.draw_residuals(view), "Residuals of the tied fit", residuals),
            PageFigure.of(figures.draw_separation(view), "Separation of the balls", CAPTIONS["separation"]),
            PageFigure.of(figures.draw_energy(view, self.tracks), "Translational energy", CAPTIONS["energy"]),
        ]

    def _overview(self) -> list[Block]:
        blocks: list[Block] = []
        if len(self.motion):
            figure = figures.draw_speeds(self.motion, [float(row["t_c"]) for row in self.collisions])
            caption = "Speed of each ball, from differences of neighbouring frames."
            blocks.append(PageFigure.of(figure, "Speed against time", caption))
        if len(self.tracks):
            figure = figures.draw_all_tracks(self.tracks, self.camera)
            blocks.append(PageFigure.of(figure, "All tracks", "All tracks in the picture."))
        return blocks

    def _camera_table(self) -> PageTable:
        camera = self.camera
        rows = [("picture", f"{' × '.join(map(str, camera.size))} px")]
        if camera.metric:
            rows += [("frame rate", f"{camera.fps:g} /s"), ("scale", f"{1e6 * camera.scale:.4g} µm/px")]
            if camera.knows_diameter:
                size = f"{1e3 * camera.ball_diameter:.4g} mm, {camera.diameter_px:.3g} px"
                rows.append(("diameter of a ball", size))
            rows.append(("exposure", f"{1e3 * camera.exposure:.3g} ms"))
        return PageTable(["setting", "value"], rows)


def list_page_events(rows: Iterable[Mapping[str, Any]]) -> tuple[tuple[float, str], ...]:
    """List the events on the page of a recording by time (s): contacts, and the ends of the slides."""
    events = []
    for row in rows:
        events.append((row["t_c"], "after the contact"))
        events += [(row["t_c"] + row[f"tau{ball}"], f"ball {ball} rolls again") for ball in (1, 2)]
    return tuple(sorted((float(time), event) for time, event in events if np.isfinite(time)))


@dataclass(frozen=True)
class ResultPages:
    """The pages of one RESULTS. Cheap to send to another process.

    numbers: of the clips.
    source: their films, in this order; None for tracks that another program made.
    name: of the dataset or the table.
    notes: assumptions and conversions.
    command: that which made the pages.
    """

    output: Path
    numbers: Sequence[int]
    source: RecordingSource | None
    name: str
    notes: Sequence[Note]
    command: str

    @property
    def is_single(self) -> bool:
        """True where there is one recording; its page is RESULTS/index.html."""
        return len(self.numbers) == 1

    def missing(self) -> list[int]:
        """Indices of the recordings that have no page yet."""
        return [i for i in range(len(self.numbers)) if not (self._folder(i) / PAGE).is_file()]

    def write(self, index: int) -> None:
        """Write the page of one recording."""
        number = self.numbers[index]
        tracks, camera = results.read_clip(self.output, number)
        folder = results.clip_folder(self.output, number)
        rows = rows_as_dicts(results.make_estimates_table(results.load_json(folder / "estimates.json")))
        motion = pd.read_parquet(folder / "motion.parquet")
        frames = None if self.source is None else self.source.open_clip(index).frames
        name = self.name if self.is_single else f"{self.name}, clip {number}"
        with as_input_error(self.output):
            refusals = (folder / REFUSALS).read_bytes() if (folder / REFUSALS).is_file() else b""
            contacts = results.read_contact_table(self.output, number)
            page = RecordingPage(name, camera, tracks, rows, motion, frames, self.notes, refusals, contacts)
            page.write(self._folder(index), self.command)

    def write_overview(self, estimates: pd.DataFrame) -> None:
        """Write the table that links to the pages of several recordings."""
        if self.is_single:
            return
        names = ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction")
        rows = []
        for row in rows_as_dicts(estimates):
            link = Markup('<a href="clips/{}/index.html">{}</a>').format(f"{row['clip']:06d}", row["clip"])
            quality = f"{row['chi2'] / row['dof']:.3g}" if row["dof"] else ""
            values = [text.format_value(row, f"{name}{find_recommended_suffix(row)}") for name in names]
            state = (row["collision"], row["status"], row.get("recommended", ""), quality)
            rows.append((link, *state, *values, row["flags"].replace("|", ", ")))
        known = [QUANTITIES[name] for name in names]
        symbols = [typeset_symbol(q.symbol) + (f" / {q.unit}" if q.unit else "") for q in known]
        heads = ["clip", "collision", "status", "estimate", "χ²/dof", *symbols, "flags"]
        table = PageTable(heads, rows, "Recommended estimates, with one standard error in brackets")
        counts = ", ".join(f"{count} {status}" for status, count in estimates["status"].value_counts().items())
        summary = f"{len(estimates)} rows of estimates from {len(self.numbers)} clips: {counts}."
        warnings = [*map(str, list_messages(estimates)), *map(str, self.notes)]
        with as_input_error(self.output):
            write_page(self.output / PAGE, self.name, [PageSection("", [table])], self.command, [summary], warnings)

    def _folder(self, index: int) -> Path:
        return self.output if self.is_single else results.clip_folder(self.output, self.numbers[index])
