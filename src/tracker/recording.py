"""One recording through the whole chain, in memory: read, detect, link, measure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from synthcam_shared.arguments import check_arguments, name_arguments
from synthcam_shared.errors import InputError
from synthcam_shared.report.numbers import format_with_error
from tracker import results
from tracker.camera.camera import Camera, CameraSource
from tracker.camera.camera_notes import describe_camera_gaps, describe_exposure
from tracker.camera.film_in_memory import FILM, wrap_frames
from tracker.camera.film_options import FilmKeywords, FilmOptions
from tracker.camera.recordings import Recording, make_recording, open_frames, open_source
from tracker.detection.choose import DISCS, GLINTS, SelectedDetector, name_channel, select_channel, select_detector
from tracker.detection.detect import (
    DEFAULT,
    DetectorChoice,
    blank_outside,
    detect_until_blur_converges,
    detector_name,
    find_detected_point,
    load_detector,
    load_linker,
    make_view,
)
from tracker.detection.detector import Detections, View
from tracker.detection.diagnose import (
    MIN_DETECTIONS,
    LooseEnds,
    count_loose_ends,
    describe_other_specks,
    explain_no_discs,
    explain_no_glints,
    explain_no_paths,
    follow_bodies,
    warn_of_exchanges,
    warn_of_missed_examples,
    warn_of_moving_camera,
)
from tracker.detection.fast_balls import (
    allow_fast_balls,
    describe_speed_limit,
    may_be_fast,
    raise_speed_limit,
    set_link_settings,
)
from tracker.detection.glints import Glints
from tracker.detection.link import Tracks, link_into_tracks, to_centres
from tracker.edits import EditsSource, TrackEdits
from tracker.measurement.collision.adequacy import MEASURED, describe_failure
from tracker.measurement.collision.contacts import MarkedContact
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.local.recommendation import find_recommended_suffix
from tracker.measurement.track_repair import RepairedTracks, repair_tracks
from tracker.notes import Note, NoteKind, make_notes
from tracker.settings import FitSettings, SettingsSource, TrackerSettings
from tracker.tables.read import ClipTracks, read_frame, read_tracks
from tracker.tables.rows import make_tracks_table
from tracker.tables.table_options import TableKeywords, TableOptions

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Film = NDArray[Any] | Iterable[NDArray[Any]] | str | Path


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The tracks and estimates of one recording.

    Attributes
    ----------
    number : int
        Of the clip; column ``clip`` of the estimates.
    camera : Camera
        As used: what the camera file leaves open is estimated from the film, or assumed, and listed in `notes`.
    found : Tracks
        The tracks as arrays.
    rows : tuple of dict
        The estimates, one for each collision.
    motion : DataFrame
        About the first collision: t_s (s), particle, vx, vy (m/s), energy (m^2/s^2), p_along, p_across (m/s): per unit
        mass, along and across each ball's own slip direction.
    notes : tuple of Note
        What was assumed, estimated or converted; `str(note)` is its sentence.
    frames : int
        How many were tracked; 0 of tracks made elsewhere.
    detector : str
        Its name; empty for tracks made elsewhere.
    detected : Glints
        What it found, also what belongs to no track; empty for tracks made elsewhere.
    in_pieces : bool
        Whether most tracks begin or end inside the picture, where no ball comes in or leaves.

    Examples
    --------
    >>> import synthcam, tracker
    >>> clip = synthcam.Scene.read("painter_behringer").draw(seed=1)
    >>> table = clip.tracks[["frame", "particle"]].assign(x=clip.tracks.x_mean_px, y=clip.tracks.y_mean_px)
    >>> print(repr(tracker.measure(table, clip.camera_json)).partition(":")[0])
    Clip 0
    """

    number: int
    camera: Camera
    found: Tracks
    rows: tuple[dict[str, Any], ...]
    motion: pd.DataFrame
    notes: tuple[Note, ...] = ()
    frames: int = 0
    detector: str = ""
    detected: Glints = field(default_factory=Glints.none)
    in_pieces: bool = False

    @cached_property
    def tracks(self) -> pd.DataFrame:
        """The tracks, a row for each ball and frame, with the columns of ``tracks.parquet``.

        frame, particle; x, y (px): ball centre, mean over the exposure, or the glint where `flags` says so; x_std,
        y_std (px), cov_xy (px^2); flux (counts); flags; glint_x, glint_y (px); x_fixed_std, y_fixed_std, cov_xy_fixed:
        the part of the covariance that is the same in every frame of a resting ball.
        """
        table: pd.DataFrame = make_tracks_table(self.found).to_pandas()
        return table

    @cached_property
    def estimates(self) -> pd.DataFrame:
        """The estimates, a row for each collision, with the columns of ``estimates.parquet``, SI.

        status is ok, misfit, no_collision or a reason. NAME, NAME_free and NAME_paper are the tied fit, the free fit
        and the paper's differences, each with its _std; docs/format.md has all columns. Take ``estimates["clip"]`` and
        ``estimates["flags"]`` by brackets, because pandas has attributes of these names.
        """
        return results.make_estimates_table({"clip": self.number, **row} for row in self.rows)

    @cached_property
    def contacts(self) -> pd.DataFrame:
        """All contacts of more than two balls, with one another and with walls: the columns of ``contacts.parquet``.

        Empty for one or two balls, and without a scale.
        """
        from tracker.measurement.crowd.contact_table import tabulate_contacts

        return tabulate_contacts(self.found, self.camera, self.rows)

    def __repr__(self) -> str:
        balls = len(np.unique(self.found.particle))
        seen = f" in {self.frames} frames" if self.frames else ""
        lines = [f"Clip {self.number}: {balls} ball{'s' * (balls != 1)} tracked{seen}"]
        units = {"v0": "m/s", "b": "", "r": "", "mu_k": "", "C": ""}  # in a repr, with units
        for row in self.rows:
            best = find_recommended_suffix(row)
            texts = {name: format_with_error(row[f"{name}{best}"], row[f"{name}{best}_std"]) for name in units}
            values = (f"{name} {texts[name]} {unit}".strip() for name, unit in units.items())
            known = row["status"] in MEASURED or best
            measured_values = f": {', '.join(values)}" if known else ""
            used = f", {row['recommended']} estimate" if best else ""
            lines.append(f"  collision {row['collision']} {row['status']}{used}{measured_values}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        of_unit = {"m/s": "v0 v1f v2f", "s": "t_c tau1 tau2", "rad": "final_angle"}
        of_unit |= {"1/s": "drag", "m/s^2": "decel", "rad/s": "w1n w1t w2n w2t"}
        units = {name: unit for unit, names in of_unit.items() for name in names.split()}
        parts = [f"<p>{repr(self).partition(chr(10))[0]}</p>"]
        for row in self.rows:
            title = f"collision {row['collision']}: {row['status']}"
            if row["status"] not in MEASURED and not find_recommended_suffix(row):
                parts.append(f"<p>{title}</p>")
                continue
            kinds = {"tied fit": "", "free fit": "_free", "local estimate": "_local", "as the paper": "_paper"}
            columns = {
                k: [format_with_error(row[n + s], row[f"{n}{s}_std"]) for n in QUANTITY_NAMES] for k, s in kinds.items()
            }
            table = pd.DataFrame(columns, index=[f"{n} ({units[n]})" if n in units else n for n in QUANTITY_NAMES])
            parts.append(f"<p>{title}</p>{table.to_html()}")
        return "".join(parts)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot the tracks as they lie in the picture: x and y in px, y downwards.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; default: a new figure. On a picture shown by ``ax.imshow(film[0])`` the tracks fit.

        Returns
        -------
        Axes
        """
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(layout="constrained")[1]
        for k, (particle, rows) in enumerate(self.tracks.groupby("particle")):
            colour = ("#2166ac", "#b2182b", "#4d9221", "#7b3294")[k % 4]
            ax.plot(rows["x"], rows["y"], ".-", lw=0.8, ms=3, color=colour, label=f"particle {particle}")
        width, height = self.camera.size
        ax.set(xlabel="x (px)", ylabel="y (px)", xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
        if len(self.found):
            ax.legend(fontsize="small")
        return ax


@check_arguments
def track(
    film: Film,
    camera: CameraSource | None = None,
    *,
    detector: DetectorChoice | None = None,
    channel: str | None = None,
    colour: str = "",
    number: int | None = None,
    settings: SettingsSource | None = None,
    edits: EditsSource | None = None,
    **reading: Unpack[FilmKeywords],
) -> Result:
    """Find, follow and measure the balls of one recording. An InputError says why a film or a camera cannot be used.

    Parameters
    ----------
    film : array_like of shape (frames, height, width), sequence of arrays, str or Path
        uint8 or uint16 counts; in colour (frames, height, width, 3). Or a stack, video, clip or folder of pictures.
        An object with a length and an index is read frame by frame.
    camera : Camera, dict, str or Path, optional
        The keys of camera.json, a path to it, or a clip of synthcam or its camera. Without one, the file beside the
        film; without that, lengths are in pixels.
    detector : str or callable, optional
        How balls are found: a name, FILE.py, MODULE:NAME, a class as the files of ``detectors/`` hold, or a function.
        The function takes a grey frame and returns positions (n, 2), x and y in px. A third column may hold standard
        errors. Default: what the film asks for.
    channel : {"grey", "red", "green", "blue", "red-green", "red-blue", "green-blue", "colour"} or "#rrggbb", optional
        Of a film in colour; default: grey, unless another shows its balls better. "dark", of any film, is white less
        grey: dark specks are followed as bright ones.
    colour : str
        Of the balls, as "orange" or "#ff8000"; in place of `channel`.
    number : int, optional
        Of the clip; default: its folder's, else 0.
    settings : TrackerSettings, dict, str or Path, optional
        Thresholds that differ from the defaults: an object, its keys, or a YAML file of them.
    edits : dict, str or Path, optional
        Corrections of the tracks by hand: ``{"edits": [...]}``, or a YAML file of them.
    **reading
        How the film is read, and which part of it:

        - frames, "A:B": the first frame and the one after the last; they keep their numbers
        - region, "X0,Y0,X1,Y1" in px: where balls are searched for
        - mask, a path: a picture as large as the film that is white where balls are searched for
        - ball, a sequence of "X,Y@FRAME" or "X,Y,R@FRAME" in px: balls that you point at
        - select, "C=1" or "C=1,Z=0": the entry of each axis of a stack that is not time; default: the first
        - times, "auto": missing frames and uneven times from the film, its rate from the camera; "file": the rate too
          from the film; "even": frames are evenly spaced, whatever the film says
        - fields, "separate": the fields of interlaced video become frames of their own; "weave": they do not; "auto":
          the film decides

    Returns
    -------
    Result
        The same numbers as ``tracker track`` writes for the same film and camera.

    Examples
    --------
    >>> import synthcam, tracker
    >>> small = {"size": [160, 120], "scale": 3e-4}
    >>> timing = {"frames": 60, "contact_frame": 20}
    >>> clip = synthcam.Scene.read("painter_behringer", camera=small, timing=timing).draw(seed=1)
    >>> result = tracker.track(clip.film(), clip.camera_json)
    >>> abs(result.estimates["r"][0] - clip.truth["r"]) < 4 * result.estimates["r_std"][0]
    np.True_
    """
    chosen, edited = TrackerSettings.of(settings), TrackEdits.of(edits)
    if detector is not None:
        load_detector(detector)  # an unknown one is reported before a film is read
    clip, why = select_channel(_open(film, camera, FilmOptions.of(reading)), name_channel(channel, colour))
    clip = clip if number is None else replace(clip, number=number)
    edited.check_clips([clip.number])
    with threadpool_limits(1, "blas"):  # as in the commands: matrices are small, and threads would wait for one another
        result = track_and_measure(clip, detector, chosen, edited)
    return replace(result, notes=_name_arguments(*make_notes(NoteKind.CHANNEL, [why]), *result.notes))


def _open(film: Film, camera: CameraSource | None, options: FilmOptions) -> Recording:
    names = FILM, f"{camera}" if isinstance(camera, str | Path) else "camera"
    known = None if camera is None else Camera.of(camera)
    if not isinstance(film, str | Path):
        return make_recording(0, wrap_frames(film), known, names, options)
    source = open_source(film, options=options)
    if len(source) > 1:
        first = source.clips[0][1].parent
        raise InputError(f"{film}: holds {len(source)} clips, expected one, as {first}; `tracker track` takes them all")
    if camera is None:
        return source.open_clip(0)
    ((number, location),) = source.clips
    return make_recording(number, open_frames(location, options), known, (f"{location}", names[1]), options)


@check_arguments
def measure(
    tracks: pd.DataFrame | str | Path,
    camera: CameraSource,
    *,
    number: int | None = None,
    settings: SettingsSource | None = None,
    edits: EditsSource | None = None,
    **reading: Unpack[TableKeywords],
) -> Result:
    """Measure the collisions in tracks that any program made, in memory.

    An InputError refuses what is no such table, and tables of several clips, which `measure_all` takes.

    Parameters
    ----------
    tracks : DataFrame, str or Path
        Of one clip, with columns (or levels of the index) frame, particle, x, y (px), as trackpy has them; x_std,
        y_std, cov_xy, clip and striker may be there. Particles and clips have numbers or names. Or a file of them, or
        one of the formats of docs/format.md.
    camera : Camera, dict, str or Path
        What camera.json holds, or where it lies.
    number : int, optional
        Of the clip, which is the column ``clip`` of its estimates; default: the table's, else 0.
    settings : TrackerSettings, dict, str or Path, optional
        As `track` takes them; only the section `fit` counts.
    edits : dict, str or Path, optional
        As `track` takes them.
    **reading
        How the table is read:

        - point, "centre" or "glint": the point of a ball that x and y give; default: the centre, mean over the exposure
        - columns, "x=POS_X,y=POS_Y,frame=FRAME,track=TRACK_ID": the table's own names of columns, or their numbers
        - unit, such as px, m, cm or mm: of lengths; default: what the table says, or px
        - decimal, "." or ",": the decimal mark of a file's numbers; default: what the numbers show

    Returns
    -------
    Result
        As `track` gives it; `tracks` holds the balls' centres.

    Examples
    --------
    >>> import synthcam, tracker
    >>> clip = synthcam.Scene.read("painter_behringer").draw(seed=1)
    >>> table = clip.tracks[["frame", "particle"]].assign(x=clip.tracks.x_mean_px, y=clip.tracks.y_mean_px)
    >>> result = tracker.measure(table, clip.camera_json)
    >>> bool(abs(result.estimates["r"][0] - clip.truth["r"]) < 1e-4)
    True
    """
    options = TableOptions.of(reading)
    given = _read_given(tracks, camera, options)
    if len(given.clips) > 1:
        numbers = sorted(given.clips)
        few = ", ".join(map(str, numbers[:5])) + ", ..." * (len(numbers) > 5)
        raise InputError(
            f"tracks: {len(numbers)} clips ({few}), expected 1; tracker.measure_all(tracks, camera) takes them all and"
            " returns a list, one Result for each"
        )
    (result,) = _measure_given(given, options.point, settings, edits)
    return result if number is None else replace(result, number=number)


@check_arguments
def measure_all(
    tracks: pd.DataFrame | str | Path,
    camera: CameraSource,
    *,
    settings: SettingsSource | None = None,
    edits: EditsSource | None = None,
    **reading: Unpack[TableKeywords],
) -> list[Result]:
    """Measure the collisions of all clips of a table, which a column ``clip`` distinguishes.

    Parameters
    ----------
    tracks, camera, settings, edits, **reading
        As `measure` takes them.

    Returns
    -------
    list of Result
        In the order of the clips' numbers, which are the column ``clip`` of their estimates. `discrepancy.find` takes
        the list.

    Examples
    --------
    >>> import pandas as pd, synthcam, tracker
    >>> clips = [synthcam.Scene.read("painter_behringer").draw(k, seed=1) for k in (3, 5)]
    >>> parts = [c.tracks[["frame", "particle"]].assign(x=c.tracks.x_mean_px, y=c.tracks.y_mean_px) for c in clips]
    >>> table = pd.concat([part.assign(clip=c.number) for part, c in zip(parts, clips)])
    >>> found = tracker.measure_all(table, clips[0].camera_json)
    >>> pd.concat([result.estimates for result in found])["clip"].tolist()
    [3, 5]
    """
    options = TableOptions.of(reading)
    return _measure_given(_read_given(tracks, camera, options), options.point, settings, edits)


def _read_given(tracks: pd.DataFrame | str | Path, camera: CameraSource, options: TableOptions) -> ClipTracks:
    if camera is None:
        raise InputError("camera: expected a camera, its keys, or a path; tracks alone have no times and lengths")
    if isinstance(tracks, pd.DataFrame):
        return read_frame(tracks, camera, options)
    return read_tracks(Path(tracks), camera, options)


def _measure_given(
    given: ClipTracks, point: str, settings: SettingsSource | None, edits: EditsSource | None
) -> list[Result]:
    from tracker.measurement.local.local_columns import calibrate_set

    fit, edited, found = TrackerSettings.of(settings).fit, TrackEdits.of(edits), []
    edited.check_clips(given.clips.keys())
    check_edits(given, point, edited)
    for number, (tracks, striker) in sorted(given.clips.items()):
        known = given.camera if striker is None else replace(given.camera, striker=striker)
        with threadpool_limits(1, "blas"):  # as in `track`
            result = measure_tracks(tracks, known, number, point, fit, edited)
        found.append(replace(result, notes=_name_arguments(*given.notes, *result.notes)))
    every = calibrate_set([row for result in found for row in result.rows])
    ends = np.cumsum([len(result.rows) for result in found])
    parts = (tuple(every[end - len(result.rows) : end]) for result, end in zip(found, ends, strict=True))
    return [replace(result, rows=rows) for result, rows in zip(found, parts, strict=True)]


def _name_arguments(*notes: Note) -> tuple[Note, ...]:
    """The notes, which then name arguments, not options."""
    return tuple(replace(note, text=name_arguments(note.text)) for note in notes)


def track_and_measure(
    clip: Recording,
    name: DetectorChoice | None = None,
    settings: TrackerSettings | None = None,
    edits: TrackEdits | None = None,
    selected: SelectedDetector | None = None,
) -> Result:
    """Track and measure one recording, by the detector `name` or the one that its film asks for.

    selected: the detector that the film asks for, if it is known already. Another one replaces it where it finds no
    ball, or bright specks without a collision.
    """
    settings = settings or TrackerSettings()
    if name is not None:
        selected, tracked = None, track_clip(clip, name, settings)
    else:
        selected, tracked = _track_by_choice(clip, selected or select_detector(clip), settings)
    edited = (edits or TrackEdits()).apply(tracked.tracks, clip.number, clip.frames.numbers)
    rows, motion = measure_clip(edited.tracks, tracked.camera, settings.fit, edited.contacts)
    if tracked.reason:
        rows = [row if row["status"] in MEASURED else row | {"status": tracked.reason} for row in rows]
    notes = (
        *clip.notes,
        *make_notes(NoteKind.DETECTOR, [selected.why if selected else ""], clip.number),
        *tracked.notes,
        *make_notes(NoteKind.LINKING, _warn_of_loose_ends(clip, tracked), clip.number),
        *edited.notes,
        *describe_camera_gaps(tracked.camera),
        *describe_exposure(tracked.camera, f"{results.EXPOSURE_SEEN_KEY} in {results.RUN}"),
    )
    used = detector_name(selected.name if selected else name or DEFAULT)
    return Result(
        clip.number,
        tracked.camera,
        edited.tracks,
        tuple(rows),
        motion,
        notes,
        frames=len(clip.frames),
        detector=used,
        detected=tracked.detected,
        in_pieces=tracked.loose_ends.are_most,
    )


def _warn_of_loose_ends(clip: Recording, tracked: TrackedClip) -> tuple[str, ...]:
    return tracked.loose_ends.warn(tracked.hint, lossy=getattr(clip.frames, "lossy", False))


def _track_by_choice(
    clip: Recording, selected: SelectedDetector, settings: TrackerSettings
) -> tuple[SelectedDetector, TrackedClip]:
    """Track one recording by the detector that its film asks for, or by another one if that finds more; which one."""
    first = track_clip(clip, selected.name, settings)
    of_specks = selected.name != DISCS and first.loose_ends.are_most
    if not first.reason and not of_specks:
        return selected, first
    other = GLINTS if selected.name == DISCS else DISCS
    second = track_clip(clip, other, settings)
    succeeds = not second.reason and len(second.tracks) >= MIN_DETECTIONS
    found = f"nothing ({first.reason})"
    if not first.reason:
        succeeds &= not second.loose_ends.are_most and follow_bodies(second.tracks, second.camera.size)
        found = f"specks and no collision ({first.loose_ends.describe()})"
        rows = measure_clip(first.tracks, first.camera, settings.fit)[0] if succeeds else []
        if any(row["status"] in MEASURED for row in rows):
            return selected, replace(first, hint="")
    if not succeeds:
        return selected, replace(first, hint=LooseEnds.NO_BODIES)
    why = f"detector: {other}, because {selected.name} finds {found}; --detector overrides this"
    return SelectedDetector(other, why), second if other == DISCS else replace(second, hint=LooseEnds.NO_BODIES)


def measure_tracks(
    tracks: Tracks,
    camera: Camera,
    number: int,
    point: str,
    settings: FitSettings | None = None,
    edits: TrackEdits | None = None,
) -> Result:
    """Measure tracks made elsewhere as `track_and_measure` does its own."""
    settings = settings or FitSettings()
    advice = "For all write `fit: {{max_particles: {}}}` into a file of settings (--settings FILE)"
    check_particles(tracks, number, settings, advice)
    repaired = _repair(tracks, camera, number, point)
    edited = (edits or TrackEdits()).apply(repaired.tracks, number)
    rows, motion = measure_clip(edited.tracks, camera, settings, edited.contacts)
    gaps = (note for note in describe_camera_gaps(camera) if note.kind is not NoteKind.ASSUMED)
    notes = (*repaired.notes, *edited.notes, *gaps)
    return Result(number, camera, edited.tracks, tuple(rows), motion, notes)


def check_edits(given: ClipTracks, point: str, edits: TrackEdits) -> None:
    """Raise InputError for an edit that does not fit the tracks of its clip, before any clip is measured."""
    for number, (tracks, striker) in sorted(given.clips.items()):
        if edits.of_clip(number):
            camera = given.camera if striker is None else replace(given.camera, striker=striker)
            edits.apply(_repair(tracks, camera, number, point).tracks, number)


def _repair(tracks: Tracks, camera: Camera, number: int, point: str) -> RepairedTracks:
    return repair_tracks(to_centres(tracks, camera) if point == "glint" else tracks, camera, number)


def check_particles(tracks: Tracks, number: int, settings: FitSettings, advice: str) -> None:
    """Refuse a recording with more particles than can be measured in seconds; the advice may hold {}, their number."""
    count = len(np.unique(tracks.particle))
    if count > settings.max_particles:
        raise InputError(
            f"clip {number}: {count} particles, expected at most {settings.max_particles}; the time grows with their "
            f"square. {advice.format(count)}"
        )


@dataclass(frozen=True)
class TrackedClip:
    """The tracks that one detector finds in a recording."""

    tracks: Tracks
    camera: Camera  # completed from the clip
    reason: str  # why there is no ball, or ''
    notes: tuple[Note, ...]
    loose_ends: LooseEnds
    detected: Glints  # also what belongs to no track
    hint: str = ""  # what may help against these


def track_clip(clip: Recording, name: DetectorChoice = DEFAULT, settings: TrackerSettings | None = None) -> TrackedClip:
    """Track one recording by one detector."""
    settings = settings or TrackerSettings()
    view = make_view(clip, name, settings)
    numbers = clip.frames.numbers
    stored = view.takes.spans if view.takes is not None else [(0, len(clip.frames) - 1)]
    spans = [(int(numbers[first]), int(numbers[last])) for first, last in stored]
    found, view, tracks = _detect_and_link(clip, view, name, spans)
    if clip.frames.seconds is not None:
        tracks = replace(tracks, time=clip.frames.seconds[np.searchsorted(numbers, tracks.frame)])
    if view.takes is not None:
        seen = len(np.unique(found.glints.frame))
        why = "" if len(tracks) else explain_no_paths(seen) or explain_no_discs(clip.frames, view)
    else:
        why = explain_no_glints(clip.frames, view, found.glints)
    notes = make_notes(NoteKind.DETECTOR, found.notes, clip.number)
    notes += make_notes(NoteKind.DETECTOR, warn_of_missed_examples(tracks, clip.balls, view), clip.number)
    if view.takes is None:
        specks = describe_other_specks(clip.frames, view.plate, clip.channel)
        notes += make_notes(NoteKind.DETECTOR, specks, clip.number)
    notes += make_notes(NoteKind.LINKING, [describe_speed_limit(view.settings.link, settings.link)], clip.number)
    loose = count_loose_ends(tracks, view.camera.size, spans)
    moving = warn_of_moving_camera(clip.frames) if loose.are_most else ()
    notes += make_notes(NoteKind.LINKING, (*moving, *warn_of_exchanges(tracks)), clip.number)
    hint = LooseEnds.HINT_AT_BODIES if name == GLINTS else ""
    return TrackedClip(tracks, view.camera, why, tuple(notes), loose, found.glints, hint)


def _detect_and_link(
    clip: Recording, view: View, name: DetectorChoice, spans: Sequence[tuple[int, int]]
) -> tuple[Detections, View, Tracks]:
    """Detect and link the balls of a recording; again if the tracks leave glints out that faster balls explain.

    spans: first and last frames of takes. Detections have the numbers of their frames, and lie in the area of the
    search. The view has the settings that were used.
    """
    takes, point = spans if view.takes is not None else (), find_detected_point(name, clip.camera)

    def detect_in(view: View) -> tuple[Detections, View, Glints]:
        found, view = detect_until_blur_converges(clip if name == DISCS else blank_outside(clip, view), view, name)
        glints = replace(found.glints, frame=clip.frames.numbers[found.glints.frame])
        if clip.area is not None:
            column, row = np.clip(np.rint(glints.xy), 0, np.array(view.camera.size) - 1).astype(int).T
            glints = glints.take(np.flatnonzero(clip.area[row, column]))
        return found, view, glints

    def link(view: View, glints: Glints) -> Tracks:
        settings = view.settings.link
        linker = load_linker(name, view.camera, settings)
        return link_into_tracks(glints, view.camera, point, takes, linker, settings)

    usual = view.settings.link
    found, used, glints = detect_in(view)
    tracks = link(used, glints)
    if point == "glint" and may_be_fast(glints, tracks, usual):
        # from the exposure of the camera file again: wrong links may have shown a wrong one
        _, there, smeared = detect_in(set_link_settings(view, allow_fast_balls(view.camera, usual)))
        faster = raise_speed_limit(smeared, there.camera, usual)
        if faster is not usual:
            found, used, glints = detect_in(set_link_settings(view, faster))
            tracks = link(used, glints)
    return replace(found, glints=glints), used, tracks


def measure_clip(
    tracks: Tracks, camera: Camera, settings: FitSettings | None = None, marked: Sequence[MarkedContact] = ()
) -> tuple[list[dict[str, Any]], pd.DataFrame]:
    """Measure one recording's tracks, in memory: rows of estimates, and the motion about the first collision."""
    from tracker.measurement.estimate import make_empty_row, make_motion_table, measure

    try:
        rows = measure(tracks, camera, settings, marked)
        return rows, make_motion_table(tracks, camera, rows[0])
    except InputError:
        raise
    except (ArithmeticError, ValueError, IndexError) as error:  # one clip never costs the others
        return [make_empty_row(camera, describe_failure(error))], make_motion_table(tracks.take(slice(0)), camera, {})
