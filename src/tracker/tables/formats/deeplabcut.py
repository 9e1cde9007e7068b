"""DeepLabCut: three or four lines of names (scorer, individuals, bodyparts, coords), then a row for each frame."""

from pathlib import Path

import pandas as pd

from tracker.tables.content import FileContent
from tracker.tables.rows import to_numbers
from tracker.tables.table import TrackTable

NAME = "DeepLabCut's table"


def read(content: FileContent) -> TrackTable | None:
    head = content.head
    heads = [line[0].lower() for line in head[:4] if line]
    if not heads or heads[0] != "scorer" or "bodyparts" not in heads or "coords" not in heads:
        return None
    at = heads.index("coords")
    names = [".".join(line[k] if k < len(line) else "" for line in head[1:at]) for k in range(len(head[at]))]
    cells = content.cells(at + 1, [f"{k}" for k in range(len(names))])
    columns: dict[str, dict[str, str]] = {}
    for k, (name, kind) in enumerate(zip(names, head[at], strict=True)):
        if k:
            columns.setdefault(name, {})[kind] = f"{k}"
    parts, low = [], 0
    min_likelihood = 0.6  # DeepLabCut's own default, `pcutoff`: below it a point counts as not seen
    for ball, (name, own) in enumerate(columns.items()):
        if not {"x", "y"} <= set(own):
            raise content.wrong(f"{NAME}: {name} without x, y; expected them of each")
        part = pd.DataFrame({"frame": cells["0"], "particle": ball, "x": cells[own["x"]], "y": cells[own["y"]]})
        if "likelihood" in own:
            seen = to_numbers(cells[own["likelihood"]], f"likelihood of {name}", content.where) >= min_likelihood
            low += int((~seen & part["x"].notna()).sum())
            part = part[seen]
        parts.append(part)
    note = f"{Path(content.where).name}: {low} points have a likelihood under {min_likelihood:g} and are left out"
    return TrackTable(pd.concat(parts), NAME, "px", notes=(note,) if low else ())
