"""Traces the spins about the vertical of the balls of a crowd from contact to contact, for the slip of each contact.

A plain ball does not show its spin on film. But each contact shows the tangential impulse J. It changes the spin of
both balls by J / (2/5 m R) against the slip. In a first approximation nothing else changes the spin. So a spin is known
well as the contacts of its ball are measured. Both balls share the error of their impulse, so it counts twice if they
meet again. The spin is zero at the start. A wall, or a contact without a local estimate,
changes it by an unknown amount, but at most by that of a usual friction. The direction of the wall is not known.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from discrepancy.arrays import Array

PER_IMPULSE = 2.5  # change of R times the spin of a solid ball, over J/m
PER_IMPULSE_OF_DISC = 2.0  # the same of a disc, as bodies that glide are taken to be
USUAL_FRICTION = 0.15  # of steel, glass and plastic, on one another and on a wall
AXES = ("1i", "2i", "1o", "2o")  # struck and striking ball, before and after the contact


@dataclass(frozen=True)
class Slip:
    """The slip of a contact just before it, and the impulse that followed, both with the sign of the velocity across.

    across: m/s, of the surfaces along the tangent in the plane, and its standard error. size: with the vertical part,
    m/s. friction: tangential over normal impulse, and its standard error.
    """

    across: float
    across_std: float
    size: float
    friction: float
    friction_std: float


def trace_slips(rows: Iterable[Mapping[Any, Any]], contacts: pd.DataFrame) -> dict[int, Slip]:
    """Trace the slips of the contacts of one film by the number of their collision.

    rows: the estimates of the film. contacts: the columns of contacts.parquet.
    """
    by_number = {int(row["collision"]): row for row in rows}
    spin, errors, out = dict[int, float](), dict[int, dict[int, float]](), dict[int, Slip]()  # errors: by event
    for number, event in enumerate(contacts.sort_values("t_s").to_dict("records")):
        row = by_number.get(int(event["collision"]))
        balls = [int(event[name]) for name in ("particle1", "particle2") if int(event[name]) >= 0]
        if row is None or not _is_measured(row):
            for ball in balls:
                errors.setdefault(ball, {})[number] = PER_IMPULSE * USUAL_FRICTION * float(event["kick"])
            continue
        turning = sum(spin.get(ball, 0.0) for ball in balls)  # R times the sum of both spins
        both = [errors.setdefault(ball, {}) for ball in balls]
        error = sum(sum(own.get(k, 0.0) for own in both) ** 2 for k in set().union(*both))
        slip, change, change_std = _read_slip(row, turning, error, row.get("motion_local") == "glide")
        out[int(event["collision"])] = slip
        spin |= {ball: spin.get(ball, 0.0) + change for ball in balls}
        for own in both:
            own[number] = change_std
    return out


def _is_measured(row: Mapping[Any, Any]) -> bool:
    names = ("v0_local", "b_local", "r_local", *(f"v{k}{axis}_local" for k in AXES for axis in "xy"))
    return all(np.isfinite([row[name], row[f"{name}_std"]]).all() for name in names)


def _read_slip(row: Mapping[Any, Any], turning: float, variance: float, glides: bool) -> tuple[Slip, float, float]:
    """The slip of a contact, and how R times the spin of each ball then changes, with its error.

    turning, variance: R times the sum of both spins before. glides: the surfaces of bodies that do not roll have no
    vertical velocity.
    """
    v0, b, r = (float(row[f"{name}_local"]) for name in ("v0", "b", "r"))
    into1, into2, out1, out2 = _read_velocities(row)
    heading = (into2 - into1) / np.hypot(*(into2 - into1))
    cosine = np.sqrt(max(1 - b * b, 1e-6))
    normal = cosine * heading + b * np.array([heading[1], -heading[0]])  # from the striking to the struck ball
    tangent = np.array([-normal[1], normal[0]])
    along, across = v0 * cosine, v0 * b
    impulse = float(tangent @ ((out1 - into1) - (out2 - into2))) / 2  # over m, on the struck ball
    noise = np.sqrt(sum(float(row[f"v{k}{axis}_local_std"]) ** 2 for k in AXES for axis in "xy") / 2) / 2
    impulse_std = float(np.hypot(noise, (1 + r) / 2 * along * float(row["b_local_std"]) / cosine))
    normal_impulse = (1 + r) / 2 * along
    sign = 1.0 if b >= 0 else -1.0
    slip = Slip(
        across=sign * (across + turning),
        across_std=float(np.sqrt(variance + float(row["v0_local_std"]) ** 2 * b * b)),
        size=float(np.hypot(across + turning, 0.0 if glides else (into1 + into2) @ normal)),
        friction=sign * impulse / normal_impulse,
        friction_std=float(np.hypot(impulse_std, impulse * float(row["r_local_std"]) / (1 + r)) / normal_impulse),
    )
    per_impulse = PER_IMPULSE_OF_DISC if glides else PER_IMPULSE
    return slip, -per_impulse * impulse, per_impulse * impulse_std


def _read_velocities(row: Mapping[Any, Any]) -> Iterator[Array]:
    return (np.array([float(row[f"v{k}{axis}_local"]) for axis in "xy"]) for k in AXES)
