"""Blind trials of the search: sealed boxes, opened once; every goal of the search with the figure reached.

    blind.py [STUDY ...] [--boxes N] [--round R] [--jobs J] [--minutes M] [--secret FILE] [-o out/blind]
    blind.py round --round R       200 boxes of all kinds, each effect and each outsider among them
    blind.py publish --round R     the round and its secret into rounds/R beside this file; no box is opened after
    blind.py verify [R ...]        holds published rounds against their ledgers; --redraw: and their secrets
    blind.py table [R] [--write]   the tables of docs/blind.md; --write puts them there
    blind.py --page [--round R]    the page alone, of all boxes opened so far, or of one round

A study resumes where it stopped; another round has other boxes. They are drawn from a secret that is made at the first
box. Its hash, and that of each truth, is on record before the analysis. The analysis runs in a process of its own and
receives tracks and camera only. The studies tracks and video draw all kinds at 0.85 to 20 times the detection limit;
the others ask one question each. The page is index.html in the output.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import multiprocessing
import os
import secrets
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: its matrices here are too small to share out

from benchmarks.search.sealed import oracle, page, rounds
from benchmarks.search.sealed.boxes import Study, Truth
from benchmarks.search.sealed.drawing import draw
from benchmarks.search.sealed.evidence import isolated_environment, prepare
from benchmarks.search.sealed.judge import judge
from benchmarks.search.sealed.ledger import Broken, Ledger
from benchmarks.search.sealed.studies import ROUND, STUDIES
from synthcam.model import Model, write_model

ROOT = Path(__file__).resolve().parents[2]
ROUNDS = Path(__file__).with_name("rounds")
DOCS = ROOT / "docs" / "blind.md"
SOURCES = ("src/discrepancy", "src/synthcam", "src/tracker", "benchmarks/search/sealed")


def code() -> str:
    """A fingerprint of all that makes the boxes, answers them and judges."""
    digest = hashlib.sha256()
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:8]


def trial(study: Study, box: int, output: Path, secret: str) -> str:
    """Seal, analyse and open one box; return a line about it."""
    ledger = Ledger(output, study.name)
    ledger.commit(secret)
    ledger.seal(box, draw(study, box, secret))
    with tempfile.TemporaryDirectory(prefix="box-") as temporary:
        folder = Path(temporary)
        said = ledger.recall_answer(box)
        if said is None:
            said = {"code": code()} | answer_box(ledger.truth(box), folder)
            ledger.answer(box, said)
        beside = {"gap": oracle.gap(ledger.truth(box), said, folder)}  # {} of an answer by a run that was killed
        row = judge({"truth": ledger.open(box, said, beside), "answer": said} | beside)
    word = "right" if row.right else "right class" if row.right_class else "WRONG"
    return (
        f"{study.name} {box}: {row.kind} {'+'.join(row.hidden)} {row.ratio:.1f} {row.noise} {row.source} -> "
        f"{row.verdict} {'+'.join(row.called)} {word} ({row.cpu:.0f} s)"
    )


def answer_box(truth: Truth, folder: Path) -> dict[str, object]:
    """Make the evidence of a box and have it analysed; the answer."""
    try:
        measured, camera = prepare(truth, folder / "evidence")
    except RuntimeError as e:
        return {"verdict": "refused", "why": f"tracker: {e}"}
    model = folder / "model.yaml"
    write_model(Model(), model)
    return analyse_in_process(measured, camera, model, folder)


def analyse_in_process(measured: Path, camera: Path | None, model: Path, folder: Path) -> dict[str, object]:
    """The answer of a process that is given the evidence and the textbook model, and nothing else."""
    command = [sys.executable, str(ROOT / "benchmarks/search/sealed/analysis.py"), str(measured), str(camera or "-")]
    done = subprocess.run(
        [*command, str(model), str(folder)], capture_output=True, text=True, env=isolated_environment(), check=False
    )
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
    parser.add_argument("--secret", type=Path, help="what boxes are drawn from; default secret.txt in the output")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--nice", type=int, default=10)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no box after so long")
    parser.add_argument("--page", action="store_true", help="only write the page")
    parser.add_argument("--redraw", action="store_true", help="verify: draw every box again from the secret")
    parser.add_argument("--write", action="store_true", help="table: into docs/blind.md")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "blind")
    options = parser.parse_args()
    command = {"publish": publish, "verify": verify, "table": table}.get(options.studies[0] if options.studies else "")
    try:
        if command:
            options.studies = options.studies[1:]
            command(options)
        elif options.page and (ROUNDS / options.round / rounds.ABOUT).exists():
            options.output.mkdir(parents=True, exist_ok=True)
            print(page.write(options.output, rounds.judge_round(ROUNDS / options.round)))
        else:
            unknown = set(options.studies) - set(STUDIES) - {"round"}
            if unknown:
                parser.error(f"no study {', '.join(unknown)}; there are {', '.join(STUDIES)}")
            options.output.mkdir(parents=True, exist_ok=True)
            if not options.page:
                os.nice(options.nice)
                run(options)
            ending = f"-{options.round}" if options.round else ""
            print(page.write(options.output, [r for r in page.rows_in(options.output) if r.study.endswith(ending)]))
    except Broken as e:
        sys.exit(str(e))


def read_secret(options: argparse.Namespace, make: bool = False) -> str:
    """The secret's text. make: a new one where there is none yet; readable by its owner alone."""
    path = options.secret or options.output / "secret.txt"
    if make and not path.exists():
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(secrets.token_hex(32) + "\n")
    if not path.exists():
        raise Broken(f"{path}: there is no secret; --secret FILE names one")
    return str(path.read_text().strip())


