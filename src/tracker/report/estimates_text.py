"""Measured quantities as text: for a terminal, a page and a notebook."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from synthcam_shared.report.numbers import NOT_KNOWN, format_with_error
from tracker.measurement.collision.adequacy import (
    CROWD,
    MEASURED,
    MISFIT,
    ONE_BALL,
    TOGETHER,
    Flag,
    list_disproving_values,
)
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.local.recommendation import find_recommended_suffix
from tracker.report.quantities import QUANTITIES, Quantity
from tracker.results import rows_as_dicts

# suffix of a column: the method that gave its value
METHODS = {"": "tied fit", "_free": "free fit", "_local": "local estimate", "_paper": "finite differences"}

OF_ONE_BALL = ("v0", "drag", "decel")
SPEED_ALONE = replace(QUANTITIES["v0"], meaning="speed of the ball where it is first seen")


class QuantityLine(NamedTuple):
    """A quantity with its column name and, as text, its value and error by each of `order_methods`."""

    name: str
    quantity: Quantity
    values: tuple[str, ...]


def order_methods(row: Mapping[str, Any]) -> dict[str, str]:
    """Order METHODS, the recommended one first; values of a rejected fit are not shown beside it."""
    first = find_recommended_suffix(row)
    shown = {first: METHODS[first]} | METHODS
    if _has_recommended_values(row):
        for suffix in [s for s in shown if s != first and row["status"] == MISFIT]:
            values = [name for name in QUANTITY_NAMES if _is_known(row, f"{name}{suffix}")]
            if values and not any(_is_known(row, f"{n}{suffix}_std") for n in values):  # the tracks reject the fit
                del shown[suffix]
    return shown


def has_values(row: Mapping[str, Any]) -> bool:
    """Decide whether there are measured values of a row to write as text, by a fit or by the local estimate."""
    return row["status"] in MEASURED or find_recommended_suffix(row) == "_local"


def _has_recommended_values(row: Mapping[str, Any]) -> bool:
    """Decide whether a row has values to rely on; results of older versions have no recommendation."""
    recommended = row.get("recommended", "tied" if row["status"] == "ok" else "none")
    return recommended != "none" and has_values(row)


def describe_recommendation(row: Mapping[str, Any]) -> str:
    """Say in the text which estimate to use, and why; "" of a row without values."""
    if not has_values(row) or not row.get("why"):
        return ""
    if row["recommended"] == "none":
        return f"No estimate is recommended: {row['why']}"
    return f"Recommended is the {METHODS[find_recommended_suffix(row)]}: {row['why']}"


def describe_velocities(row: Mapping[str, Any]) -> str:
    """Say which speeds a local estimate has just before and after the hit, what they keep, and the balance."""
    if row.get("recommended") != "local":
        return ""

    def speed(name: str) -> str:
        x, y, x_std, y_std = (row[f"{name}{axis}_local{kind}"] for kind in ("", "_std") for axis in "xy")
        size = math.hypot(x, y)
        std = math.hypot(x * x_std, y * y_std) / size if size > 0 else max(x_std, y_std)
        return format_with_error(1e2 * size, 1e2 * std)

    before = f"Striker before the hit {speed('v2i')} cm/s"
    if math.hypot(row["v1ix_local"], row["v1iy_local"]) > 0:
        before += f", struck ball {speed('v1i')} cm/s"
    kept = format_with_error(row["impact_energy_local"], row["impact_energy_local_std"])
    along, across = (
        format_with_error(1e2 * row[f"balance_{axis}_local"], 1e2 * row[f"balance_{axis}_local_std"]) for axis in "nt"
    )
    ratio = format_with_error(row["mass_ratio"], row["mass_ratio_std"])
    return (
        f"{before}; just after it {speed('v2o')} cm/s, and the struck ball {speed('v1o')} cm/s. "
        f"The hit keeps {kept} of the translational energy. "
        f"Momentum is off by {along} cm/s along the line of centres and {across} cm/s across it. "
        f"Recoil gives a mass ratio of {ratio}"
    )


def describe_rolling(row: Mapping[str, Any]) -> str:
    """Say in the text which rolling loss a ball by itself has where it is first seen; "" without one.

    The two parts of the loss, C_roll and D_roll, are hardly told from one another where the speed changes little. Their
    sum is known better, and is given even where both parts are refused. A large loss is that of a slide.
    """
    largest_of_rolling = 0.05 * GRAVITY  # m/s^2; balls on cloth lose a fifth of that
    found = json.loads(row.get("cov") or "{}").get("rolling_loss")
    if row["status"] != "no_collision" or found is None:
        return ""
    ((value, std),) = np.array(found, dtype=float)
    loss = format_with_error(1e2 * value, 1e2 * std) if 0 < std < abs(value) else NOT_KNOWN
    if loss == NOT_KNOWN:
        return ""
    if value - 3 * std < largest_of_rolling:
        return f"The rolling loss at that speed is {loss} cm/s²"
    friction = format_with_error(value / GRAVITY, std / GRAVITY)
    return f"It loses {loss} cm/s², more than balls that roll: if it slides on a level plate, μk is {friction}"


def list_quantities(row: Mapping[str, Any], names: Sequence[str] = QUANTITY_NAMES) -> list[QuantityLine]:
    """List the quantities of one row of estimates; those without a value by any method are left out."""
    methods = order_methods(row)
    known = QUANTITIES | {"v0": SPEED_ALONE} if row["status"] == "no_collision" else QUANTITIES
    lines = [
        QuantityLine(name, known[name], tuple(format_value(row, f"{name}{suffix}") for suffix in methods))
        for name in names
    ]
    return [line for line in lines if any(value != NOT_KNOWN for value in line.values)]


def format_value(row: Mapping[str, Any], column: str) -> str:
    """Format a measured quantity as text, with the error beside it, in its unit."""
    value, std = (row[name] for name in (column, f"{column}_std"))
    factor = QUANTITIES[column.removesuffix("_free").removesuffix("_local").removesuffix("_paper")].factor
    return format_with_error(*(None if x is None else float(x) * factor for x in (value, std)))


def describe_contact_count(table: pd.DataFrame) -> str:
    """Say in a sentence how many contacts were measured in a film of more than two balls, and how many have values."""
    walls = int((table["kind"] == "wall").sum())
    known = int(table["r"].notna().sum())
    return (
        f"{len(table) - walls} contacts of two balls and {walls} with walls or with something unseen. "
        f"r is known in {known} of them; contacts.csv lists all."
    )


def describe_status(row: Mapping[str, Any]) -> str:
    """Say in a sentence of the text what the tracks of a row show."""
    if row["status"] == TOGETHER:
        frames = f"from frame {row['contact_first']:.0f} to {row['contact_last']:.0f}"
        return f"Two balls collide and stay together {frames}"
    if row["status"] == "no_collision":
        return "No two balls touch" + (". One ball moves by itself" if _is_known(row, "v0") else "")
    if row["status"] == ONE_BALL:
        return f"One ball is followed, and its track is written. There is {ONE_BALL.removeprefix('one ball: ')}"
    if row["status"] == CROWD:
        return f"Balls {row['particle1']} and {row['particle2']} of many collide"
    if row["status"] not in MEASURED:
        return f"Not measured: {row['status']}"
    if is_straight(row):
        model = "straight lines of two equal bodies, before and after the contact, without a law of friction"
    elif row.get("contact_first", -1) >= 0:
        model = "the model of two equal balls that roll, push each other for a while, slide and roll on"
    else:
        model = "the model of two equal balls that roll, collide and slide"
    if values := list_disproving_values(row):
        return (
            f"Two balls collide. Their tracks agree with {model}, but only with {' and '.join(values)}, and no two "
            "balls can have that"
        )
    if row["status"] == MISFIT:
        return f"Two balls collide. Their tracks reject {model}"
    if row.get("contact_first", -1) < 0 and not is_straight(row):
        return "Two balls collide. One model of impact, sliding and rolling describes their tracks"
    return f"Two balls collide. Their tracks agree with {model}"


def is_straight(row: Mapping[str, Any]) -> bool:
    """Decide, for the text of a measured collision, whether its paths are straight lines after the contact."""
    if row["status"] not in MEASURED:
        return False
    if Flag.STRAIGHT in row.get("flags", "").split("|"):
        return True
    return bool(row.get("contact_first", -1) >= 0 and row["r"] == row["r_free"] and not _is_known(row, "mu_k"))


def describe_contact(row: Mapping[str, Any]) -> str:
    """Say in the text how long a measured contact lasts; "" of one that takes no time."""
    lines = list[str]()
    if _is_known(row, "contact_duration_local"):
        time = format_with_error(*(1e3 * row[f"contact_duration_local{end}"] for end in ("", "_std")))
        lines.append(f"By the bend of their paths the bodies push each other for {time} ms, whatever their diameter")
    if _is_known(row, "contact_duration_s"):
        time = format_with_error(*(1e3 * row[f"contact_duration_s{end}"] for end in ("", "_std")))
        frames = f"the fits leave out frames {row['contact_first']:.0f} to {row['contact_last']:.0f}"
        sure = ", if ball_diameter is right" if Flag.LASTS_OR_SMALLER in row["flags"].split("|") else ""
        if row["status"] == MISFIT:
            lines.append(f"The fit that the tracks reject takes {1e3 * row['contact_duration_s']:.3g} ms; {frames}")
        else:
            lines.append(f"The contact lasts {time} ms{sure}; {frames}")
    return ". ".join(lines)


def explain_dashes(row: Mapping[str, Any], names: Sequence[str] = QUANTITY_NAMES) -> list[str]:
    """Explain in the text, by one sentence for each reason, why quantities have no value, or none with an error."""
    if row["status"] not in MEASURED:
        return []
    flags = row["flags"].split("|")
    missing = {s: {n for n in names if not _is_known(row, f"{n}{s}")} for s in ("", "_free")}
    bare = any(_is_known(row, n) and not _is_known(row, f"{n}_std") for n in names)
    reasons = []
    straight, lasts = is_straight(row), Flag.LASTS in flags or Flag.LASTS_OR_SMALLER in flags
    if straight:
        reasons.append("both fits are straight lines after the contact: no slide is seen, so nothing that needs one")
    elif missing["_free"] & {"tau1", "tau2", "mu_k", "r", "energy_fraction"}:
        reasons.append(
            "free fit: the tracks are too short or too noisy to show the velocity after the hit and the end of a slide"
        )
    if missing[""] and not reasons:
        reasons.append("tied fit: the error is larger than a fifth of the value, or than the limits of docs/format.md")
    if lasts and not straight and "r" in missing[""] and row["status"] != MISFIT:
        reasons.append("tied fit: r depends on the law of the force in the contact, which the positions do not show")
    local = [_is_known(row, f"{n}_local") for n in names]
    if any(local) and not all(local):
        reasons.append("local estimate: the positions near the contact do not show it")
    values = list_disproving_values(row)
    impossible = f"{' and '.join(values)} {'is' if len(values) == 1 else 'are'} impossible" if values else ""
    if "" not in order_methods(row):
        reasons.append(
            f"tied fit: not shown, because {impossible or 'the tracks reject it'}; its values are in the table of "
            "estimates"
        )
    elif row["status"] == MISFIT and bare:
        reasons.append(f"no error: {impossible or 'the tracks reject the fit'}")
    shown = [n for n in names if any(_is_known(row, f"{n}{s}") for s in METHODS)]
    if any(not _is_known(row, f"{n}_paper") for n in shown):
        if lasts:
            why = "the frames after a contact that lasts are too far from its beginning to show what it changes"
        elif straight:
            why = "no slide is seen, so nothing that needs one"
        else:
            why = "frames next to the contact, or next to the end of a slide, are missing"
        reasons.append(f"finite differences: {why}")
    return reasons


def is_extrapolated(row: Mapping[str, Any], name: str, suffix: str) -> bool:
    """Decide, for the text of a tied fit's value, whether it is of a time after the balls were last seen."""
    if suffix or row["status"] not in MEASURED or not _is_known(row, name):
        return False
    return name in str(row.get("extrapolated", "")).split("|")


