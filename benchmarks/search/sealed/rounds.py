"""A published round of sealed boxes: its ledgers, opened boxes and secret, how they are checked, and their tables.

rounds/NAME/: about.json with the secret, STUDY.ledger.jsonl as it grew, boxes.jsonl.xz with every opened
box. earlier.json: the false claims of rounds whose boxes were not kept.
"""

from __future__ import annotations

import collections
import dataclasses
import json
import lzma
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .boxes import UNDRAWN
from .drawing import draw
from .goals import Goal, goals
from .judge import STRANGE, Row, judge
from .ledger import Broken, Json, digest, lines, sealing
from .page import drawn, outsiders, results
from .studies import STUDIES

BOXES, ABOUT, LEDGER = "boxes.jsonl.xz", "about.json", ".ledger.jsonl"
BEGIN, END = "<!-- begin: blind.py table --write -->", "<!-- end -->"


def publish(folder: Path, name: str, secret: str, rounds: Path, commit: str = "") -> Path:
    """Copy a round and its secret into the repository. Raises Broken: nothing is published that cannot be checked.

    commit: of the code that drew and answered the boxes.
    """
    place = rounds / name
    if place.exists():
        raise Broken(f"round {name} is published already")
    ledgers = sorted(folder.glob(f"*-{name}{LEDGER}"))
    if not ledgers:
        raise Broken(f"{folder}: there is no round {name}")
    paths = [p for p in results(folder) if p.stem.endswith(f"-{name}")]
    opened = [line for p in paths for line in lines(p)]
    beside = place.with_name(f".{name}.partial")
    shutil.rmtree(beside, ignore_errors=True)
    beside.mkdir(parents=True)
    for path in ledgers:
        shutil.copyfile(path, beside / path.name)
    text = "".join(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n" for line in opened)
    (beside / BOXES).write_bytes(lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME))
    (beside / ABOUT).write_text(json.dumps({"secret": secret, "commit": commit}) + "\n")
    faults = verify(beside)
    if faults:
        shutil.rmtree(beside)
        raise Broken("; ".join(faults))
    beside.rename(place)
    return place


def describe_commit(place: Path) -> str:
    """Which code a round wants to be drawn again, in words."""
    commit = json.loads((place / ABOUT).read_text()).get("commit")
    return f"that was commit {commit}" if commit else "its commit was not written down"


def read_boxes(place: Path) -> list[Json]:
    """The opened boxes of a published round."""
    text = lzma.decompress((place / BOXES).read_bytes()).decode()
    return [json.loads(line) for line in text.splitlines()]


def judge_round(place: Path) -> list[Row]:
    """The same, judged afresh."""
    return [judge(line) for line in read_boxes(place)]


def verify(place: Path) -> list[str]:
    """Return the faults of a published round, a line each; none when every recorded hash is right."""
    secret, faults = json.loads((place / ABOUT).read_text())["secret"], []
    records = {p.name.removesuffix(LEDGER): list(lines(p)) for p in sorted(place.glob(f"*{LEDGER}"))}
    for study, record in records.items():
        if not record or record[0] != {"secret": sealing(secret)}:
            faults.append(f"{study}: the secret's hash does not stand before the first box")
    opened = read_boxes(place)
    seen = collections.Counter((o["truth"]["study"], o["truth"]["box"]) for o in opened)
    faults += [f"{study} {box}: opened {n} times" for (study, box), n in seen.items() if n > 1]
    for line in opened:
        faults += _checked(line, records.get(line["truth"]["study"], []))
    return faults


def _checked(line: Json, record: Sequence[Json]) -> list[str]:
    """One opened box against its ledger: the truth on record first, then the answer, each by its hash."""
    study, box = line["truth"]["study"], line["truth"]["box"]
    own = [r for r in record if r.get("box") == box]
    wanted = [{"box": box, what: digest(line[what])} for what in ("truth", "answer")]
    faults = [f"{study} {box}: the {what} is not the one on record"
              for what, entry in zip(("truth", "answer"), wanted, strict=True) if entry not in own]  # fmt: skip
    if not faults and own[:2] != wanted:
        faults.append(f"{study} {box}: the ledger does not have the truth first and one answer then")
    return faults


def list_unopened(place: Path) -> list[str]:
    """Boxes that were sealed, and never opened."""
    known = {(o["truth"]["study"], o["truth"]["box"]) for o in read_boxes(place)}
    records = {p.name.removesuffix(LEDGER): lines(p) for p in place.glob(f"*{LEDGER}")}
    sealed = {(study, line["box"]) for study, record in records.items() for line in record if "truth" in line}
    return [f"{study} {box}" for study, box in sorted(sealed - known)]


def redraw_boxes(place: Path) -> list[str]:
    """Draws every box again from the secret: those that come out as another, with this version of the code."""
    secret = json.loads((place / ABOUT).read_text())["secret"]
    faults = []
    for line in read_boxes(place):
        name, box = line["truth"]["study"], line["truth"]["box"]
        study = dataclasses.replace(STUDIES[name.removesuffix(f"-{place.name}")], name=name)
        again = json.loads(json.dumps(draw(study, box, secret)))
        if again != {k: v for k, v in line["truth"].items() if k != "salt"}:
            faults.append(f"{name} {box}: the secret draws another box")
    return faults


