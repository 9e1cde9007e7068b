"""The command discrepancy: find missing effects, add a suspected one, adopt a found law, or plan an experiment."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from discrepancy.time_left import LIMITED_STAGES, ONLY_LAWS, SearchClock
from synthcam.library import add_effects
from synthcam.model import list_model_settings, read_model, to_yaml
from synthcam_shared.application import make_command_line, progress_bar, read_progress_interval, run
from synthcam_shared.errors import InputError
from synthcam_shared.interruption import raise_if_interrupted
from synthcam_shared.outputs import as_input_error, check_not_read, check_replaceable, check_writable, write_atomically
from tracker.camera.camera import Camera

app = make_command_line(
    "discrepancy", "Find the physical effects that measured tracks show and a model of the collision lacks."
)
MeasuredPath = Annotated[
    Path, typer.Argument(metavar="MEASURED", help="Folder of tracker results, or a table of tracks (CSV or Parquet).")
]
CameraPath = Annotated[Path | None, typer.Option("--camera", metavar="camera.json", help="Camera file of a table.")]
ModelPath = Annotated[Path, typer.Option("--model", metavar="MODEL.yaml", help="The model to compare with the tracks.")]
EffectsDir = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="DIR", help="Folder with your own effects, NAME.py; may be repeated."),
]
ADDED = "# written by discrepancy add"  # the first line of its model files
Json = Annotated[bool, typer.Option("--json", help="Print a machine-readable summary.")]


@contextmanager
def show_stages(names: Sequence[str], limit_s: float = math.inf) -> Iterator[Callable[[str], None]]:
    """Show the progress of a command: stages done and the time, as a bar on a terminal, elsewhere as lines.

    Yields a function that takes the name of the current stage. The time left is an estimate (`SearchClock`), with what
    remains of the limit as a bound. If a search begins again, the bar returns to the fit.
    """
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task, passed, turn = bar.add_task(names[0], total=len(names)), 0, 1
        began, interval = time.monotonic(), read_progress_interval()
        printed, clock = began, SearchClock(limit_s, began)

        def progress(stage: str) -> None:
            nonlocal passed, turn, printed
            raise_if_interrupted()
            at = names.index(stage)
            if stage == "fit" and at < passed:
                passed, turn = at, turn + 1
            passed = max(passed, at)
            text = stage + (f", round {turn}" if turn > 1 else "")
            now = time.monotonic()
            clock.enter(stage, now)
            left = _describe_time_left(clock, stage, now)
            bar.update(task, completed=passed, description=text + left)
            if bar.disable and now - printed >= interval:
                printed = now
                print(f"{text} after {now - began:.0f} s{left}", file=sys.stderr, flush=True)

        yield progress


def _describe_time_left(clock: SearchClock, stage: str, now: float) -> str:
    likely, limit = clock.estimate_left(now), max(clock.limit_s - (now - clock.began), 0.0)
    about = f"about {likely:.0f} s" if likely >= 1 else ""
    at_most = f"at most {limit / 60:.1f} min" if stage in LIMITED_STAGES and limit < math.inf else ""
    return "".join(f", {text}" for text in (about, at_most) if text) + " left" * bool(about or at_most)


@app.command()
def find(
    measured: MeasuredPath,
    model: ModelPath,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT", help="Folder to write.")],
    camera: CameraPath = None,
    effects_dir: EffectsDir = None,
    minutes: Annotated[
        float, typer.Option(min=0.0, help="Time limit by the clock; a search that exceeds it names no effect.")
    ] = 10.0,
    policy: Annotated[
        Path | None,
        typer.Option(metavar="POLICY.yaml", help="Decision thresholds that replace the defaults (SearchPolicy)."),
    ] = None,
    stretches: Annotated[
        bool,
        typer.Option("--stretches", help="Search the free stretches between contacts, each with a start of its own."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Find the effects that --model lacks in MEASURED collisions, and test them on held-out ones.

    Example: discrepancy find out/results --model scenes/painter_behringer.yaml -o out/search
    """
    from discrepancy.data.contacts import read_contacts
    from discrepancy.data.notes import SearchNoteKind, count_lost_clips
    from discrepancy.data.reading import read_collisions
    from discrepancy.policy import SearchPolicy, applied_policy, read_policy
    from discrepancy.report import search_page
    from discrepancy.search import search
    from discrepancy.wording import describe_verdict
    from synthcam_shared.outputs import replace_folder

    started = time.monotonic()
    check_not_read(output, measured, model, camera, policy, *(effects_dir or ()))
    _add_effect_folders(effects_dir)
    given, thresholds = read_model(model), read_policy(policy) if policy else SearchPolicy()
    with (
        applied_policy(thresholds),
        replace_folder(output, search_page.FILES, "a report of an earlier search") as folder,
    ):
        _print_camera_notes(measured, camera)
        clips, notes = read_collisions(measured, camera, stretches, workers=0)
        for note in notes:
            if note.kind is SearchNoteKind.NO_STRIKER:  # at once: a search without it may look for the wrong ball
                print(f"discrepancy: {note}", file=sys.stderr)
        stages = ("noise", "fit", "free laws", "search", ONLY_LAWS, "gap", "where", "report")
        with show_stages(stages, 60 * minutes) as progress:
            contacts = read_contacts(measured) if stretches else None
            found = search(clips, given, progress, 60 * minutes, notes, stretches, contacts)
            found = replace(found, measured=str(measured), base_model=str(model))
            progress("report")
            search_page.write(found, folder)
        document = json.loads((folder / "discrepancy.json").read_text())
    seconds = time.monotonic() - started
    print(json.dumps(document | {"seconds": round(seconds, 2)}) if as_json else found.sentence())
    if not as_json:
        print(f"verdict: {describe_verdict(found)}")
        lost = count_lost_clips(notes)
        _print_notes(document["processed"], document["clips"]["left_out"], lost > len(clips))
        count = len(found.data.clips) + len(found.data.held_out)
        used = f"{count} {found.data.unit} of {len(clips)}" if stretches else f"{count} of {len(clips) + lost}"
        print(f"{output / 'index.html'}  ({used} collisions, {seconds:.0f} s)")


