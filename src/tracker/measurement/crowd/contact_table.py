"""The table of all contacts of a film with more than two balls, and the physics that they share."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.camera_errors import shared_effects
from tracker.measurement.collision.adequacy import is_seen_to_glide
from tracker.measurement.crowd.track_contacts import NO_BALL, TrackContact, find_track_contacts
from tracker.measurement.local.local_columns import find_covariance
from tracker.measurement.local.local_estimate import LOCAL_NAMES
from tracker.measurement.local.recommendation import COMPARED, LOCAL, NONE, SUFFIXES, find_recommended_suffix, is_known
from tracker.measurement.positions import to_ball_tracks
from tracker.measurement.random_effects import RandomEffects, fit_random_effects

DERIVED = ("v_n", "v_t", "mu_bb", "impulse", "energy", "energy_lost")  # of v0, b, r and s
SIGNED = np.array([name in ("v_t", "mu_bb") for name in DERIVED])  # of which the table has the size
TABLE_COLUMNS = (
    "contact t_s t_s_std kind particle1 particle2 x y nx ny kick kick_std confidence collision".split()
    + [f"{name}{end}" for name in ("v_n", "v_t", "r", "mu_bb", "mu_k", *DERIVED[3:]) for end in ("", "_std")]
    + ["misfit", "recommended", "why"]
)


def tabulate_contacts(tracks: Tracks, camera: Camera, rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Tabulate all contacts of a recording; empty for one or two balls, or without a scale.

    rows: its estimates, from which contacts of two balls take their values.
    """
    if not (camera.metric and camera.knows_diameter) or len(np.unique(tracks.particle)) < 3:
        return pd.DataFrame(columns=list(TABLE_COLUMNS))
    glides = camera.glides or is_seen_to_glide(rows)
    found = find_track_contacts(to_ball_tracks(tracks, camera), camera.ball_diameter, glides=glides)
    out = [
        {"contact": number} | _describe(contact) | _measure(_find_row(contact, rows, 3.0 / camera.fps))
        for number, contact in enumerate(found)
    ]
    return pd.DataFrame(out, columns=list(TABLE_COLUMNS))


def _describe(contact: TrackContact) -> dict[str, Any]:
    kind, (x, y), (nx, ny) = "wall" if contact.other == NO_BALL else "ball", contact.xy, contact.normal
    row = {"t_s": contact.time, "t_s_std": contact.time_std, "kind": kind}
    row |= {"particle1": contact.one, "particle2": contact.other, "x": x, "y": y, "nx": nx, "ny": ny}
    return row | {"kick": contact.kick, "kick_std": contact.kick_std, "confidence": contact.confidence}


def _find_row(
    contact: TrackContact, rows: Sequence[Mapping[str, Any]], most_apart_s: float
) -> Mapping[str, Any] | None:
    """The row of estimates of a contact, by its balls and its time."""
    near = [
        (abs(row[column] - contact.time), row)
        for row in rows
        if {row["particle1"], row["particle2"]} == {contact.one, contact.other}
        for column in ("t_c", "t_c_local")
        if is_known(row, column)
    ]
    best = min(near, key=lambda pair: pair[0], default=(np.inf, None))
    return best[1] if best[0] < most_apart_s else None


