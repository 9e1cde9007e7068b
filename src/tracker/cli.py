"""tracker: open, track, measure, combine, gas, export, score, compare, benchmark, calibrate, warp."""

from __future__ import annotations

import json
import pkgutil
import shlex
import shutil
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from synthcam_shared.application import make_command_line, progress_bar, run
from synthcam_shared.errors import InputError
from tracker.benchmark.commands import app as benchmark_app
from tracker.camera.camera_keys import CHANNELS, CONTRAST, DARK, PLANES
from tracker.detection import detectors as detector_files

if TYPE_CHECKING:
    from tracker.pipeline import ClipOutcome

app = make_command_line(
    "tracker",
    "Finds rolling steel balls by their glint, follows them, and measures the collision with standard errors.",
)
app.add_typer(benchmark_app, name="benchmark")
MAX_ROWS_OF_A_PAGE = 100_000  # positions of a recording whose page is written unasked; more take minutes
DETECTORS = (
    ", ".join(m.name for m in pkgutil.iter_modules(detector_files.__path__))
    + ", an installed package's own, FILE.py, FILE.py:NAME or MODULE:NAME"
)
Results = Annotated[Path, typer.Option("-o", "--output", metavar="RESULTS", help="Folder to make.")]
WithPages = Annotated[
    bool | None,
    typer.Option("--pages/--no-pages", help="Write a page for each recording; default: where there is one recording."),
]
SettingsFile = Annotated[
    Path | None, typer.Option("--settings", metavar="YAML", help="Thresholds that differ from the defaults.")
]
EditsFile = Annotated[Path | None, typer.Option("--edits", metavar="YAML", help="Corrections of tracks by hand.")]
Select = Annotated[
    str,
    typer.Option(metavar="AXIS=N", help="Channel or plane of a stack, as C=1 or C=1,Z=0. Default: 0."),
]
Report = Annotated[Path, typer.Option("-o", "--output", metavar="REPORT", help="Folder to make.")]
Scheduler = Annotated[str, typer.Option(metavar="ADDRESS", help="A Dask scheduler, whose workers do it.")]
Json = Annotated[bool, typer.Option("--json", help="Print a machine-readable summary.")]
CameraFile = Annotated[Path | None, typer.Option(help="camera.json that replaces the source's own.")]
NewCamera = Annotated[Path, typer.Option("-o", "--output", metavar="CAMERA.JSON", help="File to write.")]
TrackerResults = Annotated[Path, typer.Argument(metavar="RESULTS", help="RESULTS of tracker track or measure.")]


