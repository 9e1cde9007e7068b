"""Blind trials of the search: sealed boxes, opened once; every goal of the search with the figure reached.

    benchmarks/blind.py [STUDY ...] [--boxes N] [--round R] [--jobs J] [--minutes M] [-o out/blind]
    benchmarks/blind.py --page                the page alone, of all boxes opened so far

A study goes on where it stopped; another round has other boxes. The hash of each truth is on record before the
analysis, which runs in a process of its own and is given tracks and camera. Studies: tracks and video draw nothing,
one effect, two, one from outside the library or a tracker's defect, at 1 to 20 times its own detection limit; nulls,
power, naming, pairs, outside, those filmed and defects put one question each. index.html in the output is the page.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: its matrices here are too small to share out

from sealed import oracle, page
from sealed.boxes import Study, Truth, draw
from sealed.evidence import alone, prepare
from sealed.judge import judge
from sealed.ledger import Ledger
from synthcam.model import Model, write_model

ROOT = Path(__file__).resolve().parent.parent
ALL = {"none": 0.2, "one": 0.4, "two": 0.15, "outside": 0.15, "defect": 0.1}
STUDIES = {
    s.name: s
    for s in (
        Study("tracks", ALL, 300),
        Study("nulls", {"none": 0.8, "defect": 0.2}, 300),
        Study("power", {"one": 1}, 200, ratios=(1, 2, 5, 10)),
        Study("naming", {"one": 1}, 100, ratios=(2,), naming=True),
        Study("pairs", {"two": 1}, 100, ratios=(5,)),
        Study("outside", {"outside": 1}, 100, ratios=(2, 5)),
        Study("video", ALL, 40, filmed=True),
        Study("filmed", {"none": 0.2, "one": 0.8}, 40, ratios=(1.5, 5), filmed=True),
        Study("filmed_nulls", {"none": 1}, 30, filmed=True),
        Study("filmed_power", {"one": 1}, 20, ratios=(2,), filmed=True),
        Study("filmed_naming", {"one": 1}, 20, ratios=(2,), naming=True, filmed=True),
        Study("filmed_pairs", {"two": 1}, 20, ratios=(5,), filmed=True),
        Study("filmed_outside", {"outside": 1}, 20, ratios=(2, 5), filmed=True),
        Study("defects", {"defect": 1}, 20, filmed=True),
    )
}


SOURCES = ("src/discrepancy", "src/synthcam", "src/tracker", "benchmarks/sealed")


def code() -> str:
    """A fingerprint of all that makes the boxes, answers them and judges."""
    digest = hashlib.sha256()
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:8]


def trial(study: Study, box: int, output: Path) -> str:
    """Seal, analyse and open one box; a line that tells of it."""
    ledger = Ledger(output, study.name)
    ledger.seal(box, draw(study, box))
    with tempfile.TemporaryDirectory(prefix="box-") as temporary:
        folder = Path(temporary)
        said = ledger.answered(box)
        if said is None:
            said = {"code": code()} | answered(ledger.truth(box), folder)
            ledger.answer(box, said)
        beside = {"gap": oracle.gap(ledger.truth(box), said, folder)}  # {} of an answer by a run that was killed
        row = judge({"truth": ledger.open(box, said, beside), "answer": said} | beside)
    word = "right" if row.right else "right class" if row.kin else "WRONG"
    return (
        f"{study.name} {box}: {row.kind} {'+'.join(row.hidden)} {row.ratio:.1f} {row.noise} {row.source} -> "
        f"{row.verdict} {'+'.join(row.called)} {word} ({row.cpu:.0f} s)"
    )


def answered(truth: Truth, folder: Path) -> dict[str, object]:
    """Make the evidence of a box and have it analysed; the answer."""
    try:
        measured, camera = prepare(truth, folder / "evidence")
    except RuntimeError as e:
        return {"verdict": "refused", "why": f"tracker: {e}"}
    model = folder / "model.yaml"
    write_model(Model(), model)
    return analysed(measured, camera, model, folder)


def analysed(measured: Path, camera: Path | None, model: Path, folder: Path) -> dict[str, object]:
    """The answer of a process that is given the evidence and the textbook model, and nothing else."""
    command = [sys.executable, str(ROOT / "benchmarks/sealed/analysis.py"), str(measured), str(camera or "-")]
    done = subprocess.run([*command, str(model), str(folder)], capture_output=True, text=True, env=alone(), check=False)
    if done.returncode < 0:  # killed, as the whole study may be: the box stays shut
        raise RuntimeError(f"the analysis was ended by signal {-done.returncode}")
    path = folder / "answer.json"
    if not path.exists():
        return {"verdict": "crashed", "why": done.stderr[-500:]}
    answer: dict[str, object] = json.loads(path.read_text())
    return answer


def main() -> None:
    parser = argparse.ArgumentParser(description="Blind trials of the search.")
    parser.add_argument("studies", nargs="*", metavar="STUDY", help=f"of {', '.join(STUDIES)}; default all")
    parser.add_argument("--boxes", type=int, help="how many of each study; default its own number")
    parser.add_argument("--round", default="", help="a name for boxes that have not been opened before")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--nice", type=int, default=10)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no box after so long")
    parser.add_argument("--page", action="store_true", help="only write the page")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "blind")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    unknown = set(options.studies) - set(STUDIES)
    if unknown:
        parser.error(f"no study {', '.join(unknown)}; there are {', '.join(STUDIES)}")
    if not options.page:
        os.nice(options.nice)
        run(options)
    print(page.write(options.output))


def run(options: argparse.Namespace) -> None:
    todo = []
    for name in options.studies or STUDIES:
        study = STUDIES[name]
        study = dataclasses.replace(study, name=f"{name}-{options.round}" if options.round else name)
        done = {row["box"] for row in Ledger(options.output, study.name).opened()}
        todo += [(study, k) for k in range(options.boxes or study.boxes) if k not in done]
    todo.sort(key=lambda t: t[1])  # a little of each study first
    last = time.monotonic() + 60 * options.minutes
    with ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
        busy = set()
        for study, box in todo:
            if time.monotonic() > last:
                break
            busy.add(pool.submit(trial, study, box, options.output))
            while len(busy) >= options.jobs:
                busy -= _ended(busy)
        while busy:
            busy -= _ended(busy)


def _ended(busy: set) -> set:  # type: ignore[type-arg]
    """Wait for one box; say what came of it, whatever it was."""
    one = next(as_completed(busy))
    try:
        print(one.result(), flush=True)
    except Exception as e:
        print(f"a box could not be made: {e!r}", file=sys.stderr, flush=True)
    return {one}


if __name__ == "__main__":
    main()
