"""Collisions of several results taken together: random-effects means, their scatter, and slopes in the speed."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyarrow import ArrowException

from synthcam_shared.arguments import check_arguments
from synthcam_shared.arrays import Array, Flags
from synthcam_shared.errors import InputError, first_line
from synthcam_shared.json_values import replace_non_finite
from synthcam_shared.report.numbers import format_with_error
from synthcam_shared.settings import did_you_mean
from tracker.measurement.camera_errors import shared_effects
from tracker.measurement.collision.adequacy import CROWD, GLIDE
from tracker.measurement.joint_fit import fit_all_jointly
from tracker.measurement.local.local_columns import calibrate_set
from tracker.measurement.local.recommendation import SUFFIXES
from tracker.measurement.messages import SAME_BODIES
from tracker.recording import Result
from tracker.results import RUN, clip_folder, load_json
from tracker.sets.combined_quantity import (
    WITHOUT_COLLISION,
    CombinedQuantity,
    combine_quantity,
    describe_scatter,
    list_warnings,
)
from tracker.sets.set_page import write_set
from tracker.tables.rows import make_tracks_table, to_csv

_BY_PATHS = "no contact shows the friction of the plate; `tracker gas` gives mu_k by the free paths, if they show it"


@dataclass(frozen=True, eq=False, repr=False)
class CombinedSet:
    """Collisions of several results taken together.

    Attributes
    ----------
    table : DataFrame
        All rows of estimates.parquet, with two more columns. `result` is the name of each result. `fit` says which of
        its fits enters: tied, free, local, or "" where none does.
    quantities : dict
        A `CombinedQuantity` for each quantity that has a value.
    chi2 : dict
        The joint fit of the paper over all collisions that are ok, as in fit.json.
    notes : tuple of str
        What the reader should know: recordings given twice, collisions that decide a mean, slopes.

    Examples
    --------
    >>> found = tracker.combine(["out/monday", "out/tuesday"])  # doctest: +SKIP
    >>> found.means.loc["r", "mean"]  # doctest: +SKIP
    """

    table: pd.DataFrame
    quantities: dict[str, CombinedQuantity]
    chi2: dict[str, Any]
    notes: tuple[str, ...] = ()

    @cached_property
    def means(self) -> pd.DataFrame:
        """A row for each quantity: n, mean, std, scatter and its interval, i2, birge, slope (s/m) and its error."""
        keys = "n mean std low high shared_std scatter scatter_low scatter_high i2 birge".split()
        columns = {}
        for name, one in self.quantities.items():
            row = one.document()
            slope = row["slope"] or {"slope": np.nan, "std": np.nan}
            columns[name] = {key: row[key] for key in keys} | {"slope": slope["slope"], "slope_std": slope["std"]}
        return pd.DataFrame(columns).T.astype({"n": int})

    @property
    def used(self) -> int:
        """How many collisions give at least one value."""
        return len(self._rows_used())

    @property
    def left_out(self) -> dict[str, int]:
        """Count the collisions that give no value, by their status."""
        counts = self.table["status"].drop(self._rows_used()).value_counts().sort_index()
        return {str(status): int(count) for status, count in counts.items()}

    def _rows_used(self) -> list[Any]:
        return sorted({row for one in self.quantities.values() for row in one.values.index})

    def document(self) -> dict[str, Any]:
        """Give the content of set.json, with None for what is not finite.

        Returns
        -------
        dict
        """
        counts = self.table["result"].value_counts(sort=False)
        document: dict[str, Any] = {"results": {str(name): int(count) for name, count in counts.items()}}
        document |= {"collisions": len(self.table), "used": self.used, "left_out": self.left_out}
        document |= {"notes": list(self.notes)}
        document |= {"quantities": {name: one.document() for name, one in self.quantities.items()}, "chi2": self.chi2}
        return dict(replace_non_finite(document))

    def report(self, folder: str | Path, command: str = "tracker.combine") -> Path:
        """Write set.json and index.html into a new folder, or over an earlier set.

        Parameters
        ----------
        folder : str or Path
        command : str
            What made the page, for its foot.

        Returns
        -------
        Path
            Of the page.
        """
        return write_set(self.document(), self.quantities, Path(folder), command)

    def __repr__(self) -> str:
        lines = [f"{self.used} of {len(self.table)} collisions"]
        for name, one in self.quantities.items():
            mean = format_with_error(one.mean.coefficients[0], one.mean.std[0])
            lines.append(f"  {name} = {mean}, {describe_scatter(one)}, n = {len(one.values)}")
        return "\n".join(lines)


@check_arguments
def combine(
    results: Sequence[str | Path | Result] | str | Path, *, quantities: Sequence[str] | None = None
) -> CombinedSet:
    """Combine the collisions of several results into a set: random-effects means and slopes.

    The column `recommended` says which fit of a collision enters; without this column it is the tied fit of those that
    are ok. A recording that is given twice counts once. Local estimates of results with fewer than 8 hits each are
    calibrated by all hits of their camera.

    Parameters
    ----------
    results : sequence of str, Path or Result
        Folders that `tracker track` or `tracker measure` made, or results in memory.
    quantities : sequence of str, optional
        Columns of estimates.parquet; default: r, s, mu_k, C, drag and decel, as far as they are
        there.

    Returns
    -------
    CombinedSet

    Examples
    --------
    >>> import pandas as pd, synthcam, tracker
    >>> clips = [synthcam.Scene.read("painter_behringer").draw(k, seed=1) for k in range(3)]
    >>> parts = [c.tracks[["frame", "particle"]].assign(x=c.tracks.x_mean_px, y=c.tracks.y_mean_px) for c in clips]
    >>> table = pd.concat([part.assign(clip=c.number) for part, c in zip(parts, clips)])
    >>> found = tracker.combine(tracker.measure_all(table, clips[0].camera_json))
    >>> bool(abs(found.quantities["r"].mean.coefficients[0] - clips[0].truth["r"]) < 1e-3)
    True
    """
    given = [results] if isinstance(results, str | Path) else list(results)
    if not given:
        raise InputError("results: none, expected at least one folder of results")
    table, notes = _read_all(given)
    notes += _warn_of_warp(table)
    table, calibrated = _calibrate_together(table)
    notes += calibrated
    table["fit"] = _choose_fits(table)
    wanted = _choose_quantities(table, quantities)
    found = {name: one for name in wanted if (one := _combine_one(table, name))}
    by_paths = [_BY_PATHS] * ("mu_k" in wanted and "mu_k" not in found and _is_rolling_crowd(table))
    if not found:
        states = ", ".join(f"{count} {status}" for status, count in table["status"].value_counts().items())
        folders = ", ".join(f"{one}" for one in given if not isinstance(one, Result))
        nothing = f"{folders or 'results'}: no value of {', '.join(wanted)} ({states})"
        raise InputError("; ".join([nothing, *by_paths]))
    notes += by_paths
    notes += [note for one in found.values() for note in list_warnings(one)]
    if "mass_ratio" in found:
        notes.append(f"mass_ratio is that of the particle with the lower number over the other. {SAME_BODIES}")
    return CombinedSet(table, found, fit_all_jointly(table), tuple(notes))


def _is_rolling_crowd(table: pd.DataFrame) -> bool:
    """Decide whether the rows are contacts of crowds of balls of which none is seen to glide."""
    gliding = (table.get("motion_local", pd.Series("", table.index)) == GLIDE).any()
    return bool((table["status"] == CROWD).any() and not gliding)


def _combine_one(table: pd.DataFrame, name: str) -> CombinedQuantity | None:
    """Combine the values of one quantity; None if no collision has one."""
    values = _take_values(table, name)
    if not len(values):
        return None
    used = table.loc[values.index]
    effects = shared_effects(used, (name,), "tied", "rolling", "free")
    if name == "mass_ratio":
        effects[_is_turned(used)] *= -(values["value"].to_numpy()[_is_turned(used), None, None] ** 2)
    return combine_quantity(name, values, effects)


def _warn_of_warp(table: pd.DataFrame) -> list[str]:
    """The note on warps whose error is not divided into what recordings share and what they do not."""
    uncertain = table["camera"].str.contains('"std": ') & ~table["camera"].str.contains('"errors": ')
    if not uncertain.any():
        return []
    return [
        "the error of `warp` in camera.json counts as independent from collision to collision; means of collisions at "
        "the same position are less certain than their errors say. `tracker warp` now writes which part of it they "
        "share: make the camera file and measure again"
    ]


def _read_all(given: Sequence[str | Path | Result]) -> tuple[pd.DataFrame, list[str]]:
    """The estimates of all results, without recordings given twice; columns `result` and `camera`; and notes."""
    folders = [Path(one).resolve() for one in given if not isinstance(one, Result)]
    names = iter([folder.name for folder in folders])
    if len(set(folders)) > 1:  # below the folder that holds all
        common = os.path.commonpath([folder.parent for folder in folders])
        names = iter([folder.relative_to(common).as_posix() for folder in folders])
    parts, seen, notes = [], dict[str, str](), list[str]()
    for one in given:
        if isinstance(one, Result):
            digest = hashlib.sha256(to_csv(make_tracks_table(one.found))).hexdigest()
            name, part, marks = "memory", one.estimates, {one.number: [digest]}
        else:
            name, (part, marks) = next(names), _read_folder(Path(one))
        part, twice = _leave_out_repeated(part, marks, seen, name)
        parts.append(part.assign(result=name, camera=_describe_view(one)))
        notes += twice
    return pd.concat([part for part in parts if len(part)] or parts, ignore_index=True), notes


def _describe_view(one: str | Path | Result) -> str:
    """Name the keys of a camera file on which positions and bodies depend; "" without a file."""
    if isinstance(one, Result):
        keys = one.camera.to_dict()
    else:
        file = Path(one) / "camera.json"
        keys = load_json(file) if file.is_file() else {}
    names = "size fps scale K dist R t warp ball_diameter mass_ratio ball_masses body support".split()
    return json.dumps({name: keys[name] for name in names if name in keys}) if keys else ""


def _calibrate_together(table: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """Calibrate the local estimates of results that have too few hits by all of one camera, with a note."""
    notes = []
    if {"local", "local_hits"} <= set(table):
        few = table["local"].str.contains('"prior"', na=False) & (table["local_hits"] == 0) & (table["camera"] != "")
        for _, rows in table[few].groupby("camera"):
            records: list[dict[str, Any]] = rows.to_dict("records")  # type: ignore[assignment]  # columns are text
            changed = pd.DataFrame(calibrate_set(records), index=rows.index)
            if hits := int(changed["local_hits"].iloc[0]):
                table = pd.concat([table.drop(index=rows.index), changed])
                notes.append(
                    f"local estimates of {rows['result'].nunique()} results are calibrated together, by the balance of"
                    f" momentum of {hits} hits of one camera"
                )
                before = rows.get("recommended", changed["recommended"])
                if others := int((changed["recommended"] != before).sum()):
                    notes[-1] += f"; for {others} of them another estimate is recommended than in estimates.parquet"
                if changed["local_shared"].str.contains('"mass_ratio"').any():
                    notes[-1] += f". A mass ratio is fitted too. {SAME_BODIES}"
    return table.drop(columns="camera").sort_index(), notes


def _read_folder(folder: Path) -> tuple[pd.DataFrame, dict[int, list[str]]]:
    """The estimates of one RESULTS, and by clip what its recording is known by: its tracks, and the run's input."""
    path = folder / "estimates.parquet"
    if not path.is_file():
        raise InputError(f"{folder}: no estimates.parquet in it, expected RESULTS, as tracker track or measure make it")
    try:
        table = pd.read_parquet(path)
    except (ArrowException, OSError, ValueError) as error:
        raise InputError(f"{path}: damaged, expected a table of estimates ({first_line(error)})") from None
    if missing := {"clip", "collision", "status"} - set(table.columns):
        raise InputError(f"{path}: no column {', '.join(sorted(missing))}, expected a table of estimates")
    run = load_json(folder / RUN) if (folder / RUN).is_file() else {}
    digest = run.get("input") if isinstance(run, dict) else None
    marks: dict[int, list[str]] = {}
    for number in map(int, table["clip"].unique()):
        tracks = clip_folder(folder, number) / "tracks.csv"
        marks[number] = [hashlib.sha256(tracks.read_bytes()).hexdigest()] if tracks.is_file() else []
        marks[number] += [f"{digest} {number}"] if digest else []
    return table, marks