@app.command()
def track(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="Dataset, clip, stack, video, pictures or array.")],
    output: Results,
    camera: CameraFile = None,
    detector: Annotated[str | None, typer.Option(help=f"{DETECTORS}. Without it the film decides.")] = None,
    channel: Annotated[
        str | None,
        typer.Option(
            help=f"{', '.join((*CHANNELS, *PLANES))} or #rrggbb, of a film in colour. Of any film: {DARK}, in "
            f"which dark specks are bright, and {CONTRAST}, in which a body with a bright and a dark part is one. "
            "Without it the film decides."
        ),
    ] = None,
    times: Annotated[
        str,
        typer.Option(
            help="auto: missing frames and uneven times from the film, rate from the camera file; file: the rate too "
            "from the film; even: frames are evenly spaced, whatever the film says."
        ),
    ] = "auto",
    select: Select = "",
    fields: Annotated[
        str, typer.Option(help="Fields of interlaced video: separate, weave (leave as is), or auto: the film decides.")
    ] = "auto",
    ball: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y[,R]@FRAME", help="A ball that you point at, centre and radius in px; repeatable."),
    ] = None,
    colour: Annotated[
        str, typer.Option(help="Colour of the balls, as orange or #ff8000; use it without --channel.")
    ] = "",
    region: Annotated[
        str,
        typer.Option(
            metavar="X0,Y0,X1,Y1", help="Search for balls in this rectangle alone, px, or in a polygon: 'X,Y X,Y X,Y'."
        ),
    ] = "",
    mask: Annotated[Path | None, typer.Option(help="A picture, white where alone balls are searched.")] = None,
    frames: Annotated[str, typer.Option(metavar="A:B", help="Which frames are read, without B.")] = "",
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: whatever is quickest.")] = None,
    scheduler: Scheduler = "",
    pages: WithPages = None,
    settings: SettingsFile = None,
    edits: EditsFile = None,
    as_json: Json = False,
) -> None:
    """Find, follow and measure the balls of every clip. If interrupted, the same command continues.

    Example: tracker track out/benchmark -o out/results
    """
    from tracker.camera.film_options import FilmOptions
    from tracker.camera.recordings import open_source
    from tracker.detection.choose import name_channel
    from tracker.pipeline import run as track_all

    started = time.monotonic()
    options = FilmOptions(times, select, fields, frames, region, str(mask or ""), tuple(ball or ()))
    films = replace(open_source(source, camera, options), channel=name_channel(channel, colour))
    with progress_bar("frames" if len(films) == 1 else "clips") as progress:
        outcome = track_all(films, output, detector, workers or 0, progress, scheduler, settings, edits)
    seconds = time.monotonic() - started
    extra: dict[str, Any] = {"frames": outcome.frames, "seconds": round(seconds, 2)}
    if outcome.frames:
        extra["ms_per_frame"] = round(1e3 * seconds / outcome.frames, 3)
    if as_json:
        extra["notes"] = {str(note): clips for note, clips in outcome.notes.items()}
    if _wants_pages(pages, outcome, output):
        extra["page"] = _pages(outcome, output, source, workers or 0)
    _report(outcome, output, extra, as_json)


@app.command("open")
def open_workbench(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILM|RESULTS...]", help="Film or dataset, or RESULTS of tracker; without it, example films."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FOLDER", help="Where runs are written; default: FILM_workbench."),
    ] = None,
    film: Annotated[Path | None, typer.Option(help="The film of RESULTS, where it does not lie beside them.")] = None,
    camera: CameraFile = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address alone.")] = False,
) -> None:
    """Open a film in a page on this machine: look at it, point at scale and balls, track it, correct it, read on.

    Example: tracker open film.mp4

    Example: tracker open out/results
    """
    from tracker.camera.recordings import open_source
    from tracker.results import RUN

    try:
        from tracker.app.server import serve
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn"):
            raise
        raise InputError("tracker open needs the extra app; type: pip install 'synthcam[app]'") from None
    from tracker.app.opened_results import OpenedResults, find_film, show_tracks_alone
    from tracker.app.scene_previews import make_examples
    from tracker.app.workbench import Workbench

    source, *others = sources or [make_examples()]
    opened = None
    for other in others:
        if not all((folder / RUN).is_file() for folder in (source, other)):
            raise InputError(f"{other}: expected one film, or several RESULTS")
    if (source / RUN).is_file():
        opened = OpenedResults(source)
        films = find_film(opened, film, camera) or show_tracks_alone(opened)
    elif film is not None:
        raise InputError(f"--film: expected RESULTS before it, and {source} are none")
    else:
        films = open_source(source, camera)
    serve(Workbench(films, output, opened, others), not no_browser)


