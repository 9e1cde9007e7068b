"""Which verdicts depend on which threshold: opened boxes of a published round searched again with one changed.

    sensitivity.py [FIELD ...] [--round 7] [--studies nulls,limit:6] [--boxes 5] [--factors 0.5,2] [--jobs 2]
                   [--minutes 60] [-o out/sensitivity]
    sensitivity.py --table         the table alone, of all searches so far

FIELD: names of `SearchPolicy` (src/discrepancy/policy.py), all by default. The tracks of each box are made again from
its truth. They are searched once with the default policy and once with each field times each factor. A cosine has its
distance from 1 multiplied; a count is rounded, to 1 at least. Each search is a line of
searches.jsonl, written when it ends; a study resumes where it stopped. Searches by another version of the code do not
count.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy

from benchmarks.search.blind import ROOT, ROUNDS, code
from benchmarks.search.sealed import rounds
from benchmarks.search.sealed.analysis import analyse
from benchmarks.search.sealed.evidence import prepare
from benchmarks.search.sealed.judge import judge
from benchmarks.search.sealed.ledger import append, lines
from discrepancy.policy import SearchPolicy, applied_policy
from synthcam.model import Model, write_model

FIELDS = list(SearchPolicy.model_fields)
AS_IT_IS = ("", 1.0)
HEADS = ["constant", "value", "factor", "changed to", "boxes", "verdicts changed", "now wrong", "now right", "which"]
Json = dict[str, Any]
Change = tuple[str, float]  # a field and the factor


def default(name: str) -> float | int:
    """The default of a field of the policy."""
    value: float | int = SearchPolicy.model_fields[name].default
    return value


def changed(name: str, factor: float) -> float | int:
    """The default of a field, times the factor."""
    value = default(name)
    if isinstance(value, int):
        return max(1, int(value * factor + 0.5))
    return 1 - (1 - value) * factor if name.endswith("_cosine") else value * factor


def changes(names: Sequence[str], factors: Sequence[float]) -> list[Change]:
    """Those that change anything, and none first."""
    every = [(name, factor) for name in names for factor in factors]
    return [AS_IT_IS, *(c for c in every if changed(*c) != default(c[0]))]


def search_box(line: Json, todo: Sequence[Change], place: Path, until: float, version: str) -> str:
    """Make the tracks of an opened box again and search them with each of these changes; what was done, in a line."""
    truth, count = line["truth"], 0
    with tempfile.TemporaryDirectory(prefix="box-") as temporary:
        folder = Path(temporary)
        measured, camera = prepare(truth, folder / "evidence")
        model = folder / "model.yaml"
        write_model(Model(), model)
        for name, factor in todo:
            if time.time() > until:
                break
            change: dict[str, Any] = {name: changed(name, factor)} if name else {}
            with applied_policy(SearchPolicy(**change)):
                answer = analyse(measured, camera, model, folder)
            row = judge({"truth": truth, "answer": answer})
            said = {"study": truth["study"], "box": truth["box"], "constant": name, "factor": factor, "code": version}
            said |= {"verdict": row.verdict, "called": sorted(row.called), "right": row.right or row.right_class}
            append(place, said | {"classes": sorted(map(sorted, row.classes)), "cpu": answer.get("cpu")})
            count += 1
    return f"{truth['study']} {truth['box']}: {count} of {len(todo)} searches"


def opened(options: argparse.Namespace) -> list[Json]:
    """The boxes asked for: the first so many of each study, those of all studies in turn."""
    asked, chosen = set(filter(None, options.studies.split(","))), []
    for line in rounds.read_boxes(ROUNDS / options.round):
        truth = line["truth"]
        study, box = truth["study"].removesuffix(f"-{options.round}"), truth["box"]
        wanted = not asked or asked & {study, f"{study}:{box}"}
        few = options.boxes is None or box < options.boxes
        if wanted and few and (options.filmed or truth["source"] != "video"):
            chosen.append(line)
    return sorted(chosen, key=lambda o: (o["truth"]["box"], o["truth"]["study"]))


def run(options: argparse.Namespace, place: Path) -> None:
    version, until = code(), time.time() + 60 * options.minutes
    done = {(r["study"], r["box"], r["constant"], r["factor"]) for r in lines(place) if r["code"] == version}
    asked = changes(options.constants or FIELDS, [float(f) for f in options.factors.split(",")])
    jobs = []
    for line in opened(options):
        key = line["truth"]["study"], line["truth"]["box"]
        todo = [c for c in asked if (*key, *c) not in done]
        jobs += [(line, todo)] if todo else []
    with ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
        waiting = [pool.submit(search_box, line, todo, place, until, version) for line, todo in jobs]
        for one in as_completed(waiting):
            try:
                print(one.result(), flush=True)
            except Exception as e:
                print(f"a box could not be searched: {e!r}", file=sys.stderr, flush=True)


def table(found: Iterable[Json]) -> str:
    """For each change: boxes, and how many of their answers differ from those without it, of one version only."""
    rows = {(r["study"], r["box"], r["constant"], r["factor"]): r for r in found if r["code"] == code()}
    before = {(study, box): r for (study, box, *change), r in rows.items() if tuple(change) == AS_IT_IS}
    order, out = {name: k for k, name in enumerate(FIELDS)}, []
    for name, factor in sorted({(c, f) for *_, c, f in rows if c in order}, key=lambda c: (order[c[0]], c[1])):
        pairs = [(before[r["study"], r["box"]], r) for (s, b, *c), r in rows.items()
                 if c == [name, factor] and (s, b) in before]  # fmt: skip
        others = [(a, b) for a, b in pairs if any(a[k] != b[k] for k in ("verdict", "called", "classes"))]
        worse = [b for a, b in others if a["right"] and not b["right"]]
        better = [b for a, b in others if b["right"] and not a["right"]]
        which = "; ".join(f"{b['study']} {b['box']}: {_said(a)} -> {_said(b)}" for a, b in others)
        values = [f"{x:.4g}" for x in (default(name), changed(name, factor))]
        counts = [str(len(x)) for x in (pairs, others, worse, better)]
        out.append([name, values[0], f"{factor:g}", values[1], *counts, which])
    right = sum(r["right"] for r in before.values())
    about = f"{len(before)} boxes searched as things are, {right} of them answered rightly (by name or class)."
    return "\n".join([about, "", *(f"| {' | '.join(r)} |" for r in [HEADS, ["---"] * len(HEADS), *out])])


def _said(row: Json) -> str:
    return " ".join([row["verdict"], *("/".join(names) for names in row["classes"])])


def main() -> None:
    parser = argparse.ArgumentParser(description="Opened boxes searched again with one threshold changed.")
    parser.add_argument("constants", nargs="*", metavar="FIELD", help="fields of SearchPolicy; default all")
    parser.add_argument("--round", default="7", help="a published round")
    parser.add_argument("--studies", default="", help="of the round, or STUDY:BOX, separated by commas; default all")
    parser.add_argument("--boxes", type=int, help="the first so many of each study; default all")
    parser.add_argument("--filmed", action="store_true", help="boxes from film too")
    parser.add_argument("--factors", default="0.5,2", help="separated by commas")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--nice", type=int, default=10)
    parser.add_argument("--minutes", type=float, default=1e6, help="begin no search after so long")
    parser.add_argument("--table", action="store_true", help="only print the table")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "sensitivity")
    options = parser.parse_args()
    if unknown := set(options.constants) - set(FIELDS):
        parser.error(f"no field {', '.join(sorted(unknown))} in SearchPolicy")
    if not (ROUNDS / options.round / rounds.ABOUT).exists():
        parser.error(f"no round {options.round} in {ROUNDS}")
    place = options.output / "searches.jsonl"
    if not options.table:
        options.output.mkdir(parents=True, exist_ok=True)
        os.nice(options.nice)
        run(options, place)
    print(table(lines(place)))


if __name__ == "__main__":
    main()
