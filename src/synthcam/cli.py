"""synthcam: generate, preview, verify, schema, effects, doctor."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from synthcam.settings import InputError

app = typer.Typer(
    help="Rolling steel balls that collide: their exact motion, their picture, and the truth about both.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
Json = Annotated[bool, typer.Option("--json", help="Print a machine-readable summary.")]
Set = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the scene.")]


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with an estimate on a terminal; nothing elsewhere."""
    console = Console(stderr=True)
    columns = (
        TextColumn(what),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@app.command()
def generate(
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENE...", help="Scene files (YAML).")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DATASET", help="Folder to make.")],
    clips: Annotated[int, typer.Option(min=1, help="Clips of each scene.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything drawn.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one a core.")] = None,
    no_video: Annotated[bool, typer.Option("--no-video", help="Truth and camera only, nothing drawn.")] = False,
    set_: Set = None,
    as_json: Json = False,
) -> None:
    """Make a dataset: simulate, draw, expose, write. Interrupted, the same command goes on.

    Example: synthcam generate scenes/benchmark.yaml -o out/benchmark --clips 100
    """
    from synthcam.generate import Plan, run
    from synthcam.scene import read_scene

    started = time.monotonic()
    plan = Plan(tuple(read_scene(s, tuple(set_ or ())) for s in scenes), clips, seed, not no_video)
    size = plan.bytes()
    if sys.stderr.isatty():
        print(f"{plan.total} clips, about {size / 1e6:,.0f} MB", file=sys.stderr)
    with progress("clips") as tick:
        outcome = run(plan, output, workers or os.cpu_count() or 1, tick)
    for line in outcome.failed:
        print(f"synthcam: {line}", file=sys.stderr)
    seconds = time.monotonic() - started
    summary = {
        "dataset": str(output),
        "clips": plan.total,
        "made": outcome.made,
        "failed": len(outcome.failed),
        "seconds": round(seconds, 2),
    }
    _say(summary, as_json, f"{output}: {plan.total} clips, {outcome.made} made now in {seconds:.1f} s")
    if outcome.failed:
        kept = f"; the rest are kept in {output}.partial" if len(outcome.failed) < plan.total else ""
        raise InputError(f"{output}: {len(outcome.failed)} of {plan.total} clips could not be made{kept}")


@app.command()
def preview(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="A scene file (YAML).")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="A .png to write.")],
    clip: Annotated[int, typer.Option(min=0, help="Which clip to draw.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything drawn.")] = 0,
    frame: Annotated[int | None, typer.Option(min=0, help="Which frame; default: the one before the contact.")] = None,
    magnify: Annotated[int, typer.Option(min=0, help="Also show the balls so many times larger; 0: not.")] = 12,
    set_: Set = None,
) -> None:
    """Draw one frame of a scene, as the sensor gives it, with the balls magnified beside it.

    Example: synthcam preview scenes/painter_behringer.yaml -o frame.png
    """
    from synthcam.preview import write_preview
    from synthcam.scene import read_scene

    if output.suffix.lower() != ".png":
        raise InputError(f"{output}: expected a name that ends in .png")
    write_preview(read_scene(scene, tuple(set_ or ())).draw(clip, seed), seed, output, frame, magnify)
    print(output)


@app.command()
def verify(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET")],
    as_json: Json = False,
) -> None:
    """Hold every file of a dataset to its checksum. Exit status 1 when one is changed, missing or new.

    Example: synthcam verify out/benchmark
    """
    from synthcam.dataset import verify as check

    found = check(dataset)
    for problem in found.problems:
        print(problem, file=sys.stderr)
    ok = not found.problems
    _say(
        {"dataset": str(dataset), "files": found.files, "problems": list(found.problems)},
        as_json,
        f"{dataset}: {found.files} files, {'all as written' if ok else f'{len(found.problems)} problems'}",
    )
    if not ok:
        raise typer.Exit(1)


@app.command()
def effects(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="One effect; default: all.")] = None,
    as_json: Json = False,
) -> None:
    """The library of effects: laws, parameters, realistic sizes.

    Example: synthcam effects plate_tilt
    """
    from synthcam.effect import library

    known = library()
    if name is not None and name not in known:
        raise InputError(f"{name}: no such effect; there are {', '.join(known)}")
    for effect in known.values() if name is None else [known[name]]:
        doc = (effect.__doc__ or "").strip()
        if as_json:
            parameters = [vars(p) | {"low": _limit(p.low), "high": _limit(p.high)} for p in effect.parameters()]
            laws = list(effect.laws)
            print(json.dumps({"effect": effect.name(), "law": doc, "bends": laws, "parameters": parameters}))
            continue
        print(f"{effect.name()}: {doc.splitlines()[0]}")
        if name is not None:
            print(*(f"    {line.strip()}" for line in doc.splitlines()[1:]), sep="\n")
            for p in effect.parameters():
                kind = "shape" if p.fixed else "strength"
                print(f"    {p.name}: {kind}, {p.unit}, realistic {p.scale:g}, from {p.low:g} to {p.high:g}")


def _limit(x: float) -> float | None:
    return x if abs(x) < float("inf") else None


@app.command()
def schema() -> None:
    """Print the JSON Schema of a scene, for editors and other programs.

    Example: synthcam schema > scene.schema.json
    """
    from synthcam.scene import schema as make

    print(json.dumps(make(), indent=1))


@app.command()
def doctor(as_json: Json = False) -> None:
    """Tell which OpenGL draws the pictures and how fast; when none works, what to install.

    Example: synthcam doctor
    """
    from synthcam.preview import speed
    from synthcam.render import gl_info

    info: dict[str, Any] = dict(gl_info())
    info["frames_per_second"] = round(speed(), 1)
    text = "\n".join(f"{key}: {value}" for key, value in info.items())
    _say(info, as_json, text + "\n(two balls, 640 x 480, drawn and exposed by one process)")


def _say(summary: dict[str, Any], as_json: bool, text: str) -> None:
    print(json.dumps(summary) if as_json else text)


def main() -> None:
    """Entry point: 0 done, 1 a check failed, 2 bad input, 130 interrupted."""
    try:
        app()
    except InputError as e:
        print(f"synthcam: {e}", file=sys.stderr)
        sys.exit(2)
    except SystemExit as e:
        if e.code == 130:  # typer makes this of Ctrl-C, and says nothing
            print("synthcam: interrupted; the same command goes on where it stopped", file=sys.stderr)
        raise
    except OSError as e:
        print(f"synthcam: {e.filename or 'file'}: {e.strerror or e}", file=sys.stderr)
        sys.exit(2)
    except RuntimeError as e:
        if type(e).__name__ != "NoGL":
            raise
        print(f"synthcam: {e}", file=sys.stderr)
        sys.exit(2)