@app.command()
def add(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="An effect of the library (synthcam effects).")],
    model: ModelPath,
    measured: Annotated[Path, typer.Option("--fit", metavar="MEASURED", help="Results or tracks to fit it to.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="NEW.yaml", help="Model file to write.")],
    camera: CameraPath = None,
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Add a suspected EFFECT to --model and fit its strength, with all other parameters, to measured tracks.

    Example: discrepancy add plate_tilt --model model.yaml --fit out/results -o tilted.yaml
    """
    from discrepancy.add import add as fitted
    from discrepancy.add import check_effect
    from discrepancy.data.notes import count_lost_clips, sort_notes
    from discrepancy.data.reading import read_collisions

    check_not_read(output, model, measured, camera, *(effects_dir or ()))
    _add_effect_folders(effects_dir)
    given = read_model(model)
    check_effect(effect)
    if output.is_dir():
        raise InputError(f"{output}: a folder; expected the name of a model file")
    check_replaceable(output, ADDED.encode(), "discrepancy add")
    check_writable(output)
    _print_camera_notes(measured, camera)
    clips, notes = read_collisions(measured, camera, workers=0)
    with show_stages(("noise", "fit", "search")) as progress:
        new = fitted(clips, given, effect, progress)
    with as_input_error(output):
        write_atomically(output, f"{ADDED} {effect}\n{to_yaml(list_model_settings(new.fit.model))}")
    sorted_notes, lost = sort_notes(notes), count_lost_clips(notes)
    left_out, processed = [*map(str, sorted_notes.left_out), *new.left_out], list(map(str, sorted_notes.processed))
    if as_json:
        counts = {"clips": len(clips), "left_out": left_out, "processed": processed}
        print(json.dumps({"model": str(output)} | new.document() | counts))
    else:
        print(f"{output}: {new.sentence()} ({len(clips)} of {len(clips) + lost})")
        _print_notes(processed, left_out, lost > len(clips))


@app.command()
def adopt(
    report: Annotated[Path, typer.Argument(metavar="REPORT", help="Report folder of `discrepancy find`.")],
    name: Annotated[str, typer.Option("--name", metavar="NAME", help="Name of the new effect, as slick_patch.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of your own effects.")] = Path(
        "effects"
    ),
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Turn the free law that a search found into an effect, DIR/NAME.py, with a model file, DIR/NAME.yaml.

    Example: discrepancy adopt out/search --name slick_patch -o effects
    """
    from discrepancy.adopt import adopt as adopted

    _add_effect_folders(effects_dir)
    new = adopted(report, name, output)
    if as_json:
        print(json.dumps(new.document()))
        return
    print(f"{new.effect}: {new.formula or 'a table of its curve, since no short formula suffices'}")
    print(f"{new.model}: the model with it. In another model or scene, write\n  {new.line}")
    print(f"and give --effects {output} to each command.")


def _add_effect_folders(folders: Sequence[Path] | None) -> None:
    for folder in folders or ():
        add_effects(folder)


@app.command()
def plan(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file of the experiment.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT", help="Folder to write.")],
    effects: Annotated[
        list[str] | None,
        typer.Option(metavar="NAMES", help="Separated by commas (default: all), or a folder with your own effects."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(metavar="MODEL.yaml", help="Model that replaces the scene's physics.")
    ] = None,
    clips: Annotated[int, typer.Option(metavar="N", help="Collisions to record.")] = 30,
    noise: Annotated[
        float | None, typer.Option(metavar="PX", help="Error of a position; default: the limit of camera and lamp.")
    ] = None,
    limit: Annotated[
        list[str] | None, typer.Option(metavar="EFFECT=STRENGTH", help="Estimate how many collisions this limit takes.")
    ] = None,
    changes: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change the scene.")] = None,
    seed: Annotated[int, typer.Option(metavar="S", help="Seed of all random numbers.")] = 0,
    as_json: Json = False,
) -> None:
    """Predict which effects the experiment of SCENE could detect and name, and which change of it helps most.

    Example: discrepancy plan scenes/oblique.yaml --clips 30 -o out/plan
    """
    from discrepancy.plan_experiment import plan as planned
    from discrepancy.report import plan_page
    from synthcam.scene.scene import read_scene
    from synthcam_shared.outputs import replace_folder

    started = time.monotonic()
    check_not_read(output, scene, model)
    _add_effect_folders([Path(text) for text in effects or () if Path(text).is_dir()])
    names = [n.strip() for text in effects or () if not Path(text).is_dir() for n in text.split(",") if n.strip()]
    given, wanted = read_scene(scene, tuple(changes or ()), model), _parse_limits(limit or [])
    with replace_folder(output, plan_page.FILES, "an earlier plan") as folder, progress_bar("experiments") as progress:
        found = planned(given, names or None, clips, noise, wanted, seed, progress=progress)
        plan_page.write_plan(found.outcome, folder)
    if as_json:
        print(json.dumps(found.document() | {"seconds": round(time.monotonic() - started, 2)}))
        return
    print(found.sentence())
    for w in found.wanted:
        print(f"{w.sentence()}.")
    print(f"{output / 'index.html'}  ({time.monotonic() - started:.0f} s)")


def _parse_limits(texts: Sequence[str]) -> dict[str, float]:
    """Parse texts as "plate_tilt=1e-5" into strengths by name."""
    found = {}
    for text in texts:
        name, _, size = text.partition("=")
        try:
            found[name] = float(size)
        except ValueError:
            raise InputError(f"--limit {text}: expected EFFECT=STRENGTH, as in plate_tilt=1e-5") from None
    return found


def _print_camera_notes(measured: Path, camera: Path | None) -> None:
    """Print to stderr which keys of a table's camera file have no influence, as the tracker does."""
    if camera is not None and measured.is_file():
        for note in Camera.read(camera).unmodelled:
            print(f"discrepancy: {note}", file=sys.stderr)


def _print_notes(processed: Sequence[str], left_out: Sequence[str], most: bool) -> None:
    for line in processed:
        print(f"Tracks: {line}.")
    if most:
        print("Most collisions are left out. Check fps, scale and ball_diameter in the camera file.")
    if left_out:
        print(f"Left out: {'; '.join(left_out)}")


def main() -> None:
    """Run the command line `discrepancy`; exit status: 0 done, 2 bad input, 130 interrupted."""
    run(app, "discrepancy", (InputError,))


if __name__ == "__main__":
    main()
