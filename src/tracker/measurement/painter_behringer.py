"""The paper's own measurement of a collision: finite differences at the frame of least separation.

It is kept because it shows the bias of the method. Within .01 s of the contact sliding has already slowed one ball
and sped up the other. The restitution is therefore too low, and the lower the slower the frame rate.

Source: Painter & Behringer 2000, sections III B and IV, with the frames that the data format fixes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracker.camera.camera import Camera
from tracker.measurement.camera_errors import camera_errors
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.collision.contacts import Contact
from tracker.measurement.collision.derived import QUANTITY_NAMES, cross, dot
from tracker.measurement.collision.lasting_contact import LastingContact
from tracker.measurement.positions import BallTrack

Floats = NDArray[np.float64]


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
        fps = camera.fps
        pairs = ((sign, error.pair(contact.pair, sign, fps)) for sign in (1, -1))
        high, low = (read_differences(replace(contact, pair=p), error.rate(fps, sign)) for sign, p in pairs)
        for name in table:
            square[name] += ((high[name][0] - low[name][0]) / 2) ** 2
    square["r"] += find_bias_of_restitution(table, friction, camera.fps) ** 2
    out = {}
    for name, (value, _) in table.items():
        known = lasting is None or name == "v0"
        out[f"{name}_paper"], out[f"{name}_paper_std"] = (
            (value, float(np.sqrt(square[name]))) if known else (np.nan,) * 2
        )
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
    names = (
        *("v0", "b", "r", "s", "mu_k", "C", "v1f", "v2f", "energy_fraction", "momentum_fraction", "final_angle"),
        *("w1n", "w1t", "w2n", "w2t"),
    )
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
    if len(x) < 4 or np.ptp(x) == 0:
        return (np.nan, np.nan), (np.nan, np.nan)
    columns = np.column_stack([x, np.ones_like(x)])
    inverse = np.linalg.inv(columns.T @ columns)
    slope = inverse @ columns.T @ y
    std = np.sqrt(np.diag(inverse) * ((y - columns @ slope) ** 2).sum() / (len(x) - 2))
    return (float(-slope[0]), float(std[0])), (float(-slope[1]), float(std[1]))


def _sample(track: BallTrack, contact: Contact, end: int | None) -> tuple[Floats, Floats]:
    """Positions (7, 2) and covariances at the seven frames that are differenced; NaN where there is none."""
    first, last = contact.start, contact.end
    wanted = [first - 3, first - 1, contact.frame, last + 1, last + 3]
    wanted += [-1, -1] if end is None else [end + k for k in (1, 3)]
    position, cov = np.full((7, 2), np.nan), np.full((7, 2, 2), np.nan)
    for i, frame in enumerate(wanted):
        for row in np.flatnonzero(track.frame == frame):
            position[i], cov[i] = track.position[row], track.cov[row]
    return position, cov


def _read(sample: Floats, taus: Floats, diameter: float, fps: float, moving: bool) -> Floats:
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