@app.command()
def measure(
    tracks: Annotated[
        Path,
        typer.Argument(
            metavar="TRACKS", help="CSV or Parquet: clip, frame, particle, x, y; or another program's file."
        ),
    ],
    camera: Annotated[Path, typer.Option(help="camera.json of the tracks.")],
    output: Results,
    point: Annotated[
        str, typer.Option(help="x, y are the ball's centre (mean over the exposure) or glint.")
    ] = "centre",
    columns: Annotated[str, typer.Option(help="x=POS_X,y=POS_Y,frame=1,track=2: its own names, or numbers.")] = "",
    unit: Annotated[str, typer.Option(help="Unit of lengths: px, m, cm, mm, um, ... Default: as the file says.")] = "",
    decimal: Annotated[str, typer.Option(help="Decimal mark of a text, . or a comma. Default: as it shows.")] = "",
    pages: WithPages = None,
    settings: SettingsFile = None,
    edits: EditsFile = None,
    as_json: Json = False,
) -> None:
    """Measure the collisions in TRACKS, which any program made.

    Known by their content: columns frame, particle, x, y, as trackpy's; a table with x and y of each ball, as
    idtracker.ai's; DeepLabCut; Qualisys; TrackMate (CSV, XML); Particle Tracking Challenge; MOTChallenge; Tracker
    (OSP), its exported tables and .trk. Texts, Parquet, Feather, HDF5 and Excel.

    Example: tracker measure tracks.csv --camera camera.json -o out/measured
    """
    from tracker.pipeline import measure_tables
    from tracker.tables.table_options import TableOptions

    options = TableOptions(point, columns, unit, decimal)
    with progress_bar("measured") as progress:
        outcome = measure_tables(tracks, output, camera, options, settings, edits, progress)
    extra = dict[str, Any]()
    if _wants_pages(pages, outcome, output):
        extra["page"] = _pages(outcome, output, tracks, 0)
    _report(outcome, output, extra, as_json)