def _leave_out_repeated(
    table: pd.DataFrame, marks: Mapping[int, Sequence[str]], seen: dict[str, str], name: str
) -> tuple[pd.DataFrame, list[str]]:
    """The table without clips whose recording was `seen` before, with a note for these."""
    twice: dict[int, str] = {}
    measured = table["clip"][table["status"].isin(["no_collision"]) | (table.get("particle2", -1) != -1)]
    for number in map(int, measured.unique()):
        first = next((seen[mark] for mark in marks[number] if mark in seen), None)
        if first is not None:
            twice[number] = first
        for mark in marks[number]:
            seen.setdefault(mark, f"{name}, clip {number}")
    if not twice:
        return table, []
    number, first = next(iter(twice.items()))
    more = f", and {len(twice) - 1} more" if len(twice) > 1 else ""
    note = f"recordings given twice count once: {name}, clip {number} is {first}{more}"
    return table[~table["clip"].isin(list(twice))], [note]


def _choose_fits(table: pd.DataFrame) -> pd.Series:
    """Which fit of each row enters: tied, free, local, or "" where none does."""
    ok = np.where(table["status"].isin(["ok", "no_collision"]), "tied", "")
    if "recommended" not in table:
        return pd.Series(ok, index=table.index)
    said = table["recommended"]
    known = said.where(said.isin(list(SUFFIXES)), "")
    own = said.notna() & (table["status"] != "no_collision")
    return known.where(own, pd.Series(ok, index=table.index)).astype(str)


