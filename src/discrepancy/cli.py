"""discrepancy: find what a model lacks, or add a candidate of your own."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from synthcam.library import add_effects
from synthcam.model import read_model, write_model
from synthcam_shared.application import EVERY, command_line, progress_bar, run
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable
from tracker.camera.camera import Camera

app = command_line(
    "discrepancy", "Where do simulation and measured tracks disagree, and which effect is missing from the model?"
)
STAGES = ("noise", "fit", "free laws", "search", "gap", "where", "report")
MeasuredPath = Annotated[
    Path, typer.Argument(metavar="MEASURED", help="RESULTS of a tracker, or a table of tracks (CSV or Parquet).")
]
CameraPath = Annotated[Path | None, typer.Option("--camera", metavar="camera.json", help="The camera of a table.")]
ModelPath = Annotated[Path, typer.Option("--model", metavar="MODEL.yaml", help="The model to hold against the tracks.")]
EffectsDir = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="DIR", help="A folder with effects of your own, NAME.py; more than one may be."),
]
Json = Annotated[bool, typer.Option("--json", help="Print a machine-readable summary.")]


@contextmanager
def show_stages(names: Sequence[str]) -> Iterator[Callable[[str], None]]:
    """A bar of the stages passed, and the time, on a terminal; elsewhere a line now and then. Yields what is told them.

    How long a stage takes is not known beforehand, so there is no estimate. Where a search begins again, the bar goes
    back to the fit.
    """
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task, passed, turn = bar.add_task(names[0], total=len(names)), 0, 1
        began = said = time.monotonic()

        def progress(stage: str) -> None:
            nonlocal passed, turn, said
            at = names.index(stage)
            if stage == "fit" and at < passed:
                passed, turn = at, turn + 1
            passed = max(passed, at)
            told = stage + (f", round {turn}" if turn > 1 else "")
            bar.update(task, completed=passed, description=told)
            now = time.monotonic()
            if bar.disable and now - said >= EVERY:
                said = now
                print(f"{told} after {now - began:.0f} s", file=sys.stderr, flush=True)

        yield progress


@app.command()
def find(
    measured: MeasuredPath,
    model: ModelPath,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT", help="Folder to write.")],
    camera: CameraPath = None,
    effects_dir: EffectsDir = None,
    minutes: Annotated[
        float, typer.Option(min=0.0, help="After which a search is cut short; it then names nothing.")
    ] = 10.0,
    policy: Annotated[
        Path | None,
        typer.Option(metavar="POLICY.yaml", help="Thresholds that decide, in place of the defaults (SearchPolicy)."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Search for what the model lacks, name it, and show the gap shrink on collisions kept out of every fit.

    Example: discrepancy find out/results --model scenes/painter_behringer.yaml -o out/search
    """
    from discrepancy.data.reading import read_collisions
    from discrepancy.finding import searched
    from discrepancy.policy import SearchPolicy, applied_policy, read_policy
    from discrepancy.report import search_page
    from synthcam_shared.report.folder import replace_folder

    started = time.monotonic()
    _add_effect_folders(effects_dir)
    given, thresholds = read_model(model), read_policy(policy) if policy else SearchPolicy()
    with (
        applied_policy(thresholds),
        replace_folder(output, search_page.FILES, "a report of an earlier search") as folder,
    ):
        _print_camera_notes(measured, camera)
        clips, notes = read_collisions(measured, camera)
        left_out = [str(n) for n in notes]
        with show_stages(STAGES) as progress:
            found = searched(clips, given, left_out, progress, 60 * minutes)
            progress("report")
            search_page.write(found.outcome, folder, found.left_out)
        document = json.loads((folder / "discrepancy.json").read_text())
    seconds = time.monotonic() - started
    print(json.dumps(document | {"seconds": round(seconds, 2)}) if as_json else found.sentence())
    if not as_json:
        for line in document["processed"]:
            print(f"The tracks: {line}.")
        _print_left_out(document["clips"]["left_out"], len(left_out) > len(clips))
        used = f"{len(found.outcome.data.clips) + len(found.outcome.data.kept_out)} of {len(clips) + len(left_out)}"
        print(f"{output / 'index.html'}  ({used} collisions, {seconds:.0f} s)")


