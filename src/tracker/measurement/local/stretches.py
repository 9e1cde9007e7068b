"""The stretches of a local estimate: the positions up to a contact or from it on, and the path that describes each.

A path is a sum of a few functions of the time s since the contact. With G = s^2/2 until the time tau from the contact
and straight from there on, and H = s^2/2 - G:

- after the contact, a body slides for tau with the constant acceleration a and then rolls:
  x + v s + a G - loss v^ H;
- before it, the body slid until tau before the contact and rolled since: x + v s + a H - loss v^ G.

Without tau the acceleration lasts for the whole stretch. Pucks on air move so, and balls that slide all along. On a dry
plate a body slides until it stops, and then rests.

Far from the contact, positions are means of several frames. The mean of a curve lies inside it, by a sixth of the
acceleration times the square of half the mean's time. So a path is averaged over the same time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.measurement.noise.whitening import PositionWhitener
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import CUTTER, measure_largest_noise, measure_path_noise

MAX_POSITIONS = 45  # of a stretch; more are averaged in groups
NEAR_ERRORS = 4.0  # factor on the errors of positions beside the contact
KEPT_POSITIONS = 25  # of these, next to the contact, which are not averaged


@dataclass(frozen=True, eq=False)
class Stretch:
    """The positions of one body on one side of a contact."""

    ball: int  # 1: struck, 2: striker
    after: bool
    time: Array  # (n,) s
    position: Array  # (n, 2) m
    cov: Array  # (n, 2, 2) m^2; positions beside the contact have NEAR_ERRORS times their errors
    fixed: Array  # (n, 2, 2) the part of it that lasts, as of a `BallTrack`
    near: Flags  # (n,) whether beside the contact, where trackers and bodies are less regular
    count: Ints  # (n,) frames of which each position is the mean
    width: float = 0.0  # as of a `BallTrack`, and so are `drifts`
    drifts: tuple[tuple[float, float], ...] = ()
    reach: Array | None = None  # (n,) s, of each mean to either side, as of an even density; none: single frames

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def std(self) -> Array:
        """Root mean square error (n,) of both coordinates, m."""
        return np.asarray(np.sqrt(np.trace(self.cov, axis1=1, axis2=2) / 2))

    @cached_property
    def whiten(self) -> PositionWhitener:
        """By the full covariance of the positions."""
        return PositionWhitener(self.position, self.cov, self.fixed, self.width, drifts=self.drifts)

    @cached_property
    def far(self) -> Stretch:
        """The same stretch, without the positions beside the contact."""
        return self.where(~self.near)

    @cached_property
    def as_one(self) -> Stretch:
        """The same positions of a body at rest, whose errors are all the same."""
        return replace(self, cov=len(self) * self.cov, fixed=len(self) * self.fixed)

    def where(self, rows: Flags) -> Stretch:
        """The same stretch, only those rows."""
        names = ("time", "position", "cov", "fixed", "near", "count", *(() if self.reach is None else ("reach",)))
        return self if rows.all() else replace(self, **{name: getattr(self, name)[rows] for name in names})


class MotionKind(NamedTuple):
    """Terms of a path beside its position at the contact."""

    moves: bool = True
    pushed: bool = True  # by an acceleration of its own: friction of a slide, or drag
    ends: bool = True  # whether the push ends, or began, at a time tau from the contact
    rolls: bool = True  # with a loss while it is not pushed
    stops: bool = False  # the push is dry friction: it slows the body, and the body rests after it

    @property
    def size(self) -> int:
        """Number of parameters: x, y; vx, vy; ax, ay; log tau; loss."""
        return 2 + 2 * self.moves + 2 * self.pushed + self.ends + self.rolls


REST = MotionKind(False, False, False, False)
ROLL = MotionKind(True, False, False, True)
SLIDE = MotionKind(True, True, False, False)
SLIDE_AND_ROLL = MotionKind(True, True, True, True)
SLIDE_AND_STOP = MotionKind(True, True, False, False, True)


def cut_stretch(
    track: BallTrack,
    ball: int,
    after: bool,
    window_s: float,
    contact: tuple[float, float],
    frame_s: float,
    *,
    stops: bool = False,
) -> Stretch:
    """Cut the positions of a body up to `window_s` from a contact, without the exposures that hold it.

    contact: its first and last instant, s. A body that moves is followed to the next contact only. More positions than
    MAX_POSITIONS are averaged in groups of neighbours. stops: the motion may end at rest. Then all positions at rest
    count as one, because they may have the same error, as in a film with loss. Otherwise they are left out.
    """
    rows, near = find_rows(track, after, window_s, contact, frame_s)
    rows, rest = _keep_free_motion(track, rows, near[rows], after, frame_s, stops)
    near = near[rows]
    size = np.where(near, NEAR_ERRORS, 1.0)[:, None, None] ** 2
    whole = Stretch(
        ball=ball,
        after=after,
        time=track.time[rows],
        position=track.position[rows],
        cov=size * track.cov[rows],
        fixed=size * track.fixed[rows],
        near=near,
        count=np.ones(len(rows), dtype=np.int64),
        width=track.width,
        drifts=track.drifts,
    )
    order = np.arange(len(rows)) if after else np.arange(len(rows))[::-1]
    step = -(-(len(rows) - KEPT_POSITIONS) // (MAX_POSITIONS - KEPT_POSITIONS))
    if step > 1:
        group = np.where(order < KEPT_POSITIONS, order, KEPT_POSITIONS + (order - KEPT_POSITIONS) // step)
        whole = _average(whole, group if after else group.max() - group)
    return whole if len(rest) == 0 else _append_rest(whole, track, rest)


def _append_rest(whole: Stretch, track: BallTrack, rest: Ints) -> Stretch:
    """Append the mean of the positions at rest, with the error of one of them."""
    return replace(
        whole,
        time=np.append(whole.time, track.time[rest[0]]),
        position=np.vstack([whole.position, track.position[rest].mean(axis=0)]),
        cov=np.concatenate([whole.cov, track.cov[rest].mean(axis=0, keepdims=True)]),
        fixed=np.concatenate([whole.fixed, track.fixed[rest].mean(axis=0, keepdims=True)]),
        near=np.append(whole.near, False),
        count=np.append(whole.count, 1),
        reach=None if whole.reach is None else np.append(whole.reach, 0.0),
    )


def find_rows(
    track: BallTrack, after: bool, window_s: float, contact: tuple[float, float], frame_s: float
) -> tuple[Ints, Flags]:
    """Find the rows from which `cut_stretch` cuts a stretch, and of each row of the track whether it is near."""
    (first, last), half = contact, track.exposure / 2
    mine = (track.time - half > last) if after else (track.time + half < first)
    rows = np.flatnonzero(mine & (track.time >= first - window_s) & (track.time <= last + window_s))
    return rows, CUTTER.is_beside(track.time, first, last, frame_s)


def _average(whole: Stretch, group: Ints) -> Stretch:
    """Average the positions of each group (n,) of neighbours; `fixed` errors average only while a body moves on."""
    count = np.bincount(group)

    def mean(values: Array) -> Array:
        sums = [np.bincount(group, column) for column in values.reshape(len(group), -1).T]
        return np.asarray((np.stack(sums, axis=-1) / count[:, None]).reshape(len(count), *values.shape[1:]))

    position, time = mean(whole.position), mean(whole.time)
    reach = np.sqrt(3 * mean((whole.time - time[group]) ** 2))
    lasting = sum(size**2 for size, _ in whole.drifts) * np.eye(2)  # a drift lasts over a longer way than a group
    shares = 1 / count
    if whole.fixed.any() and whole.width > 0:
        first = np.searchsorted(group, np.arange(len(count)))
        parts = (whole.position[k : k + n] for k, n in zip(first, count, strict=True))
        apart = (((part[:, None] - part[None]) ** 2).sum(axis=-1) for part in parts)
        # of the variance of an error that a pixel pattern makes, in the mean of neighbouring positions
        shares = np.array([np.exp(-square / (4 * whole.width**2)).mean() for square in apart])
    fixed = (mean(whole.fixed) - lasting) * shares[:, None, None] + lasting
    own = mean(whole.cov - whole.fixed) / count[:, None, None]
    near = mean(whole.near.astype(np.float64)) > 0.5
    cov = own + fixed
    return replace(whole, time=time, position=position, cov=cov, fixed=fixed, near=near, count=count, reach=reach)


def _keep_free_motion(
    track: BallTrack, rows: Ints, near: Flags, after: bool, frame_s: float, stops: bool
) -> tuple[Ints, Ints]:
    """The rows up to the next contact or to the stop of a body, or back to the contact before; those at rest apart.

    stops: whether the rows at rest are needed.
    """
    free, none = rows[~near], rows[:0]
    if len(free) < 2:
        return rows, none
    time, position = track.time[free], track.position[free]
    noise = measure_path_noise([(track.frame, track.position)])
    long = 12  # positions, among which a kink hardly changes the noise
    if len(free) >= long:  # codecs hardly move a body that rests
        noise = np.fmax(noise, measure_path_noise([(track.frame[free], track.position[free])]))
    if not np.isfinite(noise):
        return rows, none
    if not CUTTER.moves(time, position, noise):
        return _split_at_rest(track, rows, near) if stops and after else (rows, none)
    kinks = CUTTER.find_kinks(time, CUTTER.measure_kinks(time, position, noise))
    parts = list(CUTTER.cut(time, track.frame[free], kinks, frame_s))
    if parts:
        ends = int(free[parts[0][-1] if after else parts[-1][0]])
        rows = rows[rows <= ends] if after else rows[rows >= ends]
    if not after:
        return rows, none
    if stops:
        return _split_at_rest(track, rows, near[: len(rows)])
    return _end_at_stop(track, rows, noise), none


def _split_at_rest(track: BallTrack, rows: Ints, near: Flags) -> tuple[Ints, Ints]:
    """The rows of a body that slides on a dry plate until it rests, and those at rest.

    The last positions are within `same` errors of the middle of the last third. The errors are those while the body
    moves: the largest of any part of the track. Friction of `least_friction` stops a body on so short a way within a
    time that follows. The body rests from then on, if its track goes on for as long again. Positions count one by one
    as long as it moves by `usual_friction`.
    """
    same, least_friction, usual_friction, least_rows = 4.0, 0.05, 0.2, 3
    time, position = track.time[rows], track.position[rows]
    limit = same * measure_largest_noise(track.frame, track.position)
    off = np.hypot(*(position - np.median(position[-(len(rows) // 3) :], axis=0)).T)
    moving = np.flatnonzero(off > limit)
    last = max(int(moving[-1]) if len(moving) else 0, int(near.sum()) + least_rows - 1)
    latest, usual = (np.sqrt(2 * limit / (friction * 9.81)) for friction in (least_friction, usual_friction))
    if last >= len(rows) or time[-1] - time[last] < 2 * latest:
        return rows, rows[:0]
    return rows[time <= time[last] + usual], rows[time > time[last] + latest]


def _end_at_stop(track: BallTrack, rows: Ints, noise: float) -> Ints:
    """The rows up to the stop of a body: no motion of a stretch ends so.

    Its last positions are the same if they differ by `same` errors or by `same_share` of the way at most from the
    middle of the last third: errors of a body that moves may be much larger than those of one that rests. It has
    stopped if it would have moved on by `far` times that at its mean speed.
    """
    same, same_share, far = 4.0, 0.2, 5.0
    time, position = track.time[rows], track.position[rows]
    way = np.hypot(*(position - np.median(position[-(len(rows) // 3) :], axis=0)).T)
    limit = max(same * noise, same_share * float(way[0]))
    moving = np.flatnonzero(way > limit)
    if len(moving) < 2:
        return rows
    last = int(moving[-1])
    speed = float(way[0] - way[last]) / float(time[last] - time[0])
    return rows[: last + 1] if speed * float(time[-1] - time[last]) > far * limit else rows


class Overrun(NamedTuple):
    """Means of the time by which positions are past an instant, zero before it."""

    share: Array  # of the mean past the instant
    late: Array  # s
    late_curve: Array  # s^2, half the square

    @staticmethod
    def of(past: Array, reach: Array | None) -> Overrun:
        """Average times past an instant, negative before it, evenly over `reach` to either side; none: single times."""
        if reach is None:
            late = np.maximum(past, 0.0)
            return Overrun((past > 0).astype(np.float64), late, late**2 / 2)
        reach = np.maximum(reach, 1e-12)
        part = np.clip(past, -reach, reach) + reach  # of the mean past the instant, s
        whole = np.maximum(past - reach, 0.0)
        share = part / (2 * reach)
        return Overrun(share, whole + part * share / 2, whole * (past + reach) / 2 + part**2 * share / 6)

    @staticmethod
    def average_cube(past: Array, reach: Array | None) -> Array:
        """Average a sixth of the cube of such times, s^3."""
        if reach is None:
            return np.maximum(past, 0.0) ** 3 / 6
        reach = np.maximum(reach, 1e-12)
        last, first = np.maximum(past + reach, 0.0), np.maximum(past - reach, 0.0)
        return np.asarray((last - first) * (last + first) * (last**2 + first**2) / (48 * reach))


def average_curve(since: Array, reach: Array | None) -> Array:
    """Average half the square of times evenly over `reach` to either side."""
    return np.asarray(since**2 / 2 if reach is None else (since**2 + reach**2 / 3) / 2)


def average_cube_of_roll(motion: MotionKind, after: bool, ahead: Array, tau: Array, reach: Array | None) -> Array:
    """Average a sixth of the cube of the time for which a body rolls, evenly over `reach` to either side.

    ahead: time to the contact, s, positive. tau: duration of the slide after the contact or of the roll before it, s.
    The body moves on at its last speed before or after the roll.
    """
    if motion.ends and after:
        return Overrun.average_cube(ahead - tau, reach)
    whole = np.asarray(ahead * (ahead**2 if reach is None else ahead**2 + reach**2) / 6)
    if not motion.ends:
        return whole
    return whole - Overrun.average_cube(ahead - tau, reach) - tau * Overrun.of(ahead - tau, reach).late_curve


def evaluate_path(
    motion: MotionKind,
    values: Array,
    since: Array,
    after: bool,
    reach: Array | None = None,
    fall: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Evaluate the paths of a stretch at times (..., n) since the contact, for values (..., size) of its parameters.

    reach (..., n): means over so much time to either side, as of a `Stretch`.
    fall (..., 1): how fast the loss of a roll falls with time, over the loss, 1/s. The loss is that at the contact, or
    at the end of the slide after it. To first order, dv/dt = -(D + C v) has this motion with a fall of C.
    Returns positions (..., n, 2) and derivatives (..., size + 1 + motion.rolls, n, 2): by the parameters, by the
    instant of the contact and, if the body rolls, by the fall.
    """
    values = values[..., None]  # to be multiplied by times
    path = np.empty((*np.broadcast_shapes(values.shape[:-2], since.shape[:-1]), since.shape[-1], 2))
    path[..., 0], path[..., 1] = values[..., 0, :], values[..., 1, :]
    slope = np.zeros((*values.shape[:-2], motion.size + 1 + motion.rolls, since.shape[-1], 2))
    slope[..., 0, :, 0] = slope[..., 1, :, 1] = 1.0
    if not motion.moves:
        return path, slope
    if motion.stops and after:
        return _evaluate_stop(values, since, reach, path, slope)
    v, k_instant, sign = values[..., None, 2:4, 0], motion.size, 1.0 if after else -1.0
    slope[..., 2, :, 0] = slope[..., 3, :, 1] = since
    slope[..., k_instant, :, :] = -v
    path += since[..., None] * v
    ahead = np.abs(since)
    late, curve = 0 * ahead, average_curve(ahead, reach)
    free = curve
    tau = 0.0 * values[..., 0, :]
    if motion.pushed:
        a = values[..., None, 4:6, 0]
        if motion.ends:
            tau = np.exp(values[..., 6, :])
            _, late, far = Overrun.of(ahead - tau, reach)
        else:
            far = late
        curve, free = (curve - far, far) if after or not motion.ends else (far, curve - far)
        path += curve[..., None] * a
        slope[..., 4, :, 0] = slope[..., 5, :, 1] = curve
        rate = ahead - late if after or not motion.ends else late
        slope[..., k_instant, :, :] -= (sign * rate)[..., None] * a
    if motion.rolls:
        _add_roll(_RollTimes(motion, after, ahead, reach, tau, late, free), values, fall, path, slope)
    return path, slope


