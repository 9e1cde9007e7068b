"""Velocity, energy and momentum frame by frame, as the paper plots them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.collision.adequacy import MEASURED
from tracker.measurement.collision.collision_model import AFTER, tied_to_free
from tracker.measurement.positions import BallTrack, to_ball_tracks

Floats = NDArray[np.float64]
BEFORE = ("u2ix", "u2iy", "side2i", "v1ix", "v1iy")  # columns of estimates: SPIN and TARGET of a tied motion
COLUMNS = ("t_s", "particle", "vx", "vy", "energy", "p_along", "p_across")


def make_motion_table(tracks: Tracks, camera: Camera, row: Mapping[str, Any]) -> pd.DataFrame:
    """Velocity, energy and momentum of each ball frame by frame, per unit mass.

    Parameters
    ----------
    tracks, camera
    row : mapping
        A row of `measure`: the collision whose directions of slip count.

    Returns
    -------
    DataFrame
        t_s; particle; vx, vy (m/s): differences between the neighbouring frames; energy (m^2/s^2): v^2/2 less what
        noise adds to it, which may fall below zero at rest; p_along, p_across (m/s): along the ball's own direction of
        slip after the collision and across it (z x that), the paper's x and y; NaN for a ball that took no part in it.
    """
    slips = slip_directions(row)
    balls = [c for c in to_ball_tracks(tracks, camera) if len(c) >= 2] if camera.metric else []
    empty = [np.empty(0, np.int64 if name == "particle" else float) for name in COLUMNS]
    parts = [empty, *(_differentiate_track(track, slips.get(track.particle)) for track in balls)]
    whole = map(np.concatenate, zip(*parts, strict=True))
    return pd.DataFrame(dict(zip(COLUMNS, whole, strict=True)))


def slip_directions(row: Mapping[str, Any]) -> dict[int, Floats]:
    """Find the direction of slip (2,) by particle just after the impact, to which momentum refers."""
    launch = [row.get(name, np.nan) for name in ("heading", "b", "v0", "r", "C")]
    if row.get("status") not in MEASURED or not np.all(np.isfinite(launch)):
        return {}
    heading, b, v0, r, c = map(float, launch)
    before = [float(np.nan_to_num(row.get(name, 0.0))) for name in BEFORE]
    tied = np.array([0, 0, 0, heading, np.arcsin(np.clip(b, -1, 1)), v0, 0, 0, r, 0, c, *before])
    free = np.asarray(tied_to_free(tied), dtype=np.float64)
    slips = {int(row[f"particle{ball}"]): free[at : at + 2] - free[at + 2 : at + 4] for ball, at in AFTER.items()}
    return {particle: slip / max(float(np.hypot(*slip)), 1e-300) for particle, slip in slips.items()}


def _differentiate_track(track: BallTrack, slip: Floats | None) -> list[NDArray[Any]]:
    """The columns of one ball: velocities are differences between the neighbouring frames."""
    last = len(track) - 1
    ahead, behind = np.minimum(np.arange(last + 1) + 1, last), np.maximum(np.arange(last + 1) - 1, 0)
    span = (track.start[ahead] - track.start[behind])[:, None]
    velocity = (track.position[ahead] - track.position[behind]) / span
    noise = np.trace(track.cov[ahead] + track.cov[behind], axis1=1, axis2=2) / span[:, 0] ** 2  # in v^2
    along = np.full(2, np.nan) if slip is None else slip
    across = np.array([-along[1], along[0]])
    values = [track.time, np.full(len(track), track.particle), velocity[:, 0], velocity[:, 1]]
    return [*values, ((velocity**2).sum(axis=1) - noise) / 2, velocity @ along, velocity @ across]
