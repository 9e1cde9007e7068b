"""The commands of `tracker benchmark`: make, run, submit."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from synthcam_shared.application import progress_bar

app = typer.Typer(
    help="One benchmark for every tracker: make its films, run trackers on them, submit results.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
Json = Annotated[bool, typer.Option("--json", help="Print a machine-readable summary.")]
Size = Annotated[str, typer.Option(help="full (20 minutes on two cores with the peers) or small (a few minutes).")]
Own = Annotated[Path | None, typer.Option("--definition", metavar="YAML", help="A suite of your own.")]
Report = Annotated[Path, typer.Option("-o", "--output", metavar="REPORT", help="Folder to make, or to add to.")]
Scheduler = Annotated[str, typer.Option(metavar="ADDRESS", help="A Dask scheduler, whose workers do the work.")]
Truth = Annotated[Path | None, typer.Option(metavar="TRUTH", help="Folder of a withheld truth.")]


@app.command()
def make(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="SUITE", help="Folder to make.")],
    size: Size = "full",
    definition: Own = None,
    withhold_truth: Annotated[
        Path | None, typer.Option(metavar="TRUTH", help="Separate folder for the truth; the seed is then random.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of all random draws; default: that of the suite.")
    ] = None,
    scheduler: Scheduler = "",
    as_json: Json = False,
) -> None:
    """Make the films of the suite, the truth in a separate folder, and the card.

    Example: tracker benchmark make -o out/suite
    """
    from tracker.benchmark.suite.definition import read_definition
    from tracker.benchmark.suite.make import make_suite as make_suite

    with progress_bar("steps") as progress:
        chosen = read_definition(definition, size)
        suite = make_suite(output, chosen, withhold_truth, seed, progress=progress, scheduler=scheduler)
    said = {"suite": str(output), "truth": str(suite.truth), **suite.about}
    print(
        json.dumps(said) if as_json else f"{output}: version {said['version']}, {len(suite.parts)} parts; {suite.truth}"
    )


@app.command()
def run(
    output: Report,
    suite: Annotated[Path | None, typer.Option(metavar="SUITE", help="Default: made in REPORT/suite.")] = None,
    trackers: Annotated[
        str, typer.Option(help="Names, separated by commas; default: ours and those of other packages.")
    ] = "",
    size: Size = "full",
    truth: Truth = None,
    scheduler: Scheduler = "",
    as_json: Json = False,
) -> None:
    """Make the suite, run trackers on it, and compare them on one page.

    Example: tracker benchmark run -o out/benchmark

    Example: tracker benchmark run --trackers synthcam,my_detector --size small -o out/mine
    """
    from tracker.benchmark.contest import SUITE, open_contest_report, run_contest
    from tracker.benchmark.suite.definition import check_truth, open_suite, read_definition
    from tracker.benchmark.suite.make import make_suite as make_suite
    from tracker.benchmark.trackers import parse_names

    parse_names(trackers)  # before films are made for minutes
    with progress_bar("steps") as progress:
        if suite is None:
            chosen = read_definition(None, size)
            with open_contest_report(output):  # or its own suite would make the folder a foreign one
                pass
            made = make_suite(output / SUITE, chosen, progress=progress, scheduler=scheduler)
        else:
            made = check_truth(open_suite(suite, truth))
    with progress_bar("trackers") as progress:
        entries, notes = run_contest(made, output, trackers, _command_line(), progress, scheduler)
    _print_leaderboard(entries, notes, output, as_json)


@app.command()
def submit(
    suite: Annotated[Path, typer.Argument(metavar="SUITE", help="The suite whose films were tracked.")],
    tables: Annotated[Path, typer.Argument(metavar="FOLDER", help="submission.json, and a table for each film.")],
    output: Report,
    truth: Truth = None,
    as_json: Json = False,
) -> None:
    """Score the tables of a tracker in any language, and add it to a report.

    SUITE/README.md and docs/benchmark.md describe FOLDER.

    Example: tracker benchmark submit out/suite my_tables -o out/benchmark
    """
    from tracker.benchmark.contest import score_submission
    from tracker.benchmark.suite.definition import check_truth, open_suite

    with progress_bar("films") as progress:
        entries, notes = score_submission(
            check_truth(open_suite(suite, truth)), tables, output, _command_line(), progress
        )
    _print_leaderboard(entries, notes, output, as_json)


def _command_line() -> str:
    """Return the command line that the user typed."""
    return shlex.join(["tracker", *sys.argv[1:]])


def _print_leaderboard(entries: Sequence[Mapping[str, Any]], notes: Sequence[str], output: Path, as_json: bool) -> None:
    from tracker.benchmark.report.leaderboard import make_leaderboard_row

    for note in notes:
        print(f"tracker: {note}", file=sys.stderr)
    rows = [make_leaderboard_row(rank, one) for rank, one in enumerate(entries, 1)]
    if as_json:
        print(json.dumps({"report": str(output), "notes": list(notes), "leaderboard": rows}))
        return
    print(f"{'':<30}{'score':>7}{'rmse/bound':>12}{'found':>8}{'false':>10}{'HOTA':>8}{'crowds':>8}{'ms/frame':>10}")
    for line in rows:
        keys = ("score", "ratio_median", "found", "false_per_ball", "hota", "crowd_hota", "ms_per_frame")
        texts = ["–" if line[key] is None else f"{line[key]:.3g}" for key in keys]
        widths = (7, 12, 8, 10, 8, 8, 10)
        print(f"{line['name']:<30}" + "".join(f"{text:>{width}}" for text, width in zip(texts, widths, strict=True)))
    print(output / "index.html")
