"""TrackMate's CSV of spots: with three more lines of names and units under the first, or the older with one."""

import pandas as pd

from tracker.camera.camera_keys import format_wrong_value
from tracker.tables.content import FileContent
from tracker.tables.table import TrackTable

NAME = "TrackMate's spots"


def read(content: FileContent) -> TrackTable | None:
    if not any({"TRACK_ID", "POSITION_X"} <= set(line) for line in content.head[:1]):
        return None
    rows = content.cells()
    names = {"FRAME": "frame", "TRACK_ID": "particle", "POSITION_X": "x", "POSITION_Y": "y"}
    missing = [name for name in names if name not in rows]
    if missing:
        raise content.wrong(f"{NAME} without {', '.join(missing)}; expected {', '.join(names)}")
    number = pd.to_numeric(rows["FRAME"], errors="coerce").notna().to_numpy()
    first = int(number.argmax()) if number.any() else len(rows)
    below = rows.iloc[:first]
    unit = next((text for text in map(str, below["POSITION_X"]) if text.startswith("(")), "")
    if len(rows) and not number.any() and not unit:
        raise content.wrong(f"{NAME}: FRAME: expected numbers, not {format_wrong_value(rows['FRAME'].iloc[-1])}")
    rows = rows.iloc[first:][list(names)].rename(columns=names)
    in_track = rows["particle"].notna() & (rows["particle"].map(str) != "None")
    return TrackTable(rows[in_track], NAME, unit)
