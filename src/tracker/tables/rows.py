"""Rows of a table of tracks: checks its columns, converts rows to tracks and back; the columns of tracks.parquet."""

import math
import re
from io import BytesIO
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv

from synthcam_shared.errors import InputError
from tracker.camera.camera_keys import format_wrong_value
from tracker.detection.link import Tracks
from tracker.tables.dialect import LINE

REQUIRED_COLUMNS = ("frame", "particle", "x", "y")
COVARIANCE = ("x_std", "y_std", "cov_xy")  # of a position
FIXED = ("x_fixed_std", "y_fixed_std", "cov_xy_fixed")  # the part that is the same in each frame of a ball at rest


def make_tracks_table(tracks: Tracks) -> pa.Table:
    """The columns of tracks.parquet."""
    columns: dict[str, Any] = {name: getattr(tracks, name) for name in REQUIRED_COLUMNS}
    columns |= _split_covariance(tracks.cov, COVARIANCE)
    columns |= {"flux": tracks.flux, "flags": pa.array(tracks.flags.tolist(), pa.string())}
    columns |= {"glint_x": tracks.glint_x, "glint_y": tracks.glint_y, **_split_covariance(tracks.fixed, FIXED)}
    return pa.table(columns | ({"t_s": tracks.time} if np.isfinite(tracks.time).any() else {}))


def _split_covariance(cov: Any, names: tuple[str, str, str]) -> dict[str, Any]:
    values = np.sqrt(cov[:, 0, 0]), np.sqrt(cov[:, 1, 1]), np.ascontiguousarray(cov[:, 0, 1])
    return dict(zip(names, values, strict=True))


def to_csv(table: pa.Table) -> bytes:
    """Write a table of tracks as CSV, with quotes only where they are needed."""
    with BytesIO() as text:
        pyarrow.csv.write_csv(table, text, pyarrow.csv.WriteOptions(quoting_style="needed"))
        return text.getvalue()


def split_tracks(table: pd.DataFrame, where: str, metres: bool = False) -> dict[int, tuple[Tracks, str | None]]:
    """Split the rows of a table into tracks by clip, with the clip's striker where the table says it.

    Rows without a finite position are left out. where: what messages call the table; metres: whether lengths are known
    not to be pixels.
    """
    check_columns(table, where)
    if len(table) == 0:  # a result without a detection
        return {0: (to_tracks(table, where), None)}
    clips = table["clip"] if "clip" in table else pd.Series(0, index=table.index)
    out: dict[int, tuple[Tracks, str | None]] = {}
    numbers = to_whole_numbers(clips, "clip", where)
    for number in np.unique(numbers).tolist():
        part = table[numbers == number]
        striker = None
        if "striker" in part:
            names = part["striker"].unique().tolist()
            if len(names) != 1 or names[0] not in ("a", "b"):
                raise InputError(f"{where}: striker: clip {number} has {names}, expected one of a, b")
            striker = str(names[0])
        tracks = to_tracks(part, where)
        span = max(np.ptp(tracks.x), np.ptp(tracks.y)) if len(np.unique(tracks.particle)) > 1 else math.inf
        if span < 1 and not metres:
            raise InputError(
                f"{where}: x, y: expected pixels, not metres: all balls lie within {span:.2g} px; say --unit m"
            )
        out[number] = (tracks, striker)
    if not any(len(tracks) for tracks, _ in out.values()):
        raise InputError(f"{where}: x, y: blank in all {len(table)} rows, expected positions; is it the right column?")
    return out


def check_columns(table: pd.DataFrame, where: str, more: str = "") -> None:
    """Check that a table of tracks has the columns frame, particle, x and y. Raises InputError."""
    missing = [name for name in REQUIRED_COLUMNS if name not in table]
    if missing:
        there = format_wrong_value(", ".join(map(str, table.columns)), quoted=False)
        raise InputError(
            f"{where}: no column {', '.join(missing)}, expected {', '.join(REQUIRED_COLUMNS)}{more}; found {there}"
        )