def _choose_quantities(table: pd.DataFrame, asked: Sequence[str] | None) -> list[str]:
    """The quantities to combine. Raises InputError for one that no column has."""
    if asked is None:
        fits, shared = SUFFIXES.values(), ("r", "s", "mu_k", "C", "drag", "decel")  # by all collisions
        return [name for name in shared if any(f"{name}{suffix}_std" in table for suffix in fits)]
    measured = {str(column).removesuffix("_std") for column in table.columns if str(column).endswith("_std")}
    names = sorted({re.sub("_(free|local|paper)$", "", column) for column in measured if column in table})
    for name in asked:
        if name not in names:
            hint = did_you_mean(name, names)
            raise InputError(f"--quantities: {name}: not measured, expected some of {', '.join(names)}{hint}")
    return list(dict.fromkeys(asked))


def _by_fit(table: pd.DataFrame, name: str, end: str = "") -> Array:
    """A quantity of each row by its recommended fit, or with the end "_std" its standard error; NaN without them."""
    out = np.full(len(table), np.nan)
    for fit, suffix in SUFFIXES.items():
        only_local = "mass_ratio"  # whichever fit is recommended
        rows, column = (table["fit"] == fit).to_numpy(), f"{name}{'' if name == only_local else suffix}{end}"
        if column in table:
            out[rows] = table[column].to_numpy(float)[rows]
    return out


