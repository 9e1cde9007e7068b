"""Names of columns as programs and people write them: "Frame", "x (px)", "TRACK_ID", "pos_x [mm]"."""

from __future__ import annotations

import re
from collections.abc import Iterable

from tracker.tables.table import LENGTH_UNITS

_ALIASES = {
    "frame": "frame frames frame_no frame_nr frame_number frameno framenumber frame_id frame_idx frame_index "
    "image_index",
    "particle": "particle particle_id track track_id trackid track_no track_number id ball ball_id object object_id "
    "obj_id identity individual",
    "x": "x pos_x position_x x_pos x_position x_center x_centre center_x centre_x centroid_x x_centroid cx xc",
    "y": "y pos_y position_y y_pos y_position y_center y_centre center_y centre_y centroid_y y_centroid cy yc",
    "t": "t time seconds timestamp",
}
_MEANING = {alias: name for name, aliases in _ALIASES.items() for alias in aliases.split()}
_UNITS = {word: unit for unit, (_, names) in LENGTH_UNITS.items() for word in names.split()}
_TIMES = ("s", "sec", "second", "seconds")


def split_unit(name: str) -> tuple[str, str]:
    """A name of a column in small letters, and the unit behind it: "X (px)" gives x, px; "x, px" and "x_px" too."""
    text = re.sub(r"\s+", " ", str(name).strip().lstrip("#").strip().lower())
    found = re.fullmatch(r"(.+?)\s*[\[(]\s*([^\])]*?)\s*[\])]", text) or re.fullmatch(r"(.+?)\s*[,/:_ ]\s*(\S+)", text)
    if found and (found[2] in _UNITS or found[2] in _TIMES):
        return re.sub(r"[ .-]", "_", found[1]), found[2]
    return re.sub(r"[ .-]", "_", text), ""


def find_columns(names: Iterable[str], wanted: Iterable[str]) -> tuple[dict[str, str], str]:
    """Which columns are the wanted ones, by their own names, and the unit of lengths that x and y state.

    A column that is named as it should be is itself; of others one with a known name counts if it is the only one.
    """
    every = [str(name) for name in names]
    found, units = dict[str, str](), set[str]()
    for key in wanted:
        if key in every:
            found[key] = key
            continue
        fit = [name for name in every if _MEANING.get(split_unit(name)[0]) == key]
        exact = [name for name in fit if split_unit(name)[0] == key]
        for choice in (fit, exact):
            if len(choice) == 1:
                found[key] = choice[0]
                break
        if key in ("x", "y") and key in found:
            units.add(_UNITS.get(split_unit(found[key])[1], ""))
    return found, units.pop() if len(units) == 1 else ""