class _RollTimes(NamedTuple):
    """When a body rolls, as `evaluate_path` finds it."""

    motion: MotionKind
    after: bool  # the contact
    ahead: Array  # s, time to the contact, positive
    reach: Array | None
    tau: Array  # s, duration of the slide after the contact, or of the roll before it
    late: Array  # s, by which `ahead` exceeds it
    free: Array  # s^2, half the square of the time of the roll


def _add_roll(times: _RollTimes, values: Array, fall: Array | float, path: Array, slope: Array) -> None:
    """Add the loss of a roll to a path and its derivatives, and the derivative of the end of its slide.

    values (..., size, 1): parameters of the stretch. path, slope: what `evaluate_path` returns, with all but the loss.
    """
    motion, after, ahead, reach, tau, late, free = times
    v, a = values[..., None, 2:4, 0], values[..., None, 4:6, 0] if motion.pushed else np.zeros(2)
    at, k_tau, k_instant, sign = motion.size - 1, 6, motion.size, 1.0 if after else -1.0
    carries = motion.ends and after  # the push, which turns the direction in which the body rolls
    along = v + a * tau[..., None] if carries else v
    speed_along = np.maximum(np.hypot(along[..., :1], along[..., 1:]), 1e-12)
    along = along / speed_along
    loss = values[..., at, :]
    kept = late if carries else ahead - late  # time of the roll
    cube, kept_curve, late_of_loss = average_cube_of_roll(motion, after, ahead, tau, reach), free, late
    if carries:
        late_of_loss = late - fall * free
    elif motion.ends:
        kept_curve, late_of_loss = free - tau * late, late * (1 + fall * tau)
    free, kept = free - sign * fall * cube, kept - sign * fall * kept_curve
    slope[..., at, :, :] = -free[..., None] * along
    path += loss[..., None] * slope[..., at, :, :]
    slope[..., k_instant + 1, :, :] = (sign * loss * cube)[..., None] * along
    turn = (np.eye(2) - along[..., 0, :, None] * along) / speed_along
    turns = (loss * free)[..., None, :, None] * turn[..., :, None, :]
    slope[..., 2:4, :, :] -= turns
    if carries:
        slope[..., 4:6, :, :] -= tau[..., None, None] * turns
        slope[..., k_tau, :, :] -= (loss * tau * free)[..., None] * (a @ turn)
    slope[..., k_instant, :, :] += (sign * loss * kept)[..., None] * along
    if motion.ends:
        late_push, late_loss = (sign * tau * late)[..., None], (sign * tau * loss * late_of_loss)[..., None]
        slope[..., k_tau, :, :] += late_push * a + late_loss * along


