"""Ordinary inputs: is each kind of film, table and command measured rightly, or refused in one line?

python -m benchmarks.tracker.ordinary_inputs [--inputs DIR] [--only WORD] [--program DIR]    # or make bench-...

Each case makes one small input by code, runs a command of the project on it, and compares the result with the truth of
the simulation (within 3 standard errors), or the message with the one that a user needs. The table has a row for each:
the command, what came out, what is right, and the seconds of processor time. The exit status is 1 if any is not right.

--inputs adds the files of a folder, those of the table in `ordinary.files`. --only "WORD; WORD" takes the cases with
one of these words in their topic or kind. --program DIR runs the commands of another checkout, to compare an older
version. Results also go to out/ordinary_inputs/results.csv and results.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from benchmarks.harness import ROOT
from benchmarks.tracker.ordinary import colours, commands, contacts, films, interrupts, large, tables, users, videos
from benchmarks.tracker.ordinary.case import Case, Program, Row, judge_case
from benchmarks.tracker.ordinary.files import list_files

TOPICS: tuple[Callable[[], Sequence[Case]], ...] = (
    films.list_cases, videos.list_cases, tables.list_cases, contacts.list_cases, colours.list_cases, users.list_cases,
    commands.list_cases, interrupts.list_cases, large.list_cases,
)  # fmt: skip


def run_cases(cases: Sequence[Case], program: Program, show: Callable[[Row], None]) -> Iterator[Row]:
    """The row of each case, each in a folder of its own that is removed afterwards."""
    for case in cases:
        with tempfile.TemporaryDirectory(prefix="ordinary-", ignore_cleanup_errors=True) as folder:
            row = judge_case(case, program, Path(folder))
        show(row)
        yield row


def show_row(row: Row) -> None:
    """Print a row, its values below each other, because they are long."""
    print(f"{row.verdict:9}  {row.topic}: {row.kind}  ({row.seconds:.1f} s)", flush=True)
    print(f"    $ {row.command}\n    got   {row.got}\n    right {row.right}", flush=True)


def count_verdicts(rows: Sequence[Row]) -> str:
    """The last line of the table."""
    counts, seconds = Counter(row.verdict for row in rows), sum(row.seconds for row in rows)
    parts = [f"{counts[verdict]} {verdict}" for verdict in ("right", "NOT RIGHT", "not made")]
    return f"{len(rows)} cases: {', '.join(parts)}; {seconds:.0f} s of processor time"


def write_results(rows: Sequence[Row], folder: Path, last_line: str) -> None:
    """The table as results.csv and results.md."""
    folder.mkdir(parents=True, exist_ok=True)
    pd.DataFrame([asdict(row) for row in rows], columns=list(Row.__dataclass_fields__)).to_csv(
        folder / "results.csv", index=False
    )
    lines = ["| kind | command | what came out | right value | | s |", "|---|---|---|---|---|---|"]
    for row in rows:
        cells = [f"{row.topic}: {row.kind}", f"`{row.command}`", row.got, row.right, row.verdict, f"{row.seconds:.1f}"]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    (folder / "results.md").write_text("\n".join([*lines, "", last_line, ""]), encoding="utf-8")


def select_cases(only: str, inputs: Path | None) -> list[Case]:
    """All cases, or those with one of the words in their topic or kind, between which are semicolons."""
    every = [case for make in TOPICS for case in make()] + (list_files(inputs) if inputs else [])
    words = [word.strip().lower() for word in only.split(";")]
    return [case for case in every if any(word in f"{case.topic}: {case.kind}".lower() for word in words)]


def main() -> None:
    """Run all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=Path, help="a folder of further inputs")
    parser.add_argument("--only", default="", help="a word of the topic or kind")
    parser.add_argument("--program", type=Path, default=ROOT, help="the checkout whose commands are run")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "ordinary_inputs")
    asked = parser.parse_args()
    cases = select_cases(asked.only, asked.inputs.resolve() if asked.inputs else None)
    rows: list[Row] = []
    try:
        for row in run_cases(cases, Program(asked.program.resolve()), show_row):
            rows.append(row)
    except KeyboardInterrupt:
        print("interrupted: the table ends here", file=sys.stderr)
    last_line = count_verdicts(rows)
    write_results(rows, asked.output, last_line)
    print(last_line)
    sys.exit(130 if len(rows) < len(cases) else int(any(row.verdict == "NOT RIGHT" for row in rows)))


if __name__ == "__main__":
    main()
