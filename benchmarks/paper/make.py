"""make paper: the experiment of Painter & Behringer (2000), filmed, tracked and analysed as in the paper.

    python -m benchmarks.paper.make [--figure NAME] [--quick] [-o out/paper] [--workers N]

It writes every figure and every number of the paper to a page, index.html and paper.pdf. It keeps the tracks of each
series and the scan over models as tables. An interrupted run therefore continues, and a second run makes only the
figures and the page. With --figure it remakes one figure, as NAME.svg and NAME.png. With --quick it films a fifth of
the clips, into out/paper-quick, to test that everything works.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: films and scan use processes

from benchmarks.harness import ROOT
from benchmarks.paper import experiment
from benchmarks.paper.models import contradictions, scan
from benchmarks.paper.report import page
from benchmarks.paper.results import Results
from synthcam_shared.application import progress_bar


def film(results: Results, names: Iterable[str], workers: int, quick: bool) -> None:
    """Series of the paper."""
    for series in map(experiment.SERIES.__getitem__, names):
        wanted = experiment.smaller(series) if quick else series
        with progress_bar(f"filming {series.about}") as progress:
            experiment.film(wanted, results.series, workers, progress)


def compare(results: Results, workers: int, quick: bool) -> None:
    """The scan over models, films of the leading ones, and the plan of what would decide."""
    with progress_bar("comparison of effects with the paper") as progress:
        scan.scan(results.output, workers, quick, progress)
    for leader in contradictions.leaders(results.scan):
        with progress_bar(f"filming {leader.name}") as progress:
            contradictions.film(leader, results.series, workers, quick, progress)
    contradictions.plan(results.output, quick)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="paper", description=__doc__.partition("\n")[0])
    parser.add_argument("--figure", help=f"one figure alone: {', '.join(page.figures())}")
    parser.add_argument("--quick", action="store_true", help="a fifth of the clips")
    parser.add_argument("-o", "--output", type=Path, help="default: out/paper")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0: one a core")
    given = parser.parse_args(arguments)
    if given.figure is not None and given.figure not in page.figures():
        parser.exit(2, f"paper: --figure: expected one of {', '.join(page.figures())}, not {given.figure}\n")
    output = given.output or ROOT / "out" / ("paper-quick" if given.quick else "paper")
    results, began = Results(output.resolve()), time.monotonic()
    try:
        results.series.mkdir(parents=True, exist_ok=True)
        film(results, page.needs(given.figure) if given.figure else experiment.SERIES, given.workers, given.quick)
        if given.figure is None or page.compares(given.figure):
            compare(results, given.workers, given.quick)
        made = page.write_figure(results, given.figure) if given.figure else page.write(results)
    except KeyboardInterrupt:
        print("paper: interrupted; the same command continues", file=sys.stderr)
        sys.exit(130)
    print(f"{made}, after {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
