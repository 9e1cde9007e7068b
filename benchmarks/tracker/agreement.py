"""Agreement of `tracker score` with TrackEval and motmetrics, which read the same two files themselves.

agreement.py TRUTH.txt FOUND.txt [TRUTH FOUND ...]    default: the example sets that come with motmetrics

TrackEval is needed, without the second OpenCV that it requires: pip install --no-deps trackeval==1.3.0

The two programs differ in one rule. motmetrics gives a ball back to the last track that it had, however long ago.
TrackEval gives it back to the track of the frame before. `tracker score` must agree with TrackEval.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tracker.scoring.external_tables import score_table

EXACT = 1e-9
EXAMPLES = ("TUD-Campus", "TUD-Stadtmitte")
SHOWN = ("mota", "motp", "idf1", "hota", "deta", "assa", "swaps")
Figures = dict[str, float]


def by_motmetrics(truth: Path, found: Path) -> Figures:
    """Its loader, its distances, its figures. Empty where it is not installed."""
    try:
        mm = importlib.import_module("motmetrics")
    except ImportError:
        return {}
    if not hasattr(np, "asfarray"):  # its distances ask for what numpy 2 no longer has
        setattr(np, "asfarray", lambda values: np.asarray(values, dtype=float))  # noqa: B010
    tables = [mm.io.loadtxt(path, fmt="mot15-2D", min_confidence=least) for path, least in ((truth, 1), (found, -1))]
    events = mm.utils.compare_to_groundtruth(*tables, "iou", distth=0.5)
    names = ["mota", "motp", "idf1", "num_switches"]
    row = mm.metrics.create().compute(events, metrics=names).iloc[0]
    return {"mota": row["mota"], "motp": 1 - row["motp"], "idf1": row["idf1"], "swaps": row["num_switches"]}


def by_trackeval(truth: Path, found: Path, folder: Path) -> Figures:
    """Its own reader of MOTChallenge's folders, its evaluator. Empty where it is not installed."""
    try:
        te = importlib.import_module("trackeval")
    except ImportError:
        return {}
    home, result = folder / "gt" / "set-train" / "one", folder / "found" / "set-train" / "theirs" / "data"
    for place in (home / "gt", result):
        place.mkdir(parents=True)
    shutil.copy(truth, home / "gt" / "gt.txt")
    shutil.copy(found, result / "one.txt")
    last = max(
        int(float(line.split(",")[0])) for path in (truth, found) for line in path.read_text().split("\n") if line
    )
    (home / "seqinfo.ini").write_text(f"[Sequence]\nname=one\nseqLength={last}\n")
    config = {
        "GT_FOLDER": str(folder / "gt"), "TRACKERS_FOLDER": str(folder / "found"), "BENCHMARK": "set",
        "SEQ_INFO": {"one": None}, "DO_PREPROC": False, "PRINT_CONFIG": False,
    }  # fmt: skip
    quiet, off = {"PRINT_CONFIG": False}, "PRINT_RESULTS TIME_PROGRESS OUTPUT_SUMMARY OUTPUT_DETAILED PLOT_CURVES"
    judge = te.Evaluator(quiet | {"USE_PARALLEL": False, "BREAK_ON_ERROR": True} | dict.fromkeys(off.split(), False))
    with contextlib.redirect_stdout(io.StringIO()):
        sets, measures = te.datasets.MotChallenge2DBox(config), te.metrics
        answer, _ = judge.evaluate([sets], [measures.HOTA(), measures.CLEAR(quiet), measures.Identity(quiet)])
    one = answer["MotChallenge2DBox"]["theirs"]["one"]["pedestrian"]
    out = {"mota": one["CLEAR"]["MOTA"], "motp": one["CLEAR"]["MOTP"], "swaps": one["CLEAR"]["IDSW"]}
    out["idf1"] = one["Identity"]["IDF1"]
    return out | {name: float(np.mean(one["HOTA"][key])) for name, key in
                  (("hota", "HOTA"), ("deta", "DetA"), ("assa", "AssA"))}  # fmt: skip


def examples() -> list[Path]:
    """Truth and found of the sets that come with motmetrics."""
    home = Path(importlib.import_module("motmetrics").__file__ or "").parent / "data"
    return [home / name / kind for name in EXAMPLES for kind in ("gt.txt", "test.txt")]


def show(truth: Path, found: Path) -> float:
    """A table of one set; the largest difference from TrackEval, and from motmetrics where the two agree."""
    ours: dict[str, Any] = score_table(found, truth).tracking
    with tempfile.TemporaryDirectory() as folder:
        theirs = {"TrackEval": by_trackeval(truth, found, Path(folder)), "motmetrics": by_motmetrics(truth, found)}
    table = Table("", "tracker score", *(cell for name in theirs for cell in (name, "less ours")))
    table.title = f"{truth.parent.name}: {found.name}"
    worst = 0.0
    for name in SHOWN:
        values = [figures.get(name) for figures in theirs.values()]
        off = [None if value is None else value - ours[name] for value in values]
        known = [abs(one) for one in off if one is not None]
        agree = len(known) < len(theirs) or abs(known[0] - known[1]) <= EXACT
        worst = max([worst, *(known if agree else known[:1])])
        cells = ("–" if v is None else form.format(v) for pair in zip(values, off, strict=True)
                 for v, form in zip(pair, ("{:.12g}", "{:.1e}"), strict=True))  # fmt: skip
        table.add_row(name, f"{ours[name]:.12g}", *cells)
    Console().print(table)
    return worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="*", help="Pairs of MOTChallenge files: truth and found.")
    files = parser.parse_args().files or examples()
    if len(files) % 2:
        parser.error("expected pairs of files: truth and found")
    worst = max(show(*pair) for pair in zip(files[::2], files[1::2], strict=True))
    print(f"largest difference: {worst:.1e}")
    sys.exit(int(worst > EXACT))


if __name__ == "__main__":
    main()