def to_tracks(table: pd.DataFrame, where: str) -> Tracks:
    """Convert the rows of one clip to tracks."""
    frame, particle = (to_whole_numbers(table[name], name, where) for name in ("frame", "particle"))
    x, y = to_numbers(table["x"], "x", where), to_numbers(table["y"], "y", where)
    max_px = 1e6  # of a position, or of its standard deviation
    for name, values in (("x", x), ("y", y)):
        if len(far := values[np.abs(values) > max_px]):
            row = _row_of(table[name], int(np.argmax(np.abs(values) > max_px)))
            raise InputError(f"{where}: {row}{name}: expected positions in px, not {far[0]:g}; --unit says the unit")
    kept = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    kept = kept[np.lexsort((frame[kept], particle[kept]))]
    twice = (np.diff(frame[kept]) == 0) & (np.diff(particle[kept]) == 0)
    if twice.any():
        row = kept[np.flatnonzero(twice)[0] + 1]
        line = _row_of(table["frame"], int(row)).rstrip(", ")
        raise InputError(
            f"{where}: {line}: particle {particle[row]} is twice in frame {frame[row]}, expected once; a table of"
            " several clips has a column clip"
        )

    def column(name: str, default: float) -> Any:
        values = to_numbers(table[name], name, where) if name in table else np.full(len(table), default)
        return values[kept]

    def covariance(names: tuple[str, str, str], default: float) -> Any:
        cov, cov_xy = np.empty((len(kept), 2, 2)), names[2]
        for axis, name in enumerate(names[:2]):
            std = column(name, default)
            if np.any((std < 0) | (std > max_px)):
                raise InputError(f"{where}: {name}: expected standard errors from 0 to {max_px:g} px")
            cov[:, axis, axis] = std**2
        cov[:, 0, 1] = cov[:, 1, 0] = column(cov_xy, 0.0)
        if np.any(np.abs(cov[:, 0, 1]) > max_px**2):
            raise InputError(f"{where}: {cov_xy}: expected covariances from {-(max_px**2):g} to {max_px**2:g} px^2")
        return cov

    said = table["flags"].astype(object).fillna("") if "flags" in table else pd.Series("", index=table.index)
    return Tracks(
        frame=frame[kept],
        particle=particle[kept],
        x=x[kept],
        y=y[kept],
        cov=covariance(COVARIANCE, math.nan),
        flux=column("flux", math.nan),
        flags=said.astype(str).to_numpy()[kept].astype(np.str_),
        glint_x=column("glint_x", math.nan),
        glint_y=column("glint_y", math.nan),
        fixed=covariance(FIXED, 0.0),
        time=_times(column("t_s", math.nan), frame[kept], particle[kept], where),
    )


def _times(time: Any, frame: Any, particle: Any, where: str) -> Any:
    """Times that a table gives; InputError where they do not grow with the frames of a particle."""
    ball = np.diff(particle) == 0
    back = ball & ~(np.diff(time) > 0)
    if np.isfinite(time).any() and (back.any() or not np.isfinite(time).all()):
        row = int(np.flatnonzero(back)[0]) + 1 if back.any() else int(np.flatnonzero(~np.isfinite(time))[0])
        raise InputError(
            f"{where}: t_s: {time[row]:g} in frame {frame[row]} of particle {particle[row]}, expected times that grow"
        )
    return time


def to_numbers(values: Any, name: str, where: str) -> Any:
    """Convert a column of a table of tracks to numbers; InputError where some are none."""
    try:
        return pd.to_numeric(values).to_numpy(dtype=np.float64)
    except (ValueError, TypeError):
        column = pd.Series(values) if not isinstance(values, pd.Series) else values
        wrong = (pd.to_numeric(column, errors="coerce").isna() & column.notna()).to_numpy()
        at = int(np.argmax(wrong))
        text = format_wrong_value(column.iloc[at] if wrong.any() else column.dtype)
        help_with = "; --decimal says which mark numbers have" if re.search(r"\d[,.]\d", text) else ""
        raise InputError(f"{where}: {_row_of(column, at)}{name}: expected numbers, not {text}{help_with}") from None


def _row_of(values: Any, at: int) -> str:
    """The line of a file in which a value is, or its row in a table."""
    if not isinstance(values, pd.Series):
        return ""
    if values.index.name == LINE:
        return f"line {values.index[at]}, "
    return f"row {at}, "


def to_whole_numbers(values: Any, name: str, where: str) -> Any:
    """Convert a column of a table of tracks to whole numbers from 0 on."""
    max_number = (1 << 31) - 1
    numbers = to_numbers(values, name, where)
    wrong = ~((numbers >= 0) & (numbers <= max_number) & (numbers == np.round(numbers)))  # NaN too
    if wrong.any():
        at = int(np.argmax(wrong))
        value = "a missing value" if np.isnan(numbers[at]) else f"{numbers[at]:.10g}"
        raise InputError(
            f"{where}: {_row_of(values, at)}{name}: expected whole numbers from 0 to {max_number}, not {value}"
        )
    return numbers.astype(np.int64)
