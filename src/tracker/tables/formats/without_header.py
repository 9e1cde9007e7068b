"""Columns without names, as numpy.savetxt writes them: frames and particles show themselves, x and y are the rest."""

from pathlib import Path

import numpy as np
import pandas as pd

from tracker.tables.content import FileContent
from tracker.tables.table import TrackTable

NAME = "columns without a header"


def read(content: FileContent) -> TrackTable | None:
    if content.root is not None or content.is_binary or content.has_header or len(content.head) < 2:
        return None
    table = content.cells(names=[f"{k}" for k in range(1, len(content.head[0]) + 1)])
    if not all(map(pd.api.types.is_numeric_dtype, table.dtypes)):
        return None
    found = find_roles(table)
    if found is None:
        named = "--columns frame=1,track=2,x=3,y=4"
        raise content.wrong(
            f"no line names the columns, and {table.shape[1]} columns do not show which is which; {named}"
        )
    rows = pd.DataFrame({name: table[column] for name, column in found.items()})
    taken = ",".join(f"{'track' if name == 'particle' else name}={column}" for name, column in found.items())
    note = f"{Path(content.where).name}: no line names the columns; taken as --columns {taken}, which can say otherwise"
    return TrackTable(rows, notes=(note,))


def find_roles(table: pd.DataFrame) -> dict[str, str] | None:
    """Find which column is which without a header, where it is certain: no particle is twice in a frame.

    x and y are the first two other columns whose values vary and are not whole numbers.
    """
    whole = [name for name in map(str, table) if _counts(table[name])]
    pairs = [
        (frame, particle)
        for frame in whole
        for particle in whole
        if frame != particle and _is_frame_and_particle(table[frame], table[particle])
    ]
    places = [n for n in map(str, table) if n not in whole and table[n].nunique() > 1]
    if len(pairs) != 1 or len(places) < 2:
        if len(pairs) != 1 or table.shape[1] != 4:
            return None
        places = [name for name in map(str, table) if name not in pairs[0]]
    frame, particle = pairs[0]
    return {"frame": frame, "particle": particle, "x": places[0], "y": places[1]}


def _counts(values: pd.Series) -> bool:
    numbers = values.to_numpy(float)
    return bool(np.isfinite(numbers).all() and (numbers == np.round(numbers)).all() and (numbers >= 0).all())


def _is_frame_and_particle(frame: pd.Series, particle: pd.Series) -> bool:
    """Frames come in a row, particles are few and each is in many frames, and no pair comes twice."""
    max_particles = 1000  # a column with more different numbers does not count particles
    frames, particles = np.unique(frame), np.unique(particle)
    few = len(particles) <= min(max_particles, len(frame) // 2) and len(particles) < len(frames)
    dense = len(frames) >= 0.5 * (frames[-1] - frames[0] + 1)
    once = not pd.DataFrame({"f": frame.to_numpy(), "p": particle.to_numpy()}).duplicated().any()
    # a number of the row counts up by itself and so is in no frame twice
    shared = len(frames) < len(frame) or len(particles) == 1
    return bool(few and dense and once and shared)
