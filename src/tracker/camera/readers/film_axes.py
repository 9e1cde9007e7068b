"""Chooses which axis of a stack is time, and an entry of each other axis, such as channels and focal planes."""

from collections.abc import Mapping
from pathlib import Path

from synthcam_shared.errors import InputError

AXIS_NAMES = {"C": "channel", "Z": "focal plane", "S": "sample of a pixel", "P": "position", "R": "position"}


def choose_axis_entries(
    path: Path, lengths: Mapping[str, int], wanted: Mapping[str, int], notes: list[str]
) -> tuple[str, dict[str, int]]:
    """The axis that is time, "" of a single picture, and the entry of each other axis; adds to the notes.

    lengths: of the axes by letter, without those of a picture; wanted: entries that the user selects. Raises InputError
    where one of these is not there.
    """
    time, others = "T" if "T" in lengths else "", {axis: n for axis, n in lengths.items() if n > 1}
    if others and "T" not in others:  # the longest that is no channel, else the longest
        frames = {axis: n for axis, n in others.items() if axis != "C"} or others
        time = max(frames, key=lambda axis: frames[axis])
    chosen = {axis: choose_axis_entry(path, axis, n, wanted, notes) for axis, n in lengths.items() if axis != time}
    if absent := sorted(set(wanted) - set(chosen) - {"S"} - {axis for axis, n in lengths.items() if n == 1}):
        there = ", ".join(f"{axis} ({n})" for axis, n in lengths.items()) or "none"
        raise InputError(f"{path}: --select {absent[0]}: no such axis beside time, expected one of {there}")
    if time not in ("", "T") and len(others) > 1:
        notes.append(f"axis {time} ({AXIS_NAMES.get(time, 'frames')}) is taken as time, because the file names no time")
    return time, chosen


def choose_axis_entry(path: Path, axis: str, count: int, wanted: Mapping[str, int], notes: list[str]) -> int:
    """The entry of an axis that is not time; a note says which. Raises InputError for one that is not there."""
    chosen = wanted.get(axis, 0)
    if chosen >= count:
        raise InputError(f"{path}: --select {axis}={chosen}: expected 0 to {count - 1}")
    if count > 1:
        name = AXIS_NAMES.get(axis, "axis")
        notes.append(f"{name} {chosen} of {count} (0 to {count - 1}) is taken; --select {axis}=N takes another")
    return chosen