def _measure(row: Mapping[str, Any] | None) -> dict[str, Any]:
    """The columns that the row of estimates of a contact gives."""
    if row is None:
        return {"collision": -1, "misfit": False, "recommended": NONE, "why": ""}
    out: dict[str, Any] = {"collision": row["collision"], "misfit": bool(row.get("misfit_local", False))}
    out |= {"recommended": row.get("recommended", ""), "why": row.get("why", "")}
    if out["recommended"] == NONE:
        return out
    suffix = find_recommended_suffix(row)
    columns = [f"{name}{suffix}" for name in (*COMPARED, "mu_k")]
    value, std = (np.array([row.get(f"{c}{end}") for c in columns], dtype=np.float64) for end in ("", "_std"))
    out |= {"r": value[2], "r_std": std[2], "mu_k": value[4], "mu_k_std": std[4]}
    if not np.isfinite([value[:3], std[:3]]).all():
        return out
    cov = find_covariance(row) if suffix == SUFFIXES[LOCAL] else np.diag(std[:4] ** 2)
    has_friction = bool(np.isfinite([value[3], std[3]]).all())
    if not has_friction and suffix == SUFFIXES[LOCAL]:
        value[3] = json.loads(row["local"])["value"][LOCAL_NAMES.index("s")]  # too uncertain for a column of its own
        has_friction = bool(np.isfinite(value[3]) and abs(value[1]) > 3 * std[1])
    if not np.isfinite(value[3]):  # almost head-on: both balls keep the tangential speed, or stick
        cov[3] = cov[:, 3] = 0.0
        value[3], cov[3, 3] = 5 / 7, 0.3**2
    derived = dict(zip(DERIVED, zip(*derive_with_errors(value[:4], cov), strict=True), strict=True))
    if not has_friction:
        del derived["mu_bb"]
    return out | {f"{n}{end}": v for n, pair in derived.items() for end, v in zip(("", "_std"), pair, strict=True)}


def derive_with_errors(value: Array, cov: Array) -> tuple[list[float], list[float]]:
    """Compute the DERIVED columns of the table of contacts and their errors, by values one standard error away.

    The mean of a quantity that bends, such as 1 - r^2, is corrected for the spread of r. The steps are those of the
    tangential speed afterwards, not of s, which is that speed over b. Balls that meet head-on have a speed, also of
    their spins, but no s.

    value, cov: of v0, b, r and s.
    """
    _, b, _, s = value
    to_speeds = np.eye(4)
    to_speeds[3] = 0.0, s, 0.0, b
    variances, axes = np.linalg.eigh(to_speeds @ cov @ to_speeds.T)
    away = (axes * np.sqrt(np.maximum(variances, 0))).T
    at = np.append(value[:3], s * b)
    middle = _derive(at)
    high, low = (np.array([_derive(at + sign * step) for step in away]) for sign in (1, -1))
    slope, bend = (high - low) / 2, high + low - 2 * middle
    corrected, std = middle - bend.sum(axis=0) / 2, np.sqrt((slope**2 + bend**2 / 2).sum(axis=0))
    return np.where(SIGNED, np.abs(corrected), corrected).tolist(), std.tolist()


def _derive(values: Array) -> Array:
    """DERIVED from v0, b, r and the tangential speed afterwards over v0; v_t and mu_bb with the sign of b."""
    v0, b, r, left = values
    along, across, after = v0 * np.sqrt(max(1 - b * b, 1e-12)), v0 * b, v0 * left
    friction = (across - after) / ((1 + r) * along)
    lost = ((1 - r * r) * along**2 + across**2 - after**2) / 4
    return np.array([along, across, friction, (1 + r) * along / 2, v0**2 / 4, lost])


def summarise_contacts(table: pd.DataFrame, rows: Sequence[Mapping[str, Any]]) -> dict[str, RandomEffects]:
    """Summarise the table of all contacts of a film: random-effects means of r, mu_bb and mu_k.

    Contacts whose motion the local estimate does not describe are left out. Errors that contacts share, such as that of
    the friction of the plate, do not average out.

    rows: the estimates of the film.
    """
    least, least_share = 3, 0.1  # contacts that a mean needs; of the error of a contact that is its own
    out, by_number = {}, {row["collision"]: row for row in rows}
    for name in ("r", "mu_bb", "mu_k"):  # what all contacts of a film have in common
        value, std = (table[f"{name}{end}"].to_numpy(float) for end in ("", "_std"))
        known = np.isfinite(value) & (std > 0) & ~table["misfit"].to_numpy(bool)
        if known.sum() < least:
            continue
        own = [by_number[n] for n in table["collision"][known]]
        local = [row["local_shared"] if row["recommended"] == LOCAL else "" for row in own]
        shared = shared_effects(pd.DataFrame({"local_shared": local, "fit": LOCAL}), [name])[:, 0]
        alone = np.maximum(std[known] ** 2 - (shared**2).sum(axis=1), (least_share * std[known]) ** 2)
        out[name] = fit_random_effects(value[known], np.sqrt(alone), shared)
    return out
