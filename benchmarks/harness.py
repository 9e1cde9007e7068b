"""Functions that benchmarks share: run commands of the project, read arguments, and save figures."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def program(name: str) -> Path:
    """A command of the environment that this benchmark runs in."""
    return Path(sys.executable).with_name(name)


def run(*command: str | Path, quiet: bool = False, alone: bool = False) -> str:
    """Run one of the project's commands from the project's root; what it wrote to stdout.

    quiet: its output is not shown. alone: its matrix products use one thread. A command that fails ends the benchmark
    with one line.
    """
    words = [str(word) for word in command]
    print("$", *words, file=sys.stderr, flush=True)
    done = subprocess.run(
        [program(words[0]), *words[1:]],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | (ONE_THREAD if alone else {}),
        check=False,
    )
    if not quiet:
        print(done.stdout, end="", flush=True)
    if done.returncode:
        sys.exit(f"{Path(sys.argv[0]).stem}: {' '.join(words)} ended with status {done.returncode}")
    return done.stdout


def add_clones(parser: argparse.ArgumentParser) -> None:
    """Add the paths to clones of the recordings of others, by default those of the variable CLONES."""
    default = [Path(p) for p in os.environ.get("CLONES", "").split()]
    parser.add_argument("clones", nargs="*", type=Path, default=default)


def save(path: Path, figures: Any) -> None:
    """Write figures as JSON, the folder made where it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(figures, indent=1) + "\n")


def keep(path: Path, part: str, measure: Callable[[], Any]) -> Any:
    """The figures of a part: those of its line of `path`, or measured and added there, so that a stopped run continues.

    A run that is killed may leave the last line without its end; its part is measured again. Delete the file to measure
    all again.
    """
    written = path.read_text() if path.is_file() else ""
    whole = written[: written.rfind("\n") + 1]
    kept = {line["part"]: line["figures"] for line in map(json.loads, whole.splitlines())}
    if part not in kept:
        path.parent.mkdir(parents=True, exist_ok=True)
        kept[part] = json.loads(json.dumps(measure()))
        line = json.dumps({"part": part, "figures": kept[part]}) + "\n"
        with path.open("a") as file:
            file.truncate(len(whole.encode()))
            file.write(line)
    return kept[part]
