"""The paper's own measurement of a collision: finite differences at the frame of least separation, or frame by frame.

It is kept because it shows the bias of the method. Within .01 s of the contact sliding has already slowed one ball
and sped up the other. The restitution is therefore too low, and the lower the slower the frame rate.

Source: Painter & Behringer 2000, sections III B and IV, with the frames that the data format fixes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from synthcam_shared.arrays import Array
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.camera_errors import camera_errors
from tracker.measurement.collision.adequacy import MEASURED
from tracker.measurement.collision.collision_model import AFTER, GRAVITY, tied_to_free
from tracker.measurement.collision.contacts import Contact
from tracker.measurement.collision.derived import QUANTITY_NAMES, cross, dot
from tracker.measurement.collision.lasting_contact import LastingContact
from tracker.measurement.positions import BallTrack, to_ball_tracks

BEFORE = ("u2ix", "u2iy", "side2i", "v1ix", "v1iy")  # columns of estimates: SPIN and TARGET of a tied motion
COLUMNS = ("t_s", "particle", "vx", "vy", "energy", "p_along", "p_across")


def make_paper_columns(
    contact: Contact, camera: Camera, friction: float, lasting: LastingContact | None = None
) -> dict[str, float]:
    """Make the columns NAME_paper and NAME_paper_std of the paper's measurement, with the errors of the camera file.

    The error of r also holds the bias by the friction on the plate. A contact that lasts leaves only the speed before
    it: the differences after it are as far from its beginning as its duration is long.
    """
    if lasting is not None:
        contact = replace(contact, first=lasting.first, last=lasting.last)
    table = read_differences(contact, camera.fps)
    square = {name: std**2 for name, (_, std) in table.items()}
    for error in camera_errors(camera):
        moved = ((replace(contact, pair=error.pair(contact.pair, by, camera.fps)), by) for by in (1, -1))
        high, low = (read_differences(one, error.rate(camera.fps, by)) for one, by in moved)
        for name in table:
            square[name] += ((high[name][0] - low[name][0]) / 2) ** 2
    square["r"] += find_bias_of_restitution(table, friction, camera.fps) ** 2
    out = dict[str, float]()
    for name, (value, _) in table.items():
        known = lasting is None or name == "v0"
        out |= {f"{name}_paper": value if known else np.nan}
        out |= {f"{name}_paper_std": float(np.sqrt(square[name])) if known else np.nan}
    return out


def find_bias_of_restitution(table: dict[str, tuple[float, float]], friction: float, fps: float) -> float:
    """Find by how much r is too low because both balls slide until their velocity is differenced; NaN without r.

    The velocity after the contact is that of two frames later. Until then friction takes 2 mu g from the speed at which
    the balls part. If they roll before, it takes 2/7 (1 + r) of the closing speed.
    """
    (v0, _), (b, _), (r, _) = (table[name] for name in ("v0", "b", "r"))
    closing = v0 * np.sqrt(max(1 - b**2, 0.1))
    return float(min(2 * max(friction, 0.0) * GRAVITY * 2 / fps / closing, 2 / 7 * (1 + max(r, 0.0))))


def read_differences(contact: Contact, fps: float) -> dict[str, tuple[float, float]]:
    """Measure QUANTITY_NAMES by the paper's finite differences: (value, standard error); NaN where frames are missing.

    Errors propagate those of the positions through the differences; a time is known to a frame.
    """
    balls, diameter = (contact.pair.struck, contact.pair.striker), contact.pair.diameter
    ends = [slide_end(track, contact.end, fps) for track in balls]
    positions, covs = zip(*(_sample(c, contact, end) for c, end in zip(balls, ends, strict=True)), strict=True)
    taus = np.array([np.nan if end is None else (end - contact.end) / fps for end in ends])
    sample, cov = np.stack(positions), np.stack(covs)  # (2, 7, 2), (2, 7, 2, 2)
    steps = np.zeros((2, 7, 2, *sample.shape))  # by ball, frame and column of the covariance's root
    for ball, row in np.argwhere(np.isfinite(sample).all(axis=2)):
        steps[ball, row, :, ball, row] = np.linalg.cholesky(cov[ball, row]).T
    moved = np.concatenate([sample[None], sample + steps.reshape(-1, *sample.shape)])
    value, *others = _read(moved, taus, diameter, fps, contact.pair.target_moves)
    spread = np.nansum((np.array(others) - value) ** 2, axis=0)
    names = "v0 b r s mu_k C v1f v2f energy_fraction momentum_fraction final_angle w1n w1t w2n w2t".split()
    table = {name: (float(v), float(s)) for name, v, s in zip(names, value, np.sqrt(spread), strict=True)}
    time_std_frames = float(np.sqrt(2 / 12))  # of a time between two instants, each known to one frame
    for name, tau in zip(("tau1", "tau2"), taus, strict=True):
        table[name] = (float(tau), time_std_frames / fps if np.isfinite(tau) else np.nan)
    mu, mu_std = table["mu_k"]
    table["mu_k"] = (mu, float(np.hypot(mu_std, mu * time_std_frames / fps / np.mean(taus))))
    instant = balls[0].time[balls[0].frame == contact.frame]
    table["t_c"] = (float(instant[0]) if len(instant) else np.nan, 1 / fps / np.sqrt(12))
    table["drag"], table["decel"] = rolling_loss(balls, contact.start, ends, fps)
    return {n: table[n] if np.isfinite(table[n][0]) else (np.nan, np.nan) for n in QUANTITY_NAMES}


def slide_end(track: BallTrack, contact: int, fps: float) -> int | None:
    """Find the end of a slide as the paper does: the first frame with under 0.3 of the peak acceleration; None if none.

    Only positions after the contact are differenced, or the kick itself would be the peak.
    """
    late = track.where(track.frame > contact)
    whole = np.flatnonzero(np.diff(late.frame, n=1) != 1)
    late = late.where(np.arange(len(late)) <= (whole[0] if len(whole) else len(late)))
    if len(late) < 5:
        return None
    second = np.diff(late.position, n=2, axis=0) * fps**2  # at late.frame[1:-1]
    padded = np.concatenate([second[:1] * np.nan, second, second[:1] * np.nan])
    smooth = np.nanmean(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    size = np.hypot(smooth[:, 0], smooth[:, 1])
    peak = int(np.argmax(size))
    below = np.flatnonzero(size[peak:] < 0.3 * size[peak])
    return int(late.frame[1 + peak + below[0]]) if len(below) else None


def rolling_loss(
    balls: tuple[BallTrack, BallTrack], contact: int, ends: list[int | None], fps: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Measure drag and decel as the paper does: a straight line through acceleration against speed while rolling."""
    stretches = [(track, track.frame > end) for track, end in zip(balls, ends, strict=True) if end is not None]
    stretches.append((balls[1], balls[1].frame < contact))
    speed, loss = [], []
    for track, rows in stretches:
        v = np.diff(track.position[rows], axis=0) * fps / np.diff(track.frame[rows])[:, None]
        size = np.hypot(v[:, 0], v[:, 1])
        speed.append((size[1:] + size[:-1]) / 2)
        loss.append(np.diff(size) * fps)
    x, y = np.concatenate(speed), np.concatenate(loss)
    least_spread = 1e-6  # of the speeds, relative; simulated discs keep theirs but for rounding
    if len(x) < 4 or np.ptp(x) <= least_spread * x.max():
        return (np.nan, np.nan), (np.nan, np.nan)
    columns = np.column_stack([x, np.ones_like(x)])
    inverse = np.linalg.inv(columns.T @ columns)
    slope = inverse @ columns.T @ y
    std = np.sqrt(np.diag(inverse) * ((y - columns @ slope) ** 2).sum() / (len(x) - 2))
    return (float(-slope[0]), float(std[0])), (float(-slope[1]), float(std[1]))


