"""Generation of a suite: films by the command `synthcam`, bounds of their positions, and the card."""

from __future__ import annotations

import os
import secrets
import shutil
import subprocess
import sys
from pathlib import Path

import yaml

from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress
from synthcam_shared.outputs import open_resumable, write_atomically
from tracker.benchmark.suite.bounds import write_bounds
from tracker.benchmark.suite.card import make_card_text
from tracker.benchmark.suite.definition import SuiteDefinition, SuiteFilm
from tracker.benchmark.suite.folder import DEFINITION, FILMS, SUITE, TRUTH, Suite, check_truth, open_suite, truth_digest
from tracker.results import load_json, write_json


def make_suite(
    output: Path,
    definition: SuiteDefinition,
    withhold: Path | None = None,
    seed: int | None = None,
    workers: int = 0,
    progress: Progress = lambda done, of: None,
    scheduler: str = "",
) -> Suite:
    """Make a suite. The same call continues after an interruption.

    The films go to `output`, and the truth to `withhold`, apart from the films, or else to output/truth. The default
    seed is that of the definition, or a random one where the truth is withheld. `workers` is the number of processes;
    0: one a core. A script without `if __name__ == "__main__"` needs 1. `progress` takes the number of finished steps
    and of all steps. `scheduler` is the address of a Dask scheduler, whose workers see the same folders; they film the
    clips and find the bounds. Raises InputError where a folder holds other files, or `synthcam` fails.
    """
    output = output.resolve()
    truth = withhold.resolve() if withhold else output / TRUTH
    if withhold and (output in truth.parents or truth in output.parents or truth == output):
        raise InputError(f"{truth}: is inside {output} or contains it; expected a separate folder for the truth")
    if (output / SUITE).is_file():
        return _reopen(output, truth, definition, seed)
    with open_resumable(output, "tracker benchmark make", "a new folder for the suite"):
        write_atomically(output / DEFINITION, definition.text)
        truth.mkdir(parents=True, exist_ok=True)
        chosen = _seed(truth, definition, seed, withhold is not None)
        steps = sum(2 + len(film.encoded) for film in definition.films)
        done = 0
        for number, film in enumerate(definition.films):
            _film(output, truth, film, chosen + number, scheduler)
            progress(done := done + 1, steps)
            for name, codec in film.encoded.items():
                folder, whole = output / FILMS / name, output / FILMS / film.name
                if not folder.exists():
                    asked = ["--format", codec, "--truth", str(truth / film.name), "-o", str(folder)]
                    _synthcam("export", str(whole), *asked)
                progress(done := done + 1, steps)
            write_bounds(output / FILMS / film.name, truth / film.name, workers, scheduler)
            progress(done := done + 1, steps)
        about = {
            "name": definition.data["name"],
            "version": definition.version,
            "size": definition.size,
            "split": "withheld" if withhold else "open",
            "seed": None if withhold else chosen,
            "licence": definition.data["licence"],
            "definition_sha256": definition.digest,
            "truth_sha256": truth_digest(truth, definition),
            "parts": {name: {"film": part.film, "clips": list(part.clips)} for name, part in definition.parts.items()},
        }
        write_atomically(output / "README.md", make_card_text(about, definition))
        write_json(output / SUITE, about)
    return open_suite(output, truth)


def _reopen(output: Path, truth: Path, definition: SuiteDefinition, seed: int | None) -> Suite:
    """Open a complete suite. Raises InputError where it is another one."""
    suite = open_suite(output, truth)
    there = (suite.about["size"], suite.about["definition_sha256"])
    if there != (definition.size, definition.digest) or (seed is not None and suite.about["seed"] not in (None, seed)):
        raise InputError(f"{output}: holds another suite (version {suite.about['version']}), expected a new folder")
    return check_truth(suite)


def _seed(truth: Path, definition: SuiteDefinition, seed: int | None, withheld: bool) -> int:
    """Choose the seed and keep it with the truth, for the same call after an interruption."""
    seed_file = "seed.json"  # with the truth
    known = truth / seed_file
    if known.is_file():
        return int(load_json(known)["seed"])
    chosen = seed if seed is not None else secrets.randbits(48) if withheld else int(definition.data["seed"])
    write_json(known, {"seed": chosen})
    return chosen


def _film(output: Path, truth: Path, film: SuiteFilm, seed: int, scheduler: str) -> None:
    """Generate the clips of a film, with the truth in its own folder."""
    scenes = output / "scenes"
    files = {scenes / f"{name}.yaml": {**scene, "name": name} for name, scene in film.scenes.items()}
    for path, scene in files.items():
        write_atomically(path, yaml.safe_dump(scene, sort_keys=False))
    (output / FILMS).mkdir(exist_ok=True)
    asked = ["--clips", str(film.clips), "--seed", str(seed), "--withhold-truth", str(truth / film.name)]
    asked += ["--scheduler", scheduler] if scheduler else []
    _synthcam("generate", *map(str, files), "-o", str(output / FILMS / film.name), *asked)
    shutil.rmtree(scenes)


def _synthcam(*words: str) -> None:
    """Run the command `synthcam`. Raises InputError with its last message."""
    command = [sys.executable, "-m", "synthcam", *words]
    env = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False, env=env)
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.strip()]
        raise InputError(f"synthcam {words[0]} ended with status {done.returncode}: {said[-1] if said else ''}")