def publish(options: argparse.Namespace) -> None:
    asked = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False)
    print(rounds.publish(options.output, options.round, read_secret(options), ROUNDS, asked.stdout.strip()))


def verify(options: argparse.Namespace) -> None:
    faults, chosen = [], [ROUNDS / name for name in options.studies] or rounds.list_published(ROUNDS)
    if not chosen:
        raise Broken(f"{ROUNDS}: no round is published")
    for place in chosen:
        if not (place / rounds.ABOUT).exists():
            raise Broken(f"{place}: there is no such round")
        found = rounds.verify(place)
        if options.redraw:
            codes = {row.code for row in rounds.judge_round(place)}
            if codes != {code()}:
                raise Broken(
                    f"{place.name}: drawn by code {', '.join(codes)}, this is {code()}; {rounds.describe_commit(place)}"
                )
            found += rounds.redraw_boxes(place)
        count, left = len(rounds.read_boxes(place)), rounds.list_unopened(place)
        print(f"{place.name}: {count} boxes, {len(found)} faults; never opened: {', '.join(left) or 'none'}")
        faults += found
    if faults:
        sys.exit("\n".join(faults))


def table(options: argparse.Namespace) -> None:
    """Print or write the tables of published rounds; by default of each study in the last round that has it."""
    chosen = [row for name in options.studies for row in rounds.judge_round(ROUNDS / name)] or rounds.latest(ROUNDS)
    text = rounds.render_tables(chosen, ROUNDS)
    if options.write:
        DOCS.write_text(rounds.insert_tables(DOCS.read_text(), text))
    else:
        print(text)


def plan(options: argparse.Namespace) -> list[tuple[str, int]]:
    """The studies asked for, and how many boxes of each."""
    if "round" not in options.studies:
        return [(name, options.boxes or STUDIES[name].boxes) for name in options.studies or STUDIES]
    if not options.round:
        raise Broken("a round wants a name: --round NAME")
    return list(ROUND.items())


def run(options: argparse.Namespace) -> None:
    if options.round and (ROUNDS / options.round).exists():
        raise Broken(f"round {options.round} is published, its secret with it: no box of it can be blind any more")
    todo, asked = [], plan(options)
    for name, boxes in asked:
        study = STUDIES[name]
        study = dataclasses.replace(study, name=f"{name}-{options.round}" if options.round else name)
        done = {row["box"] for row in Ledger(options.output, study.name).opened()}
        todo += [(study, k, boxes) for k in range(boxes) if k not in done]
    todo.sort(key=lambda t: t[1] / t[2])  # a stopped run has its share of each study
    secret, last = read_secret(options, make=True), time.monotonic() + 60 * options.minutes
    for name in dict.fromkeys(study.name for study, _, _ in todo):
        Ledger(options.output, name).commit(secret)
    with ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
        busy = set()
        for study, box, _ in todo:
            if time.monotonic() > last:
                break
            busy.add(pool.submit(trial, study, box, options.output, secret))
            while len(busy) >= options.jobs:
                busy -= _wait_for_one(busy)
        while busy:
            busy -= _wait_for_one(busy)


def _wait_for_one(busy: set) -> set:  # type: ignore[type-arg]
    """Wait for one box; say what came of it, whatever it was."""
    one = next(as_completed(busy))
    try:
        print(one.result(), flush=True)
    except Exception as e:
        print(f"a box could not be made: {e!r}", file=sys.stderr, flush=True)
    return {one}


if __name__ == "__main__":
    main()
