"""Qualisys: a TSV of lines of a key and values, then X, Y, Z of each marker, mm, z up. A marker at 0, 0, 0 is lost."""

import math

import numpy as np
import pandas as pd

from tracker.tables.content import FileContent
from tracker.tables.dialect import is_number
from tracker.tables.rows import to_numbers
from tracker.tables.table import TrackTable

NAME = "Qualisys' TSV"


def read(content: FileContent) -> TrackTable | None:
    if not content.head or content.head[0][0].upper() != "NO_OF_FRAMES":
        return None
    keys: dict[str, list[str]] = {}
    heads = [line.text.rstrip().split("\t") for line in content.lines[:40]]
    at = next((k for k, cells in enumerate(heads) if cells[0] and is_number(cells[0])), len(heads) - 1)
    for cells in heads[:at]:
        keys[cells[0].upper()] = cells[1:]
    markers = [name for name in keys.get("MARKER_NAMES", []) if name]
    if not markers:
        raise content.wrong(f"{NAME}: no MARKER_NAMES, expected the names of the balls")
    many = len(content.lines[at].text.rstrip().split("\t"))
    first = many - 3 * len(markers)  # frame and time come first where they are exported
    if first not in (0, 1, 2):
        line = content.lines[at].number
        raise content.wrong(f"line {line}: {NAME}: {many} cells, expected x, y, z of {len(markers)} markers")
    table = content.cells(at, [f"{k}" for k in range(many)])
    frame = to_numbers(table["0"], "Frame", content.where) if first else np.arange(1, len(table) + 1)
    parts = []
    for ball in range(len(markers)):
        x, y, z = (
            to_numbers(table[f"{first + 3 * ball + axis}"], f"{markers[ball]} {'XYZ'[axis]}", content.where)
            for axis in range(3)
        )
        lost = (x == 0) & (y == 0) & (z == 0)
        part = {"frame": frame - 1, "particle": ball, "x": np.where(lost, np.nan, x), "y": np.where(lost, np.nan, y)}
        parts.append(pd.DataFrame(part, index=table.index))
    rate = next(iter(keys.get("FREQUENCY", [])), "")
    fps = float(rate) if is_number(rate) and rate.strip("-?*.") else math.nan
    return TrackTable(pd.concat(parts), NAME, "mm", up=True, fps=fps)