def _sample(track: BallTrack, contact: Contact, end: int | None) -> tuple[Array, Array]:
    """Positions (7, 2) and covariances at the seven frames that are differenced; NaN where there is none."""
    first, last = contact.start, contact.end
    wanted = [first - 3, first - 1, contact.frame, last + 1, last + 3]
    wanted += [-1, -1] if end is None else [end + k for k in (1, 3)]
    position, cov = np.full((7, 2), np.nan), np.full((7, 2, 2), np.nan)
    for i, frame in enumerate(wanted):
        for row in np.flatnonzero(track.frame == frame):
            position[i], cov[i] = track.position[row], track.cov[row]
    return position, cov


def _read(sample: Array, taus: Array, diameter: float, fps: float, moving: bool) -> Array:
    """The quantities (k, 15) from positions (k, 2, 7, 2); moving: true if ball 1 moved before the hit."""
    before, after, final = ((sample[:, :, i] - sample[:, :, j]) * fps / 2 for i, j in ((1, 0), (4, 3), (6, 5)))
    apart = sample[:, 0, 2] - sample[:, 1, 2]
    launch = before[:, 1] - before[:, 0]
    v0 = np.hypot(launch[:, 0], launch[:, 1])
    n, d = apart / np.hypot(apart[:, 0], apart[:, 1])[:, None], launch / v0[:, None]
    t = np.column_stack([-n[:, 1], n[:, 0]])
    carried = (7 * final - 5 * after) / 2  # R w x z just after the impact
    w_n, w_t = -dot(carried, t[:, None]) / (diameter / 2), dot(carried, n[:, None]) / (diameter / 2)
    start = before.sum(axis=1) if moving else launch
    energy = (before**2).sum(axis=(1, 2)) if moving else v0**2
    w_0 = dot(start, n) / (diameter / 2)  # along t, of rolling balls
    friction = np.hypot(*np.moveaxis(final - after, -1, 0)) / (GRAVITY * taus)
    speed, (one, two) = np.hypot(final[..., 0], final[..., 1]), (final[:, 0], final[:, 1])
    parted = after[:, 0] - after[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = dot(parted, t) / -dot(launch, t)
    return np.column_stack([
        v0, cross(n, d), dot(parted, n) / dot(launch, n), s,
        friction.mean(axis=1), (1 - w_t.sum(axis=1) / w_0) / 2, speed, (speed**2).sum(axis=1) / energy,
        dot(one + two, start) / dot(start, start), np.arctan2(np.abs(cross(one, two)), dot(one, two)),
        w_n[:, 0], w_t[:, 0], w_n[:, 1], w_t[:, 1],
    ])  # fmt: skip


def make_motion_table(tracks: Tracks, camera: Camera, row: Mapping[str, Any]) -> pd.DataFrame:
    """Velocity, energy and momentum of each ball frame by frame, per unit mass.

    row: one of `measure`, the collision whose directions of slip count. The columns are t_s; particle; vx, vy (m/s):
    differences between the neighbouring frames; energy (m^2/s^2): v^2/2 less what noise adds to it, which may fall
    below zero at rest; p_along, p_across (m/s): along the ball's own direction of slip after the collision and across
    it (z x that), the paper's x and y; NaN for a ball that took no part in it.
    """
    slips = slip_directions(row)
    balls = [c for c in to_ball_tracks(tracks, camera) if len(c) >= 2] if camera.metric else []
    empty = [np.empty(0, np.int64 if name == "particle" else float) for name in COLUMNS]
    parts = [empty, *(_differentiate_track(track, slips.get(track.particle)) for track in balls)]
    whole = map(np.concatenate, zip(*parts, strict=True))
    return pd.DataFrame(dict(zip(COLUMNS, whole, strict=True)))


def slip_directions(row: Mapping[str, Any]) -> dict[int, Array]:
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


def _differentiate_track(track: BallTrack, slip: Array | None) -> list[NDArray[Any]]:
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
