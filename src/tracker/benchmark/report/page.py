"""REPORT/index.html of a benchmark: figures, tables, the meaning of each measure, and the card of the suite."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from markupsafe import Markup

from synthcam_shared.report.numbers import format_number
from synthcam_shared.report.page import Block, PageFigure, PageSection, PageTable, write_page
from tracker.benchmark.report import figures
from tracker.benchmark.report.leaderboard import Entries, Entry, make_leaderboard_row
from tracker.benchmark.suite.definition import SuiteDefinition
from tracker.benchmark.suite.make import CITATION
from tracker.report.quantities import QUANTITIES

PUBLISHED = ("r", "mu_k", "C", "tau1", "energy_fraction")  # quantities whose published values are shown
SHIFTED = ("r", "tau1", "energy_fraction")  # quantities whose shifts by defects are shown
MEANINGS = {
    "score": "100 × the mean of (n / (n + missed + false)) × min(bound / rmse, 1) over those columns of the first "
    "figure that have a bound. At 100 every ball is found, nothing else is, and the errors are at the bound.",
    "rmse / bound": "root mean square error of the centre in x and y over the Cramér-Rao bound, the smallest standard "
    "deviation of an unbiased estimate. For encoded films the bound is that of the film before it was encoded.",
    "found": "share of the balls wholly in view that have a detection within 5 px.",
    "false": "detections without a ball, divided by the number of balls.",
    "phase bias": "peak-to-peak amplitude (px) of the mean error as a function of the position of the glint within its "
    "pixel.",
    "z": "root mean square of error over claimed error bar: 1 where error bars are correct, more where they are too "
    "small.",
    "alpha, beta, JSC, JSC θ": "measures of the Particle Tracking Challenge (Chenouard et al. 2014), gate 5 px: "
    "distance of paired tracks, the same with a penalty for spurious tracks, share of paired positions and of paired "
    "tracks.",
    "MOTA, IDF1, HOTA": "Bernardin & Stiefelhagen 2008; Ristani et al. 2016; Luiten et al. 2021, with the similarity "
    "1 - distance / 5 px.",
    "crowds": "many balls that collide with one another and with walls. Contacts and temperature follow from the "
    "tracks of each tracker by the same methods. A contact counts if it changes the velocity of a ball by 0.1 px a "
    "frame. It is found if the tracks of its balls show it within 2 frames. The temperature is the variance of a "
    "component of the velocities; its error is the rms over all frames of the relative error.",
    "published": "mean error of a quantity over all collisions, weighted by the claimed error bars, ± the error bar of "
    "that mean: the error of a published value.",
    "defects": "each defect is put alone into true tracks that have the noise of the bound, and these are measured. "
    "The shift of r, τ1 and the energy is given in error bars of one collision.",
    "ms per frame": "processor time of detection and linking, 320 x 240 px, one process; for a submission, the value "
    "that its authors give.",
}


def write_report(
    report: Path, entries: Entries, definition: SuiteDefinition, about: Mapping[str, Any], command: str
) -> Path:
    """Write REPORT/index.html and return its path.

    entries: the best first.
    about: suite.json.
    command: that which made the page.
    """
    whose = "withheld from the authors of the trackers" if about["split"] == "withheld" else "open"
    summary = (
        f"{definition.data['name']}, version {about['version']}: balls collide on a plate. Each tracker gets only "
        f"the films and the camera file. The truth is {whose}."
    )
    sections = [
        *(_pairs(entries, definition) if definition.headline else []),
        *([PageSection("Crowds", _crowds(entries, definition))] if definition.crowds else []),
        PageSection("Leaderboard", [_leaderboard(entries)]),
        PageSection("All measures", make_benchmark_tables(entries, definition)),
        PageSection("Meaning of the measures", [_meanings()]),
        PageSection("Card of the suite", [_card(definition, about)]),
    ]
    return write_page(report / "index.html", "Benchmark of trackers", sections, command, [summary])


def _pairs(entries: Entries, definition: SuiteDefinition) -> list[PageSection]:
    """The sections on films of two balls."""
    return [
        PageSection("Error of the centre by setting", _headline(entries, definition)),
        PageSection("Error against one property of the film", [_axes(entries, definition)]),
        PageSection("Errors of published values", _publication_figures(entries, definition)),
        PageSection("Effect of each defect on the physics", _defects(entries)),
    ]


def _headline(entries: Entries, definition: SuiteDefinition) -> list[Block]:
    caption = (
        "Rmse of the centre of a ball over the Cramér-Rao bound: 1 is the limit. Green is good, dark red is 30 times "
        "the limit. Grey: less than half of the balls are found, or more detections than balls are made. A "
        "percentage is the share of balls found, where it is below 99 %. The sampling error of a ratio is about "
        "1/√(4n) of it for n positions; values slightly below 1 agree with the limit. Matte balls: rmse in px. "
        "Score: 100 means that every ball is found, nothing else is, and the errors are at the limit."
    )
    heads = ["tracker", "score", "settings within 20 % of the limit", "worst settings (times the limit)"]
    heads += ["ms per frame"]
    rows = []
    for entry in entries:
        good, bad = describe_performance(entry, definition)
        line = make_leaderboard_row(0, entry)
        rows.append(
            [figures.name_tracker(entry), format_number(line["score"]), good, bad, format_number(line["ms_per_frame"])]
        )
    return [
        PageFigure.of(figures.draw_headline(entries, definition), "Trackers by setting", caption),
        PageTable(heads, rows),
    ]


def _axes(entries: Entries, definition: SuiteDefinition) -> PageFigure:
    caption = (
        "A cross marks a setting where less than half of the balls are found, or as many false ones. The dotted line "
        "is the bound; for locking to pixels it is zero error."
    )
    title = "Error against brightness, blur, noise, codec, lens, gap between the balls and phase within the pixel"
    return PageFigure.of(figures.draw_errors_by_setting(entries, definition), title, caption)


def _publication_figures(entries: Entries, definition: SuiteDefinition) -> list[Block]:
    blocks: list[Block] = []
    for part in definition.parts_of("measured"):
        caption = (
            f"Films “{part}”: published value minus truth ± the published error bar (tied fit, all collisions "
            "together). Green: correct within two error bars. Yellow: off by up to four. Red: off by more. Grey: "
            "nothing to publish."
        )
        figure = figures.draw_published_quantities(entries, part, PUBLISHED)
        blocks.append(PageFigure.of(figure, f"Published values, {part}", caption))
    return blocks


def _defects(entries: Entries) -> list[Block]:
    blocks: list[Block] = []
    for suffix, method in (("_free", "Free fit"), ("", "Tied fit")):
        figure = figures.draw_defects(entries, SHIFTED, suffix)
        caption = (
            f"{method}: true tracks with one defect of this tracker and no other. At the dotted line a defect moves "
            "the result of one collision by its error bar at the bound. A shift that all collisions share does not "
            "average out. No result: with the defect, this fit does not give the quantity."
        )
        if figure is not None:
            blocks.append(PageFigure.of(figure, f"Shifts by defects, {method.lower()}", caption))
    return blocks


def _crowds(entries: Entries, definition: SuiteDefinition) -> list[Block]:
    caption = (
        "Left: slow balls that fill more and more of their tray. Right: few balls that move farther and farther from "
        "frame to frame, in units of the distance between neighbours. A tracker without a point was not run on these "
        "films, or its tracks give no value."
    )
    figure = PageFigure.of(figures.draw_crowds(entries, definition), "Crowds by density and speed", caption)
    return [figure, *make_crowd_tables(entries, definition)]


def make_crowd_tables(entries: Entries, definition: SuiteDefinition) -> list[PageTable]:
    """Make the tables of all crowds; an entry without crowds has dashes."""
    words = definition.data["crowds"]["parts"]
    tables = []
    for title, key, digits in (
        ("HOTA", "hota", 4), ("IDF1", "idf1", 4), ("MOTA", "mota", 4), ("exchanged identities", "swaps", 4),
        ("rmse / bound", "ratio", 3), ("rmse in x and y, px", "rmse_px", 3),
        ("contacts found, share", "contacts_found", 3), ("contacts that are none, share", "contacts_false", 2),
        ("temperature, rms of its relative error", "temperature_error", 2),
    ):  # fmt: skip
        rows = []
        for entry in entries:
            found = entry.get("crowds", {})
            values = ((found.get(part) or {}).get(key) for part in definition.crowds)
            rows.append([figures.name_tracker(entry), *(format_number(value, digits) for value in values)])
        tables.append(PageTable(["tracker", *(words[part] for part in definition.crowds)], rows, title))
    return tables


def _leaderboard(entries: Entries) -> PageTable:
    columns = {
        "rank": "rank", "name": "tracker", "score": "score", "ratio_median": "median rmse / bound", "found": "found",
        "false_per_ball": "false per ball", "hota": "HOTA", "crowd_hota": "HOTA in crowds",
        "crowd_contacts_found": "contacts found in crowds", "crowd_temperature_error": "error of temperature in crowds",
        "ms_per_frame": "ms per frame", "made": "run by", "truth": "truth",
    }  # fmt: skip
    lines = [make_leaderboard_row(rank, entry) for rank, entry in enumerate(entries, 1)]
    return PageTable(list(columns.values()), [[format_number(line[key]) for key in columns] for line in lines])


def _meanings() -> Markup:
    lines = [Markup("<dt><b>{}</b></dt><dd>{}</dd>").format(name, meaning) for name, meaning in MEANINGS.items()]
    more = (
        "For all detectors, the camera file converts the bright spots to centres of balls. The same linker joins "
        "them, unless an entry names its own. A slow tracker may run on "
        "fewer clips of each part; its entry says so."
    )
    return Markup("<dl>{}</dl><p>{}</p>").format(Markup("").join(lines), more)


def _card(definition: SuiteDefinition, about: Mapping[str, Any]) -> PageTable:
    make, submit = "tracker benchmark make -o suite", "tracker benchmark submit suite FOLDER -o report"
    citation = f"{CITATION.format(version=version('synthcam'))}; benchmark version {about['version']}"
    rows = {
        "suite": f"{definition.data['name']} {about['version']} ({about['size']}), split {about['split']}",
        "seed": "withheld" if about["seed"] is None else str(about["seed"]),
        "definition, SHA-256": Markup("<code>{}</code>").format(about["definition_sha256"]),
        "truth, SHA-256": Markup("<code>{}</code>").format(about["truth_sha256"]),
        "licence": f"films and truth {about['licence']}; code MIT",
        "citation": citation,
        "your tracker": f"{make}; run your tracker on suite/films; {submit}",
    }
    return PageTable(["property", "value"], list(rows.items()))


def describe_performance(
    entry: Entry, definition: SuiteDefinition, at_bound: float = 1.2, failure: float = 2.0
) -> tuple[str, str]:
    """Say on the page in how many settings a tracker is at the bound, and the three in which it fails most.

    at_bound, failure: rmse over bound up to which a tracker is at the bound, and from which on it fails.
    """
    good, judged, bad = 0, 0, []
    for part, word in definition.headline.items():
        scores = entry["parts"].get(part)
        if scores is None:
            continue
        text, value = figures.make_cell(scores)
        if scores["ratio"] is None and value is not None:
            continue
        judged += 1
        if value is None:
            bad.append((1e9 - (scores["jaccard"] or 0.0), f"{word} ({' '.join(text.split())})"))
        elif value > failure:
            bad.append((value, f"{word} (× {', '.join(text.splitlines())})"))
        good += value is not None and value <= at_bound
    worst = ", ".join(text for _, text in sorted(bad, reverse=True)[:3])
    return f"{good} of {judged}", worst or "none over twice the limit"


def make_benchmark_tables(entries: Entries, definition: SuiteDefinition) -> list[PageTable]:
    """Make the tables of the benchmark's page: positions and tracks of each part, quantities, and defects."""
    tables = []
    pairs = [part for part in definition.parts if part not in definition.crowds]
    for title, key, digits in (
        ("rmse / bound", "ratio", 3),
        ("rmse in x and y, px", "rmse_px", 3),
        ("found: share of the balls in view", "found", 4),
        ("false detections", "false", 4),
        ("phase bias, px", "phase_bias_px", 2),
        ("z of positions: 1 where the claimed error bars are correct", "z", 3),
        ("HOTA", "hota", 4), ("MOTA", "mota", 4), ("IDF1", "idf1", 4),
        ("alpha", "alpha", 4), ("beta", "beta", 4), ("JSC", "jsc", 4), ("JSC θ", "jsc_theta", 4),
    ):  # fmt: skip
        rows = []
        for entry in entries:
            values = (entry["parts"].get(part, {}).get(key) for part in pairs)
            rows.append([figures.name_tracker(entry), *(format_number(value, digits) for value in values)])
        tables.append(PageTable(["tracker", *pairs], rows, title))
    for part in definition.parts_of("measured"):
        for suffix, method in (("", "tied fit"), ("_free", "free fit")):
            title = f"{part}, {method}: rmse (rmse / bound; z sd; collisions)"
            tables.append(_quantity_table(entries, part, suffix, title))
    kept = [entry for entry in entries if entry["defects"]]
    return [*tables, _defect_table(kept)] if kept else tables


