"""REPORT/index.html of a benchmark: pictures first, then tables, what each figure means, and the card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from synthcam_shared.outputs import write_atomically
from tracker.benchmark.report.figures import (
    DEFECTS,
    axes_figure,
    cell,
    defects_figure,
    headline_figure,
    name_of,
    publication_figure,
)
from tracker.benchmark.report.leaderboard import row
from tracker.benchmark.suite.card import CITATION
from tracker.benchmark.suite.definition import SuiteDefinition
from tracker.report.html import describe_creation, embed_figure, render
from tracker.scoring.figures import SHOWN

Entries = Sequence[Mapping[str, Any]]
Table = tuple[str, list[str], list[list[str]]]
QUANTITIES = ("r", "mu_k", "C", "tau1", "energy_fraction")
SHIFTED = ("r", "tau1", "energy_fraction")
GOOD, BAD = 1.2, 2.0  # times the bound: where a tracker is said to be at it, and where it fails
MEANINGS = {
    "score": "100 × the mean, over the columns of the first picture that have a bound, of the share of balls found and "
    "nothing else, n / (n + missed + false), times bound / rmse, 1 at most. 100: every ball, nothing else, at the "
    "bound.",
    "rmse / bound": "root mean square error of a found centre, each axis, over the least that the sensor's noise "
    "allows (Cramér and Rao). 1 is the limit. Of encoded films the bound is that of the film before it was encoded.",
    "found, false": "share of the balls wholly in view with a detection within 5 px; detections without a ball, over "
    "the number of balls.",
    "phase bias": "how far the mean error follows the place of the glint within its pixel: peak to peak of its first "
    "wave, px.",
    "z": "error over the error bar that the tracker claims, root mean square: 1 where error bars hold, over 1 where "
    "they are too small.",
    "alpha, beta, JSC, JSC θ": "Particle Tracking Challenge (Chenouard et al. 2014), gate 5 px: positions of paired "
    "tracks, the same with a penalty for spurious tracks, and the shares of positions and of tracks that are paired.",
    "MOTA, IDF1, HOTA": "Bernardin & Stiefelhagen 2008; Ristani et al. 2016; Luiten et al. 2021, with the similarity "
    "1 - distance / 5 px.",
    "published": "the mean error of a quantity over all collisions, each weighted by the error bar that it claims, ± "
    "the error bar of that mean: what would have been published, less the truth.",
    "defects": "each defect alone is put into true tracks with the noise of the bound, which are then measured: how "
    "far that moves r, τ1 and the energy, in error bars of one collision.",
    "ms a frame": "processor time of finding and linking, 320 x 240, one process; of a submission what its authors "
    "say.",
}


def write_page(report: Path, entries: Entries, definition: SuiteDefinition, about: Mapping[str, Any], how: str) -> Path:
    """Write the page; how: what it says that made it."""
    pictures = {
        "headline": embed_figure(headline_figure(entries, definition)),
        "axes": embed_figure(axes_figure(entries, definition)),
    }
    for part in definition.named_parts("measured"):
        pictures[f"published {part}"] = embed_figure(publication_figure(entries, part, QUANTITIES))
    for kind, word in (("_free", "free fit"), ("", "tied fit")):
        drawn = defects_figure(entries, SHIFTED, kind)
        if drawn is not None:
            pictures[f"defects {word}"] = embed_figure(drawn)
    values = {
        "about": about,
        "title": definition.data["name"],
        "pictures": pictures,
        "verdicts": [(name_of(e), *judge(e, definition)) for e in entries],
        "board": [row(rank, e) for rank, e in enumerate(entries, 1)],
        "tables": list(make_tables(entries, definition)),
        "meanings": MEANINGS,
        "citation": CITATION.format(version=version("synthcam")),
        "made": describe_creation(how),
        "text": _text,
    }
    write_atomically(report / "index.html", render(Path(__file__).with_name("page.html"), **values))
    return report / "index.html"


def judge(entry: Mapping[str, Any], definition: SuiteDefinition) -> tuple[str, str]:
    """Where a tracker is at the bound, and the three settings where it fails most."""
    good, held, bad = 0, 0, []
    for part, word in definition.headline.items():
        figures = entry["parts"].get(part)
        if figures is None:
            continue
        text, value = cell(figures)
        plain = " ".join(text.split()) if value is None else ", ".join(text.split("\n"))
        if figures["ratio"] is None and value is not None:
            continue
        held += 1
        if value is None:
            bad.append((1e9 - (figures["jaccard"] or 0.0), f"{word} ({plain})"))
        elif value > BAD:
            bad.append((value, f"{word} (× {plain})"))
        good += value is not None and value <= GOOD
    worst = ", ".join(text for _, text in sorted(bad, reverse=True)[:3])
    return f"{good} of {held}", worst or "nowhere by more than twice the bound"


def make_tables(entries: Entries, definition: SuiteDefinition) -> list[Table]:
    """Positions and tracks of each part, quantities, defects."""
    out: list[Table] = []
    heads = ["tracker", *definition.parts]
    for title, key, digits in (
        ("rmse / bound", "ratio", 3),
        ("rmse, px, each axis", "rmse_px", 3),
        ("found, share of the balls in view", "found", 4),
        ("false detections", "false", 4),
        ("phase bias, px", "phase_bias_px", 2),
        ("z of positions: 1 where the claimed error bars hold", "z", 3),
        ("HOTA", "hota", 4), ("MOTA", "mota", 4), ("IDF1", "idf1", 4),
        ("alpha", "alpha", 4), ("beta", "beta", 4), ("JSC", "jsc", 4), ("JSC θ", "jsc_theta", 4),
    ):  # fmt: skip
        rows = [
            [name_of(e), *(_text(e["parts"].get(p, {}).get(key), digits) for p in definition.parts)] for e in entries
        ]
        out.append((title, heads, rows))
    for part in definition.named_parts("measured"):
        for kind, word in (("", "tied fit"), ("_free", "free fit")):
            out.append(_quantity_table(entries, part, kind, f"{part}, {word}: rmse (/ bound; z std; collisions)"))
    kept = [e for e in entries if e["defects"]]
    if kept:
        out.append(_defect_table(kept))
    return out


def _quantity_table(entries: Entries, part: str, kind: str, title: str) -> Table:
    rows = []
    for entry in entries:
        cells = [name_of(entry)]
        for name in QUANTITIES:
            q = entry["quantities"].get(part, {}).get(f"{name}{kind}") or {}
            factor = SHOWN[name][2]
            rmse = None if q.get("rmse") is None else q["rmse"] * factor
            cells.append(f"{_text(rmse, 3)} ({_text(q.get('ratio'), 2)}; {_text(q.get('z_std'), 2)}; {q.get('n', 0)})")
        rows.append(cells)
    units = {"$10^{-3}$": "0.001", "µs": "µs"}
    return title, ["tracker", *(f"{name}, {units.get(SHOWN[name][1], SHOWN[name][1])}" for name in QUANTITIES)], rows


def _defect_table(entries: Entries) -> Table:
    heads = ["tracker", "locking, px", "glint, share", "lost, share"]
    heads += [f"{word}: {name}" for word in DEFECTS.values() for name in SHIFTED]
    rows = []
    for entry in entries:
        found = entry["defects"]
        cells = [name_of(entry), *(_text(found["size"][defect], 2) for defect in DEFECTS)]
        for defect in DEFECTS:
            for name in SHIFTED:
                one = found[defect].get(f"{name}_free") or {}
                bias = None if one.get("bias") is None else one["bias"] * SHOWN[name][2]
                cells.append(f"{_text(bias, 2)} ({_text(one.get('in_errors'), 2)})")
        rows.append(cells)
    title = (
        "Defects alone: their size, and the mean shift (in error bars) of r and energy, 0.001, and tau1, µs, free fit"
    )
    return title, heads, rows


def _text(value: Any, digits: int = 3) -> str:
    if value is None:
        return "–"
    return str(value) if isinstance(value, int | str) else f"{value:.{digits}g}"
