"""The table of all contacts of a film with more than two balls, and the physics that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tracker.measurement.collision.adequacy import CROWD
from tracker.measurement.crowd.track_contacts import NO_BALL, TrackContact, find_track_contacts
from tracker.measurement.local.recommendation import NONE, recommended_suffix
from tracker.measurement.positions import to_ball_tracks
from tracker.measurement.random_effects import RandomEffects, fit_random_effects

if TYPE_CHECKING:
    from tracker.camera.camera import Camera
    from tracker.detection.link import Tracks

Floats = NDArray[np.float64]
DERIVED = ("v_n", "v_t", "mu_bb", "impulse", "energy", "energy_lost")  # of v0, b, r and s
SHARED = ("r", "mu_bb", "mu_k")  # what all contacts of a film have in common
UNKNOWN_S = (5 / 7, 0.3)  # and its error, where the tracks do not show it
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
    found = find_track_contacts(to_ball_tracks(tracks, camera), camera.ball_diameter)
    is_crowd = any(row["status"] == CROWD for row in rows)
    pairs, out = 0, []
    for number, contact in enumerate(found):
        row: Mapping[str, Any] | None = None
        if len(contact.balls) == 2:
            row = rows[pairs] if is_crowd and pairs < len(rows) else _find_row(contact, rows, camera)
            pairs += 1
        out.append({"contact": number} | _describe(contact) | _measure(row))
    return pd.DataFrame(out, columns=list(TABLE_COLUMNS))


def _describe(contact: TrackContact) -> dict[str, Any]:
    return {
        "t_s": contact.time,
        "t_s_std": contact.time_std,
        "kind": "wall" if contact.other == NO_BALL else "ball",
        "particle1": contact.one,
        "particle2": contact.other,
        "x": contact.xy[0],
        "y": contact.xy[1],
        "nx": contact.normal[0],
        "ny": contact.normal[1],
        "kick": contact.kick,
        "kick_std": contact.kick_std,
        "confidence": contact.confidence,
    }


def _find_row(
    contact: TrackContact, rows: Sequence[Mapping[str, Any]], camera: Camera, *, max_frames_apart: float = 3.0
) -> Mapping[str, Any] | None:
    """The row of estimates of a contact, by its balls and its time.

    max_frames_apart: of a contact of the tracks and a row of the estimates that are the same.
    """
    own = {contact.one, contact.other}
    near = [
        (abs(time - contact.time), row)
        for row in rows
        if {row["particle1"], row["particle2"]} == own
        for time in (row.get("t_c"), row.get("t_c_local"))
        if time is not None and np.isfinite(time)
    ]
    best = min(near, key=lambda pair: pair[0], default=(np.inf, None))
    return best[1] if best[0] < max_frames_apart / camera.fps else None


def _measure(row: Mapping[str, Any] | None) -> dict[str, Any]:
    """The columns that the row of estimates of a contact gives."""
    if row is None:
        return {"collision": -1, "misfit": False, "recommended": NONE, "why": ""}
    out: dict[str, Any] = {"collision": row["collision"], "misfit": bool(row.get("misfit_local", False))}
    out |= {"recommended": row.get("recommended", ""), "why": row.get("why", "")}
    if out["recommended"] == NONE:
        return out
    suffix = recommended_suffix(row)
    names = ("v0", "b", "r", "s", "mu_k")
    value, std = (np.array([_number(row.get(f"{n}{suffix}{end}")) for n in names]) for end in ("", "_std"))
    out |= {"r": value[2], "r_std": std[2], "mu_k": value[4], "mu_k_std": std[4]}
    if not np.isfinite([value[:3], std[:3]]).all():
        return out
    has_s = np.isfinite(value[3]) and np.isfinite(std[3])
    if not has_s:  # a contact that is almost head-on
        value[3], std[3] = UNKNOWN_S
    step = 1e-4 * np.maximum(std[:4], 1e-12)
    slopes = np.array([(_derive(value[:4] + d) - _derive(value[:4] - d)) / (2 * d.max()) for d in np.diag(step)])
    errors = np.sqrt(((slopes * std[:4, None]) ** 2).sum(axis=0))
    derived = dict(zip(DERIVED, zip(_derive(value[:4]).tolist(), errors.tolist(), strict=True), strict=True))
    if not has_s:
        del derived["mu_bb"]
    return out | {f"{n}{end}": v for n, pair in derived.items() for end, v in zip(("", "_std"), pair, strict=True)}


def _number(value: Any) -> float:
    return np.nan if value is None else float(value)


def _derive(values: Floats) -> Floats:
    """DERIVED from v0, b, r and s."""
    v0, b, r, s = values
    along, across = v0 * np.sqrt(max(1 - b * b, 1e-12)), v0 * abs(b)
    friction = (1 - s) * across / ((1 + r) * along)
    lost = ((1 - r * r) * along**2 + (1 - s * s) * across**2) / 4
    return np.array([along, across, friction, (1 + r) * along / 2, v0**2 / 4, lost])


def summarise_contacts(table: pd.DataFrame, *, least: int = 3) -> dict[str, RandomEffects]:
    """Compute the random-effects means of r, mu_bb and mu_k over the contacts of a film that show them.

    Contacts whose motion the local estimate does not describe are left out.
    """
    out = {}
    for name in SHARED:
        value, std = (table[f"{name}{end}"].to_numpy(float) for end in ("", "_std"))
        known = np.isfinite(value) & (std > 0) & ~table["misfit"].to_numpy(bool)
        if known.sum() >= least:
            out[name] = fit_random_effects(value[known], std[known])
    return out