@app.command()
def add(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="An effect of the library (synthcam effects).")],
    model: ModelPath,
    measured: Annotated[Path, typer.Option("--fit", metavar="MEASURED", help="RESULTS or tracks to fit it to.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="NEW.yaml", help="Model file to write.")],
    camera: CameraPath = None,
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Add an effect that you suspect to a model and fit its strength, with everything else, to measured tracks.

    Example: discrepancy add plate_tilt --model model.yaml --fit out/results -o tilted.yaml
    """
    from discrepancy.add import add as fitted
    from discrepancy.add import check_effect
    from discrepancy.data.reading import read_collisions

    _add_effect_folders(effects_dir)
    given = read_model(model)
    check_effect(effect)
    if output.is_dir():
        raise InputError(f"{output}: a folder; expected the name of a model file")
    check_writable(output)
    _print_camera_notes(measured, camera)
    clips, notes = read_collisions(measured, camera)
    left_out = [str(n) for n in notes]
    with show_stages(("noise", "fit", "search")) as progress:
        new = fitted(clips, given, effect, progress)
    output.parent.mkdir(parents=True, exist_ok=True)
    beside = output.with_name(f"{output.name}.{os.getpid()}.tmp")
    with as_input_error(output):
        try:
            write_model(new.fit.model, beside)
            beside.replace(output)
        finally:
            beside.unlink(missing_ok=True)
    if as_json:
        lost = [*left_out, *new.left_out]
        print(json.dumps({"model": str(output)} | new.document() | {"clips": len(clips), "left_out": lost}))
    else:
        print(f"{output}: {new.sentence()} ({len(clips)} of {len(clips) + len(left_out)})")
        _print_left_out([*left_out, *new.left_out], len(left_out) > len(clips))


@app.command()
def adopt(
    report: Annotated[Path, typer.Argument(metavar="REPORT", help="What `discrepancy find` wrote.")],
    name: Annotated[str, typer.Option("--name", metavar="NAME", help="Of the effect, as slick_patch.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for effects.")] = Path(
        "effects"
    ),
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Make an effect of the law outside the library that a search found: DIR/NAME.py, and DIR/NAME.yaml, which has it.

    Example: discrepancy adopt out/search --name slick_patch -o effects
    """
    from discrepancy.adopt import adopt as adopted

    _add_effect_folders(effects_dir)
    new = adopted(report, name, output)
    if as_json:
        print(json.dumps(new.document()))
        return
    print(f"{new.effect}: {new.formula or 'its curve, since no short formula in Python suffices'}")
    print(f"{new.model}: the model with it; elsewhere say\n  {new.line}")
    print(f"and give --effects {output} to each command")


def _add_effect_folders(folders: Sequence[Path] | None) -> None:
    for folder in folders or ():
        add_effects(folder)


@app.command()
def plan(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="The experiment: a scene's file.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT", help="Folder to write.")],
    effects: Annotated[
        list[str] | None,
        typer.Option(metavar="NAMES", help="Separated by commas, default: all; or a folder with effects of your own."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(metavar="MODEL.yaml", help="The physics, in place of the scene's.")
    ] = None,
    clips: Annotated[int, typer.Option(metavar="N", help="Collisions to record.")] = 30,
    noise: Annotated[
        float | None, typer.Option(metavar="PX", help="Error of a position; default: what camera and lamp allow.")
    ] = None,
    limit: Annotated[
        list[str] | None, typer.Option(metavar="EFFECT=STRENGTH", help="How many collisions would show so little?")
    ] = None,
    changes: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change the scene.")] = None,
    seed: Annotated[int, typer.Option(metavar="S", help="Of everything drawn.")] = 0,
    as_json: Json = False,
) -> None:
    """Say what an experiment could show before a recording is made, and which change of it would show more.

    Example: discrepancy plan scenes/oblique.yaml --clips 30 -o out/plan
    """
    from discrepancy.plan_experiment import plan as planned
    from discrepancy.report import plan_page
    from synthcam.scene.scene import read_scene
    from synthcam_shared.report.folder import replace_folder

    started = time.monotonic()
    _add_effect_folders([Path(text) for text in effects or () if Path(text).is_dir()])
    names = [n.strip() for text in effects or () if not Path(text).is_dir() for n in text.split(",") if n.strip()]
    given, wanted = read_scene(scene, tuple(changes or ()), model), _parse_limits(limit or [])
    with replace_folder(output, plan_page.FILES, "an earlier plan") as folder, progress_bar("experiments") as progress:
        found = planned(given, names or None, clips, noise, wanted, seed, progress=progress)
        plan_page.write(found.outcome, folder)
    if as_json:
        print(json.dumps(found.document() | {"seconds": round(time.monotonic() - started, 2)}))
        return
    print(found.sentence())
    for w in found.wanted:
        print(f"{w.sentence()}.")
    print(f"{output / 'index.html'}  ({time.monotonic() - started:.0f} s)")


def _parse_limits(texts: Sequence[str]) -> dict[str, float]:
    """Of "plate_tilt=1e-5", strengths by name."""
    found = {}
    for text in texts:
        name, _, size = text.partition("=")
        try:
            found[name] = float(size)
        except ValueError:
            raise InputError(f"--limit {text}: expected EFFECT=STRENGTH, as in plate_tilt=1e-5") from None
    return found


def _print_camera_notes(measured: Path, camera: Path | None) -> None:
    """On stderr, what in a table's camera.json nothing reads or accounts for, as the tracker says it."""
    if camera is not None and measured.is_file():
        for note in Camera.read(camera).unmodelled:
            print(f"discrepancy: {note}", file=sys.stderr)


def _print_left_out(left_out: Sequence[str], most: bool) -> None:
    if most:
        print("Most collisions are left out; are fps, scale and ball_diameter of the camera right?")
    if left_out:
        print(f"Left out: {'; '.join(left_out)}")


def main() -> None:
    """Entry point: 0 done, 2 bad input, 130 interrupted."""
    run(app, "discrepancy", (InputError,))


if __name__ == "__main__":
    main()