def _is_known(row: Mapping[str, Any], column: str) -> bool:
    value = row.get(column)
    return value is not None and math.isfinite(value)


def describe_frames(row: Mapping[str, Any]) -> str:
    """Say in the text which frames a collision is measured from; "" where there is no collision."""
    return f", frames {row['frame_first']:.0f} to {row['frame_last']:.0f}" if row.get("frame_last", -1) >= 0 else ""


def describe_fit(row: Mapping[str, Any]) -> str:
    """Say in the text χ² and p of the tied fit; "" where there is no fit."""
    if row["status"] not in MEASURED or not row["dof"]:
        return ""
    return f"tied fit: χ²/dof {row['chi2'] / row['dof']:.3g}, dof {int(row['dof'])}, p {row['adequate']:.2g}"


def format_for_terminal(estimates: pd.DataFrame, max_collisions: int = 6) -> Iterator[str]:
    """Yield lines for a terminal: each collision, or, of more than `max_collisions`, medians of recommended values."""
    names = ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction", "momentum_fraction")
    if len(estimates) <= max_collisions:
        for row in rows_as_dicts(estimates):
            yield from _format_row(row, names)
        return
    used = [row for row in rows_as_dicts(estimates) if _has_recommended_values(row)]
    if used:
        yield f"{'median of ' + str(len(used)) + ' hits':<18}{'value':>12}{'error of one':>14}  unit"
    for name in names if used else ():
        quantity = QUANTITIES[name]
        pairs = [[row[f"{name}{find_recommended_suffix(row)}{kind}"] for kind in ("", "_std")] for row in used]
        value, std = pd.DataFrame(pairs, dtype=float).median() * quantity.factor
        if math.isfinite(value):
            yield f"  {quantity.plain_symbol:<16}{value:>12.4g}{std:>14.2g}  {quantity.unit}".rstrip()


