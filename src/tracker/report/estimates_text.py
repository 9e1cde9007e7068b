"""Measured quantities as text: for a terminal, a page and a notebook."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from synthcam_shared.report.numbers import NOT_KNOWN, format_with_error
from tracker.measurement.collision.adequacy import MEASURED, MISFIT
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.report.quantities import QUANTITIES, Quantity

# suffix of a column: the method that gave its value
METHODS = {"": "tied fit", "_free": "free fit", "_paper": "finite differences"}


class QuantityLine(NamedTuple):
    """A quantity with its column name and, as text, its value and error by each of `METHODS`."""

    name: str
    quantity: Quantity
    values: tuple[str, ...]


def rows_as_dicts(estimates: pd.DataFrame) -> list[dict[str, Any]]:
    """Turn a table of estimates into one dictionary by column for each row."""
    return [{str(name): value for name, value in row.items()} for row in estimates.to_dict("records")]


def list_quantities(row: Mapping[str, Any], names: Sequence[str] = QUANTITY_NAMES) -> list[QuantityLine]:
    """List the quantities of one row of estimates; those without a value by any method are left out."""
    lines = [
        QuantityLine(name, QUANTITIES[name], tuple(format_value(row, f"{name}{suffix}") for suffix in METHODS))
        for name in names
    ]
    return [line for line in lines if any(value != NOT_KNOWN for value in line.values)]


def format_value(row: Mapping[str, Any], column: str) -> str:
    """Format the value of a column, with the error beside it, in the unit of its quantity."""
    value, std = (row[name] for name in (column, f"{column}_std"))
    factor = QUANTITIES[column.removesuffix("_free").removesuffix("_paper")].factor
    return format_with_error(*(None if x is None else float(x) * factor for x in (value, std)))


def describe_status(row: Mapping[str, Any]) -> str:
    """Say in a sentence what the tracks of a row show."""
    known = {
        "ok": "Two balls collide. One model of impact, sliding and rolling describes their tracks",
        MISFIT: "Two balls collide. Their tracks reject the model of two equal balls that roll, collide and slide",
        "no_collision": "No two balls touch",
    }
    return known.get(row["status"], f"Not measured: {row['status']}")


def describe_frames(row: Mapping[str, Any]) -> str:
    """Give the frames that a collision is measured from; "" where there is no collision."""
    return f", frames {row['frame_first']:.0f} to {row['frame_last']:.0f}" if row.get("frame_last", -1) >= 0 else ""


def describe_fit(row: Mapping[str, Any]) -> str:
    """Give χ² and p of the tied fit; "" where there is no fit."""
    if row["status"] not in MEASURED or not row["dof"]:
        return ""
    return f"χ²/dof {row['chi2'] / row['dof']:.3g}, dof {int(row['dof'])}, p {row['adequate']:.2g}"


def format_for_terminal(estimates: pd.DataFrame, max_collisions: int = 6) -> Iterator[str]:
    """Yield lines for a terminal: each collision, or, of more than `max_collisions`, medians of those that are ok."""
    names = ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction", "momentum_fraction")
    if len(estimates) <= max_collisions:
        for row in rows_as_dicts(estimates):
            yield from _format_row(row, names)
        return
    ok = estimates[estimates["status"] == "ok"]
    if len(ok):
        yield f"{'median of ' + str(len(ok)) + ' ok':<18}{'value':>12}{'error of one':>14}  unit"
    for name in names if len(ok) else ():
        quantity = QUANTITIES[name]
        value, std = (float(ok[column].median()) * quantity.factor for column in (name, f"{name}_std"))
        if math.isfinite(value):
            yield f"  {quantity.plain_symbol:<16}{value:>12.4g}{std:>14.2g}  {quantity.unit}".rstrip()


def _format_row(row: Mapping[str, Any], names: Sequence[str]) -> Iterator[str]:
    yield f"clip {row['clip']}, collision {row['collision']}{describe_frames(row)}: {describe_status(row)}."
    is_measured = row["status"] in MEASURED
    lines = list_quantities(row, names if is_measured else ("v0", "drag", "decel"))
    methods = 2 if is_measured else 1
    if lines and is_measured:
        heads = "".join(f"{method:>16}" for method in list(METHODS.values())[:methods])
        yield f"  {'':<8}{heads}  {describe_fit(row)}".rstrip()
    for line in lines:
        values = "".join(f" {value:>15}" for value in line.values[:methods])
        yield f"  {line.quantity.plain_symbol:<8}{values}  {line.quantity.unit:<6}{line.quantity.meaning}".rstrip()
