"""discrepancy: find what a model lacks, or add a suspect of your own."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from synthcam.model import read_model, write_model
from synthcam.settings import InputError as ModelError
from tracker.geometry import InputError

app = typer.Typer(
    help="Where do simulation and measured tracks disagree, and which effect is missing from the model?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
REPORT = ("discrepancy.json", "index.html", "model.yaml")
MeasuredPath = Annotated[
    Path, typer.Argument(metavar="MEASURED", help="RESULTS of a tracker, or a table of tracks (CSV or Parquet).")
]
CameraPath = Annotated[Path | None, typer.Option("--camera", metavar="camera.json", help="The camera of a table.")]
ModelPath = Annotated[Path, typer.Option("--model", metavar="MODEL.yaml", help="The model to hold against the tracks.")]
Json = Annotated[bool, typer.Option("--json", help="Print a machine-readable summary.")]


@contextmanager
def stages() -> Iterator[Progress]:
    """A line that tells the stage and the time, on a terminal; nothing elsewhere."""
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        yield bar


@contextmanager
def aside(output: Path) -> Iterator[Path]:
    """A folder to write into that becomes `output` when all went well. Refuses a folder that holds something else."""
    output = output.absolute()
    if output.exists() and (not output.is_dir() or any(p.name not in REPORT for p in output.iterdir())):
        raise InputError(f"{output}: holds something else; expected a report of an earlier search, or nothing")
    folder = output.with_name(f"{output.name}.{os.getpid()}.tmp")
    folder.mkdir(parents=True)
    try:
        yield folder
        shutil.rmtree(output, ignore_errors=True)
        folder.rename(output)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@app.command()
def find(
    measured: MeasuredPath,
    model: ModelPath,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT", help="Folder to write.")],
    camera: CameraPath = None,
    as_json: Json = False,
) -> None:
    """Search for what the model lacks, name it, and show the gap shrink on collisions kept out of every fit.

    Example: discrepancy find out/results --model scenes/painter_behringer.yaml -o out/search
    """
    from discrepancy import report
    from discrepancy.find import find as search
    from discrepancy.measured import read_measured

    started = time.monotonic()
    suspect = read_model(model)
    clips, left_out = read_measured(measured, camera)
    with aside(output) as folder:
        with stages() as bar:
            task = bar.add_task("fit")
            found = search(clips, suspect, lambda stage: bar.update(task, description=stage))
            bar.update(task, description="report")
            report.write(found, folder, left_out)
        document = json.loads((folder / "discrepancy.json").read_text())
    seconds = time.monotonic() - started
    print(json.dumps(document | {"seconds": round(seconds, 2)}) if as_json else found.sentence())
    if not as_json:
        print(f"{output / 'index.html'}  ({len(clips)} collisions, {seconds:.0f} s)")


@app.command()
def add(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="An effect of the library (synthcam effects).")],
    model: ModelPath,
    fit: Annotated[Path, typer.Option("--fit", metavar="MEASURED", help="RESULTS or tracks to fit it to.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="NEW.yaml", help="Model file to write.")],
    camera: CameraPath = None,
    as_json: Json = False,
) -> None:
    """Add an effect that you suspect to a model and fit its strength, with everything else, to measured tracks.

    Example: discrepancy add plate_tilt --model model.yaml --fit out/results -o tilted.yaml
    """
    from discrepancy.find import add as fitted
    from discrepancy.measured import read_measured

    suspect = read_model(model)
    if output.is_dir():
        raise InputError(f"{output}: a folder; expected the name of a model file")
    clips, _ = read_measured(fit, camera)
    with stages() as bar:
        bar.add_task("fit")
        new = fitted(clips, suspect, effect)
    beside = output.with_name(f"{output.name}.{os.getpid()}.tmp")
    write_model(new, beside)
    beside.replace(output)
    values = {k: v for e in new.effects if e.name() == effect for k, v in vars(e).items()}
    summary = {"model": str(output), "effect": effect, "parameters": values}
    said = f"{output}: {effect}: " + ", ".join(f"{k} = {v:.4g}" for k, v in values.items())
    print(json.dumps(summary) if as_json else said)


def main() -> None:
    """Entry point: 0 done, 2 bad input, 130 interrupted."""
    try:
        app()
    except (InputError, ModelError) as e:
        print(f"discrepancy: {e}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("discrepancy: interrupted; nothing was written", file=sys.stderr)
        sys.exit(130)
    except OSError as e:
        print(f"discrepancy: {e.filename or 'file'}: {e.strerror or e}", file=sys.stderr)
        sys.exit(2)