def render_tables(rows: Sequence[Row], rounds: Path) -> str:
    """The tables of docs/blind.md: a round's goals and outsiders, and the false claims of every round."""
    parts = [_goals(rows), *(_outsiders(rows, kind) for kind in STRANGE)] if rows else []
    return "\n".join(part for part in [*parts, _library(rows), _false(rounds)] if part)


def _goals(rows: Sequence[Row]) -> str:
    found, filmed = goals(rows), sum(r.filmed for r in rows)
    codes = ", ".join(f"{code} ({n})" for code, n in collections.Counter(r.code for r in rows).most_common())
    about = (
        f"{len(rows)} boxes, {len(rows) - filmed} from tracks and {filmed} filmed; fingerprints of the code: {codes}."
    )
    out = []
    for text in dict.fromkeys(g.text for g in found):
        cells = {g.where: _cell(g) for g in found if g.text == text}
        wanted = next(g.wanted for g in found if g.text == text)
        out.append([text, wanted, cells.get("tracks", "-"), cells.get("video", "-")])
    return f"{about}\n\n{_table(['', 'goal', 'tracks', 'video'], out)}"


def _cell(goal: Goal) -> str:
    met = {"yes": ": met", "no": ": not met"}.get(goal.met, "")
    return goal.reached + met + (f"; {goal.beside}" if goal.beside else "")


def _outsiders(rows: Sequence[Row], kind: str) -> str:
    found = outsiders(rows, kind)
    if not found:
        return ""
    title = "outside the library" if kind == "outside" else "an ordinary fault"
    heads = ["boxes", "declared", "of these inadequate", "with a false library name", "cosine with the likest effect"]
    keys = ("name", "n", "declared", "told", "library", "nearest")
    return _table([f"{title}, from 2 x its limit", *heads], [[o[k] for k in keys] for o in found])


def _table(heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    whole = [heads, ["---"] * len(heads), *rows]
    return "".join("| " + " | ".join(map(str, line)) + " |\n" for line in whole)


def _library(rows: Sequence[Row]) -> str:
    never = "; ".join(f"{name}: {why}" for name, why in UNDRAWN.items())
    counts = ", ".join(f"{name} {n}" for name, n in drawn(rows))
    hidden = f"Effects of the library, and in how many boxes each was hidden: {counts}.\n" if rows else ""
    if any(n == 0 for _, n in drawn(rows)) and rows:
        hidden += "A count of 0 means that no strength within the effect's limits shows in the box whose turn it was.\n"
    return hidden + f"Never hidden, since no tracks show them: {never}.\n"


def _false(rounds: Path) -> str:
    """False claims in boxes that hide nothing, or a tracker's defect, of every round known."""
    every = json.loads((rounds / "earlier.json").read_text())
    for place in list_published(rounds):
        rows = judge_round(place)
        counts = {key: _count([r for r in rows if r.worked and which(r)]) for key, which in FALSE.items()}
        codes = ", ".join(dict.fromkeys(r.code for r in rows))
        every.append({"round": place.name, "code": codes, "boxes": len(rows)} | counts)
    heads = ["false claims: round", "code", "boxes", "nothing hidden, white noise", "correlated or shaken"]
    heads += ["a tracker's defect", "filmed, nothing hidden", "filmed, a defect"]
    return _table(heads, [[one[k] for k in ("round", "code", "boxes", *FALSE)] for one in every])


FALSE: dict[str, Callable[[Row], bool]] = {
    "white": lambda r: r.kind == "none" and r.noise == "white",
    "hard": lambda r: r.kind == "none" and r.noise not in ("white", "tracker"),
    "defect": lambda r: r.kind == "defect" and not r.filmed,
    "film": lambda r: r.kind == "none" and r.filmed,
    "filmed_defect": lambda r: r.kind == "defect" and r.filmed,
}


def _count(rows: Sequence[Row]) -> str:
    return f"{sum(bool(r.false) for r in rows)} of {len(rows)}"


def list_published(rounds: Path) -> list[Path]:
    """The rounds in the repository, in the order of their names: 9 before 10."""
    places = (p.parent for p in rounds.glob(f"[!.]*/{ABOUT}"))
    return sorted(places, key=lambda place: (len(place.name), place.name))


def latest(rounds: Path) -> list[Row]:
    """The boxes of each study in the last round that has it: a round may be of a few studies."""
    found = dict[str, list[Row]]()
    for place in list_published(rounds):
        studies = collections.defaultdict[str, list[Row]](list)
        for row in judge_round(place):
            studies[row.study.removesuffix(f"-{place.name}")].append(row)
        found |= studies
    return [row for rows in found.values() for row in rows]


def insert_tables(page: str, table: str) -> str:
    """A text with what stands between its marks replaced. Raises ValueError without marks."""
    before, mark, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (mark and end):
        raise ValueError(f"expected {BEGIN} ... {END}")
    return f"{before}{BEGIN}\n\n{table}\n{END}{after}"