def _evaluate_stop(values: Array, since: Array, reach: Array | None, path: Array, slope: Array) -> tuple[Array, Array]:
    """Evaluate the path of a body that slides until its speed is least, and rests from then on.

    values (..., 6, 1), and the arrays that `evaluate_path` returns, to which the motion is added.
    """
    v, a = values[..., None, 2:4, 0], values[..., None, 4:6, 0]
    speed_2, slows = (v * v).sum(axis=-1), np.minimum((a * v).sum(axis=-1), -1e-12)
    lasts = -speed_2 / slows
    rests, late, late_curve = Overrun.of(since - lasts, reach)
    s, curve = since - late, average_curve(since, reach) - lasts * late - late_curve
    path += s[..., None] * v + curve[..., None] * a
    end = rests[..., None] * (v + lasts[..., None] * a)  # the velocity at which it stops: that across its first one
    by_v = (-2 * v * slows[..., None] + speed_2[..., None] * a) / slows[..., None] ** 2
    by_a = speed_2[..., None] * v / slows[..., None] ** 2
    for axis in (0, 1):
        slope[..., 2 + axis, :, axis], slope[..., 4 + axis, :, axis] = s, curve
        slope[..., 2 + axis, :, :] += by_v[..., axis, None] * end
        slope[..., 4 + axis, :, :] += by_a[..., axis, None] * end
    slope[..., -1, :, :] = -(1 - rests)[..., None] * v - (s - lasts * rests)[..., None] * a
    return path, slope