def _format_row(row: Mapping[str, Any], names: Sequence[str]) -> Iterator[str]:
    collision = "" if row["status"] in ("no_collision", ONE_BALL) else f", collision {row['collision']}"
    yield f"clip {row['clip']}{collision}{describe_frames(row)}: {describe_status(row)}."
    is_measured = has_values(row)
    unmeasured = ("v0", "b", "r") if row["status"] == TOGETHER else OF_ONE_BALL
    lines = list_quantities(row, names if is_measured else unmeasured)
    methods = order_methods(row) if is_measured else {"": ""}
    for text in (describe_contact(row), describe_recommendation(row), describe_velocities(row), describe_rolling(row)):
        if text:
            yield f"  {text}."
    if lines and is_measured:
        heads = "".join(f"{method:>19}" for method in methods.values())
        yield f"  {'':<8}{heads}  {describe_fit(row)}".rstrip()
    for line in lines:
        marks = ["*" if is_extrapolated(row, line.name, suffix) else "" for suffix in methods]
        texts = [f"{value}{mark}" for value, mark in zip(line.values, marks, strict=False)]
        values = "".join(f" {text:>{18 if is_measured else 15}}" for text in texts)
        yield f"  {line.quantity.plain_symbol:<8}{values}  {line.quantity.unit:<6}{line.quantity.meaning}".rstrip()
    if "" in methods and any(is_extrapolated(row, line.name, "") for line in lines):
        yield "  * extrapolated: a ball slides for longer than it is seen, or may do so."
    if lines and any(value == NOT_KNOWN for line in lines for value in line.values[: len(methods)]):
        for reason in explain_dashes(row, names):
            yield f"  {NOT_KNOWN} {reason}."