def _quantity_table(entries: Entries, part: str, suffix: str, title: str) -> PageTable:
    rows = []
    for entry in entries:
        cells = [figures.name_tracker(entry)]
        for name in PUBLISHED:
            q = entry["quantities"].get(part, {}).get(f"{name}{suffix}") or {}
            rmse = None if q.get("rmse") is None else q["rmse"] * QUANTITIES[name].error_factor
            ratio, spread = (format_number(q.get(key), 2) for key in ("ratio", "z_std"))
            cells.append(f"{format_number(rmse)} ({ratio}; {spread}; {q.get('n', 0)})")
        rows.append(cells)
    return PageTable(["tracker", *(f"{name} / {QUANTITIES[name].error_unit}" for name in PUBLISHED)], rows, title)


def _defect_table(entries: Entries) -> PageTable:
    heads = ["tracker", "locking, px", "glint, share", "lost, share"]
    heads += [f"{word}: {name}" for word in figures.DEFECTS.values() for name in SHIFTED]
    rows = []
    for entry in entries:
        found = entry["defects"]
        cells = [figures.name_tracker(entry), *(format_number(found["size"][defect], 2) for defect in figures.DEFECTS)]
        for defect in figures.DEFECTS:
            for name in SHIFTED:
                one = found[defect].get(f"{name}_free") or {}
                bias = None if one.get("bias") is None else one["bias"] * QUANTITIES[name].error_factor
                cells.append(f"{format_number(bias, 2)} ({format_number(one.get('in_errors'), 2)})")
        rows.append(cells)
    title = "Size of each defect, and mean shift of r and energy (10⁻³) and τ1 (µs) by it (in error bars), free fit"
    return PageTable(heads, rows, title)