def _is_turned(table: pd.DataFrame) -> Flags:
    """Tell which rows (n,) give the mass of the second particle over that of the first, by their numbers."""
    turned = np.zeros(len(table), dtype=bool)
    if {"particle1", "particle2"} <= set(table):
        turned = (table["particle1"] > table["particle2"]).to_numpy()
    return turned


def _take_values(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """The rows that give a quantity with an error. Raises InputError where an error is not above zero."""
    value, std = _by_fit(table, name), _by_fit(table, name, "_std")
    speed, offset = _by_fit(table, "v0"), _by_fit(table, "b")
    rows = np.isfinite(value) & np.isfinite(std)
    if name not in WITHOUT_COLLISION:
        rows &= (table["status"] != "no_collision").to_numpy()
    if len(wrong := np.flatnonzero(rows & ~(std > 0))):
        row = table.iloc[wrong[0]]
        raise InputError(
            f"{row['result']}: clip {row['clip']}, collision {row['collision']}: {name} has the standard error "
            f"{std[wrong[0]]:g}, expected one above 0"
        )
    with np.errstate(invalid="ignore"):
        along = speed * np.sqrt(1 - np.clip(np.abs(offset), 0, 1) ** 2)
    if name == "mass_ratio" and len(turned := np.flatnonzero(_is_turned(table))):
        value[turned], std[turned] = 1 / value[turned], std[turned] / value[turned] ** 2
    columns = {"v_n": along, "value": value, "std": std}
    return table[["result", "clip", "collision", "fit"]].assign(**columns)[rows]