@app.command()
def combine(
    results: Annotated[list[Path], typer.Argument(metavar="RESULTS...", help="RESULTS of tracker track or measure.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="SET", help="Folder to make.")],
    quantities: Annotated[
        str, typer.Option(help="Columns of estimates.parquet, as r,mu_k. Default: all that collisions share.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Combine the collisions of RESULTS: random-effects means of r, mu_k, C and others, scatter, slopes in the speed.

    Example: tracker combine out/monday out/tuesday -o out/set
    """
    from synthcam_shared.outputs import check_not_read
    from tracker.sets.combined_set import combine as combine_results
    from tracker.sets.set_page import summarise_set

    check_not_read(output, *(folder / "estimates.parquet" for folder in results), *results)
    names = [name.strip() for name in quantities.split(",")] if quantities else None
    found = combine_results(results, quantities=names)
    page = found.report(output, _typed())
    keys = {"set": str(output), "page": str(page), **found.document()}
    _print_answer(keys, summarise_set(found.document(), found.quantities), page, as_json, found.notes)


@app.command()
def gas(
    results: TrackerResults,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="GAS", help="Folder to make.")],
    clip: Annotated[int | None, typer.Option(help="Number of the clip, where there are several.")] = None,
    area: Annotated[
        str, typer.Option(metavar="LEFT,BOTTOM,RIGHT,TOP", help="Rectangle that the centres can reach, m.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Observe balls in RESULTS as a gas: temperature, velocities, pair correlation, contacts, and where energy goes.

    Example: tracker gas out/crowd_tracks -o out/gas
    """
    from synthcam_shared.json_values import replace_non_finite
    from synthcam_shared.outputs import check_not_read
    from tracker.gas.gas_page import summarise_gas
    from tracker.gas.observe import observe_gas, parse_area

    check_not_read(output, results)
    found = observe_gas(results, number=clip, area=parse_area(area))
    page = found.report(output, _typed())
    keys = {"gas": str(output), "page": str(page), "values": replace_non_finite(found.values), "notes": found.notes}
    _print_answer(keys, summarise_gas(found), page, as_json, found.notes)


@app.command()
def export(
    results: TrackerResults,
    kind: Annotated[str, typer.Option("--format", metavar="NAME", help="csv, mot, ptc, trackmate or trackpy.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE|DIR", help="A file; of several clips, a folder.")
    ],
    as_json: Json = False,
) -> None:
    """Write the tracks of RESULTS with -o for other programs.

    Example: tracker export out/results --format trackmate -o tracks.xml
    """
    from tracker.export import export as export_tracks

    clips = export_tracks(results, kind, output)
    summary = {"exported": str(output), "format": kind, "clips": clips}
    print(json.dumps(summary) if as_json else f"{output}: {clips} clips")


@app.command()
def score(
    results: Annotated[Path, typer.Argument(metavar="RESULTS|TRACKS", help="RESULTS of tracker track, or a table.")],
    truth: Annotated[Path, typer.Option(metavar="DATASET|TABLE", help="The dataset, with its truth, or a true table.")],
    output: Report,
    name: Annotated[str, typer.Option(help="Name of the detector in the report.")] = "",
    point: Annotated[str, typer.Option(help="In a table, x, y are centre or glint.")] = "centre",
    gate: Annotated[float | None, typer.Option(help="Largest distance of a pair in two tables; default 5.")] = None,
    scheduler: Scheduler = "",
    as_json: Json = False,
) -> None:
    """Compare RESULTS with --truth: localisation against its bound, tracking measures, bias and coverage.

    A table of any program may be scored against a true table of any program: CSV, MOTChallenge, Particle Tracking
    Challenge, TrackMate. Boxes are then compared by their overlap, points by their distance.

    Example: tracker score out/results --truth out/benchmark -o out/report

    Example: tracker score theirs.txt --truth gt.txt -o out/report
    """
    from synthcam_shared.outputs import open_resumable
    from tracker.results import RUN, load_json
    from tracker.scoring.score import check_same_dataset, summarise_score
    from tracker.scoring.score import score as score_results
    from tracker.scoring.score_page import write_report

    new = not output.exists()
    with open_resumable(output, "tracker score", "a new folder for the report"):
        try:
            if truth.is_file() and not results.is_dir():
                _score_tables(results, truth, output, gate, name, as_json)
                return
            if gate is not None:
                raise InputError("--gate: expected a true table behind --truth; a dataset has a gate of 5 px")
            if results.is_file():
                name = name or results.stem
                results = _measured(results, truth, output, point)
            if not name and (results / RUN).is_file():
                run = load_json(results / RUN)
                name = str(run.get("detector", "")) if isinstance(run, dict) else ""
            verdict = score_results(results, truth, name or "default", scheduler=scheduler)
            check_same_dataset(verdict, results, truth)
            path = write_report(verdict, results, truth, output, _typed())
            verdict.write(output)
        except BaseException:
            if new:
                shutil.rmtree(output, ignore_errors=True)
            raise
    _print_answer(verdict.to_dict(), [*summarise_score(verdict), *filter(None, [verdict.note])], path, as_json)


@app.command()
def compare(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Clips with their truth.")],
    detectors: Annotated[str, typer.Option(help=f"Names, with commas between them, of {DETECTORS}.")],
    output: Report,
    as_json: Json = False,
) -> None:
    """Track DATASET with several detectors and compare them. If interrupted, the same command continues.

    Example: tracker compare out/benchmark --detectors maximum_likelihood,centroid -o out/compared
    """
    from tracker.scoring.detector_comparison import compare as compare_detectors
    from tracker.scoring.detector_comparison import make_comparison_tables

    with progress_bar("clips") as progress:
        whole = compare_detectors(dataset, detectors.split(","), output, progress)
    if as_json:
        print(json.dumps(whole))
        return
    table = make_comparison_tables(whole["detectors"])[0]
    lines = [table.heads, *table.rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(table.heads))]
    for first, *rest in lines:
        print("  ".join([first.ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(rest, widths[1:], strict=True))]))
    print(output / "index.html")


@app.command()
def calibrate(
    video: Annotated[Path, typer.Argument(metavar="VIDEO", help="Video, stack, pictures or clips of the balls.")],
    diameter: Annotated[float, typer.Option(help="Diameter of the balls, m.")],
    fps: Annotated[float, typer.Option(help="Frames a second.")],
    output: NewCamera,
    exposure: Annotated[float | None, typer.Option(help="Exposure of a frame, s, if known.")] = None,
    gamma: Annotated[float, typer.Option(help="Counts are light to the power of 1/gamma: often 2.2.")] = 1.0,
    points: Annotated[
        Path | None, typer.Option(help="Known points of the plate, a table of x_px, y_px (px), x, y (m, y up).")
    ] = None,
    board: Annotated[str, typer.Option(help="On the plate: 7x5,square=0.01[,marker=0.007,dict=4X4_50].")] = "",
    error: Annotated[float | None, typer.Option(help="Error of the points, px; default 0.5, for a board 0.2.")] = None,
    height: Annotated[float | None, typer.Option(help="Height of the camera above the plate, m, to 2 %.")] = None,
    select: Select = "",
    as_json: Json = False,
) -> None:
    """Write a camera file from VIDEO: scale from balls that touch or are whole, glint width, noise, what is unknown.

    With --points or --board: perspective and lens from four or more known points, with their errors.

    Example: tracker calibrate collision.avi --diameter 2.38e-3 --fps 250 -o camera.json

    Example: tracker calibrate film.mp4 --points corners.csv --diameter 0.0525 --fps 240 -o camera.json
    """
    from tracker.calibration import calibrate as calibration

    calibration.check_output(output)
    given = calibration.keys_from_options(diameter, fps, exposure, gamma)
    if points is not None or board:
        from tracker.calibration.plate_camera import calibrate_plate

        plate = calibrate_plate(video, given, points, board, error, height)
        calibration.write_camera_file(output, plate.to_dict())
        _print_answer({"camera": str(output), **plate.to_dict()}, plate.summary(), output, as_json)
        return
    if error is not None or height is not None:
        raise InputError("--error, --height: expected --points or --board beside them")
    with progress_bar("calibrate") as progress:
        result = calibration.calibrate(video, given, 0, progress, select)
    result.write(output)
    keys = {"camera": str(output), **result.to_dict()["calibration"], "scale": result.camera.scale}
    _print_answer(keys, calibration.summarise_calibration(result), output, as_json)


@app.command()
def warp(
    results: Annotated[list[Path], typer.Argument(metavar="RESULTS...", help="RESULTS of one camera.")],
    output: NewCamera,
    as_json: Json = False,
) -> None:
    """Correct the camera's map by RESULTS: a smooth displacement of positions, from balls that slide and roll freely.

    Writes the camera file of the results with the key warp, if it predicts recordings that were left out. All commands
    apply it.

    Example: tracker warp out/results -o camera.json
    """
    from tracker.calibration.calibrate import check_output, write_camera_file
    from tracker.calibration.camera_warp import find_camera_warp

    check_output(output)
    with progress_bar("warp") as progress:
        found = find_camera_warp(results, progress)
    write_camera_file(output, found.to_dict())
    _print_answer({"camera": str(output), **found.to_dict()["calibration"]["warp"]}, found.summary(), output, as_json)


def _measured(tracks: Path, truth: Path, output: Path, point: str) -> Path:
    """RESULTS of a table of tracks, kept in the report, by the dataset's own camera."""
    from tracker.camera.recordings import open_source
    from tracker.pipeline import measure_tables
    from tracker.tables.table_options import TableOptions

    cameras = open_source(truth).camera_files()
    if not cameras:
        raise InputError(f"{truth}: no camera.json in it, expected one for the tracks")
    folder = output / "results"
    measure_tables(tracks, folder, cameras[0], TableOptions(point))
    return folder


def _score_tables(found: Path, truth: Path, output: Path, gate: float | None, name: str, as_json: bool) -> None:
    from tracker.scoring.external_tables import score_table

    if gate is not None and not gate > 0:
        raise InputError(f"--gate {gate:g}: expected a distance over 0")
    verdict = score_table(found, truth, gate, name)
    path = verdict.write(output)
    _print_notes(verdict.notes)
    _print_answer(verdict.to_dict(), verdict.summary(), path, as_json)


def _print_notes(notes: Iterable[object]) -> None:
    for note in notes:
        print(f"tracker: {note}", file=sys.stderr)


def _print_answer(
    keys: Mapping[str, Any], lines: Iterable[str], path: Path, as_json: bool, notes: Iterable[object] = ()
) -> None:
    """Print the keys as JSON, which hold the notes too, or the notes, the lines, and where the result is."""
    if not as_json:
        _print_notes(notes)
    print(json.dumps(keys) if as_json else "\n".join([*lines, f"{path}"]))


def _typed() -> str:
    """The command line of this process."""
    return shlex.join(["tracker", *sys.argv[1:]])


def _wants_pages(pages: bool | None, outcome: ClipOutcome, output: Path) -> bool:
    """Tell whether to write pages: as asked, or of a single recording that is not long."""
    if pages is not None or outcome.clips > 1:
        return bool(pages)
    from pyarrow.parquet import read_metadata

    (table,) = (output / "clips").glob("*/tracks.parquet")
    rows = read_metadata(table).num_rows
    if rows > MAX_ROWS_OF_A_PAGE:
        print(f"tracker: no page is written of {rows} positions; --pages writes it, in minutes", file=sys.stderr)
    return bool(rows <= MAX_ROWS_OF_A_PAGE)


def _pages(outcome: ClipOutcome, output: Path, given: Path, workers: int) -> str:
    """Write the pages of results; where the first one is."""
    from synthcam_shared.jobs import run_all_jobs
    from tracker.report.pages import PAGE, ResultPages

    numbers = [int(n) for n in outcome.estimates["clip"].unique()]
    with progress_bar("pages") as progress:
        pages = ResultPages(output, numbers, outcome.source, given.name, list(outcome.notes), _typed())
        todo = pages.missing()
        for done, _ in enumerate(run_all_jobs(pages.write, todo, workers, output), 1):
            progress(done, len(todo))
        pages.write_overview(outcome.estimates)
    return str(output / PAGE)


def _report(outcome: ClipOutcome, output: Path, extra: dict[str, Any], as_json: bool) -> None:
    from tracker.measurement.messages import list_messages
    from tracker.report.estimates_text import format_for_terminal

    for note, clips in outcome.notes.items():
        print(f"tracker: {note}{f' ({clips} of {outcome.clips} clips)' if outcome.clips > 1 else ''}", file=sys.stderr)
    states = {str(k): int(v) for k, v in outcome.estimates["status"].value_counts().sort_index().items()}
    messages = list_messages(outcome.estimates, str(output))
    _print_notes(messages)
    if as_json:
        summary = {"results": str(output), "clips": outcome.clips, "fresh": outcome.fresh, "status": states, **extra}
        summary |= {"warnings": [str(message) for message in messages]}
        summary |= {"collisions": [_collision(row) for row in outcome.estimates.to_dict("records")]}
        print(json.dumps(summary))
        return
    for line in format_for_terminal(outcome.estimates):
        print(line)
    counts = ", ".join(f"{count} {state}" for state, count in states.items())
    made = f"{outcome.fresh} made now" if outcome.fresh else "complete before"
    rows = len(outcome.estimates)  # a clip has a row for each of its collisions, or one
    print(
        f"{output}: {outcome.clips} clip{'s' * (outcome.clips != 1)}, {made}; "
        f"{rows} row{'s' * (rows != 1)} of estimates: {counts}"
    )
    if "ms_per_frame" in extra:
        print(f"{extra['frames']} frames, {extra['ms_per_frame']} ms a frame")
    if "page" in extra:
        print(extra["page"])


def _collision(row: Mapping[Any, Any]) -> dict[str, Any]:
    """A row of estimates as --json has it: the recommended quantities in SI units, null for what is not known."""
    from synthcam_shared.json_values import replace_non_finite
    from tracker.measurement.collision.derived import QUANTITY_NAMES
    from tracker.measurement.local.recommendation import find_recommended_suffix

    columns = {name: f"{name}{find_recommended_suffix(row)}" for name in QUANTITY_NAMES}
    pairs = {
        name: {"value": replace_non_finite(row[at]), "std": replace_non_finite(row[f"{at}_std"])}
        for name, at in columns.items()
    }
    return {key: row[key] for key in ("clip", "collision", "status", "recommended", "why")} | pairs


def main() -> None:
    """Run the command line `tracker`; exit status: 0 done, whatever the clips' status; 2 bad input; 130 interrupted."""
    run(app, "tracker", (InputError,), ("track", "measure", "compare", "benchmark"), ("open",))


if __name__ == "__main__":
    main()
