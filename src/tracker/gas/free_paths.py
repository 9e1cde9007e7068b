"""The paths of balls between their contacts, with velocities that allow for slides and for contacts not found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtr

from synthcam_shared.arrays import Array, Ints
from tracker.gas.hidden_slides import (
    MAX_CHI2_PER_DOF,
    ROWS,
    USUAL_FRICTION,
    PathStarts,
    PlateFriction,
    SlideFits,
    fit_slides,
    measure_friction,
)
from tracker.gas.velocities import HalfVelocities, find_slide_end, fit_velocities
from tracker.measurement.positions import BallTrack

MIN_ROWS_BESIDE_KINK = 6  # of a path that shows a kink of which it has only one or two positions beyond
LEAST_CHANCE = 1e-3  # of a contact on the other side of a frame


class SideOfContact(NamedTuple):
    """A frame of which it is not sure whether a contact comes before or after it.

    change: of the square of the ball's velocity, m^2/s^2, if it is on the other side. chance: of that.
    """

    frame: int
    contact: int
    change: float
    chance: float


@dataclass(frozen=True, eq=False)
class FreePath:
    """One ball between two of its contacts, or between a contact and the start or end of its track."""

    ball: int  # number of the particle
    frame: Ints  # (n,), of its positions
    time: Array  # (n,) s
    start: int  # row of the table of contacts before it; -1 where the track starts, or has a gap
    end: int  # and after it
    start_time: float  # s, of its contacts, or of its first and last position
    end_time: float
    velocities: HalfVelocities  # at the n positions, at its start, and at its end: n + 2 instants
    # (n + 2,) m/s: how far these may be off because the slide after a contact is too short to be seen; 0 elsewhere
    unsure: Array
    usable: bool = True  # whether its velocities show what the contacts before and after it took
    by_friction: Array | None = None  # (n + 2, 2) m/s: their change by one standard error of the friction of the plate
    # (n + 2,) m/s: how much too slow they may be because they are straight lines between contacts; all err this way
    smoothed: Array | None = None
    sides: tuple[SideOfContact, ...] = ()
    free_from: float = -np.inf  # s, from which positions are surely those after the contact before
    rolls_from: float = -np.inf  # s, from which the ball surely rolls, if it is one that rolls
    rolls_until: float = np.inf  # s, up to which positions are surely those before the next contact

    @property
    def unsure_in_all(self) -> Array:
        """How far the velocities (n + 2,) may be off by `unsure` and `smoothed`, for one path alone."""
        return self.unsure if self.smoothed is None else np.asarray(np.hypot(self.unsure, self.smoothed))


@dataclass(frozen=True, eq=False)
class PathCuts:
    """How tracks are cut into free paths, and how velocities are estimated on these."""

    window_rows: int  # of a velocity
    margins_s: Array  # of each contact: positions nearer to it do not count in a velocity
    max_gap_s: float  # a ball that was not seen for longer starts a new path
    noise: float  # of a coordinate, m
    slides: bool  # whether balls slide after a contact, as on a plate


def cut_free_paths(balls: Sequence[BallTrack], contacts: pd.DataFrame, cuts: PathCuts) -> list[FreePath]:
    """Cut tracks at contacts and at missing frames, and estimate the velocities of each part.

    contacts: columns t_s, particle1, particle2, in the order of time.
    """
    paths, free = list[FreePath](), list[tuple[Array, Array]]()
    at = contacts["t_s"].to_numpy(dtype=np.float64)
    for ball in balls:
        own = np.flatnonzero((contacts["particle1"] == ball.particle) | (contacts["particle2"] == ball.particle))
        breaks = at[own]
        part = np.searchsorted(breaks, ball.time)
        gaps = np.flatnonzero(np.diff(ball.time) > cuts.max_gap_s) + 1
        for k in range(len(breaks) + 1):
            inside = np.flatnonzero(part == k)
            for rows in np.split(inside, np.searchsorted(inside, gaps)):
                if not len(rows):
                    continue
                start = int(own[k - 1]) if k > 0 and rows[0] == inside[0] and rows[0] not in gaps else -1
                end = int(own[k]) if k < len(breaks) and rows[-1] == inside[-1] and rows[-1] + 1 not in gaps else -1
                path, positions = _fit_path(ball, rows, (start, end), at, breaks, cuts)
                paths.append(path)
                free.append(positions)
    decel = USUAL_FRICTION
    if cuts.slides and "nx" in contacts:
        paths, decel = _continue_slides(paths, free, contacts, cuts.noise)
    return _limit_rolling(_doubt_sides(paths, contacts), contacts, cuts, decel)


def _limit_rolling(paths: Sequence[FreePath], contacts: pd.DataFrame, cuts: PathCuts, decel: float) -> list[FreePath]:
    """Paths with the instants between which the ball rolls; decel: of a ball that slides, m/s^2.

    A contact adds at most about its kick to what is left of the slip of earlier ones. A ball that comes into view may
    slip as fast as it moves. paths: those of a ball in the order of time.
    """
    margin = 1.3  # surfaces that drag one another make slips larger
    out, slip, last = list[FreePath](), 0.0, None
    for path in paths:
        early, late = (float(cuts.margins_s[k]) if k >= 0 else 0.0 for k in (path.start, path.end))
        if path.start >= 0 and "kick" in contacts and last is not None and last.ball == path.ball:
            left = slip - 7 * decel / 2 * (path.start_time - last.start_time)
            slip = max(left, 0.0) + float(contacts["kick"].iloc[path.start])
        else:
            slip = float(np.hypot(*(path.velocities.even[-1] + path.velocities.odd[-1]) / 2))
        slides = margin * 2 * slip / (7 * decel) if cuts.slides else 0.0
        free_from = path.start_time + early
        last = replace(path, free_from=free_from, rolls_from=free_from + slides, rolls_until=path.end_time - late)
        out.append(last)
    return out


def _fit_path(
    ball: BallTrack, rows: Ints, ends: tuple[int, int], at: Array, breaks: Array, cuts: PathCuts
) -> tuple[FreePath, tuple[Array, Array]]:
    """Estimate the velocities of one path, whose contacts are the rows `ends` of all, which happen `at` these times.

    Returns it, and the times (m,) and positions (m, 2) that count in its velocities.
    """
    time = ball.time[rows]
    first, last = (float(at[k]) if k >= 0 else float(edge) for k, edge in zip(ends, time[[0, -1]], strict=True))
    early, late = (float(cuts.margins_s[k]) if k >= 0 else 0.0 for k in ends)
    near = (time - first < early) | (last - time < late)
    free, position = time[~near], ball.position[rows[~near]]
    slide_end = find_slide_end(free, position, cuts.noise) if cuts.slides and ends[0] >= 0 else np.nan
    velocities = fit_velocities(free, position, np.append(time, [first, last]), cuts.window_rows, slide_end, cuts.noise)
    _widen_at_hidden_kinks(velocities, free, position, np.append(time, [first, last]), cuts, at_start=ends[0] < 0)
    smoothed = None
    unsure, step = np.zeros(len(time) + 2), float(np.diff(ball.time).min(initial=1.0))
    if len(free) < 2 and min(ends) >= 0:
        places = [extrapolate_to_contact(ball, breaks, edge, later) for edge, later in ((first, False), (last, True))]
        (one, _), (other, _) = places
        chord = np.tile((other - one) / (last - first), (len(time) + 2, 1))
        gain = np.full(len(chord), 2 / (last - first) ** 2)
        velocities = HalfVelocities(chord, chord.copy(), gain, gain.copy(), gain.copy())
        short = (early + late + step * (2 - sum(sure for _, sure in places))) / 4  # interpolation cuts the corners
        smoothed = np.full(len(chord), np.hypot(*chord[0]) * min(short / (last - first), 0.5))
    rows_of_slide = 4  # that show its friction
    if cuts.slides and ends[0] >= 0 and not (free < slide_end).sum() >= rows_of_slide:
        velocities.even[-2] = velocities.odd[-2] = np.nan  # the friction between contact and first row is not known
        longest = early + rows_of_slide * step  # slide that would not be seen, s
        rest = longest - (np.append(time, [first, last]) - first)
        unsure = np.hypot(unsure, USUAL_FRICTION * np.maximum(rest, 0) / 2)
    path = FreePath(ball.particle, ball.frame[rows], time, *ends, first, last, velocities, unsure)
    return replace(path, usable=len(free) >= 2 or min(ends) < 0, smoothed=smoothed), (free, position)


def _widen_at_hidden_kinks(
    velocities: HalfVelocities, time: Array, position: Array, at: Array, cuts: PathCuts, *, at_start: bool
) -> None:
    """Widen the errors of velocities beside a kink of which a path shows only one or two positions on one side.

    The kick is at least the distance of the first or last position from the path of the others, over the time between.
    The velocity beyond it may be off by as much. at_start:
    look there too; after a contact the slide bends the path.
    """
    min_sigma, most = 6.0, 2  # positions beyond the kink
    for before in (True, False) if at_start else (False,):
        t, x = (time, position) if before else (-time[::-1], position[::-1])
        for beyond in range(1, most + 1):
            others = slice(beyond, beyond + cuts.window_rows)
            if len(t[others]) < MIN_ROWS_BESIDE_KINK:
                continue
            since = (t[others] - t[0]) / (t[others][-1] - t[0])
            design = since[:, None] ** np.arange(3)
            inverse = np.linalg.inv(design.T @ design)
            away = float(np.hypot(*(x[0] - (inverse @ design.T @ x[others])[0])))
            if away > min_sigma * cuts.noise * np.sqrt(1 + inverse[0, 0]):
                step = t[beyond] - t[0]
                rows = (at if before else -at) < t[beyond] - 0.5 * step / beyond
                own = (away / step / cuts.noise) ** 2
                velocities.gain_even[rows] += own
                velocities.gain_odd[rows] += own
                break


def _doubt_sides(paths: Sequence[FreePath], contacts: pd.DataFrame) -> list[FreePath]:
    """Add the frames of which it is not sure whether a contact comes before or after them.

    The velocity of one ball there may be off by its kick. But two balls exchange that energy, and a wall returns it.
    Where a hidden slide leaves the velocity at the contact unknown, that of the nearest position stands for it.
    """
    if "t_s_std" not in contacts:
        return list(paths)
    std, out = contacts["t_s_std"].to_numpy(dtype=np.float64), list(paths)
    after = {(path.ball, path.end): k for k, path in enumerate(paths) if path.end >= 0}
    for k, path in enumerate(paths):
        if path.start < 0 or (path.ball, path.start) not in after:
            continue
        earlier, contact = after[path.ball, path.start], path.start
        change = _square_beside(out[earlier].velocities, after=False) - _square_beside(path.velocities, after=True)
        for number, row, sign in ((k, 0, 1.0), (earlier, -1, -1.0)):
            own = out[number]
            chance = float(ndtr(-abs(own.time[row] - path.start_time) / max(std[contact], 1e-9)))
            if chance > LEAST_CHANCE and np.isfinite(change):
                side = SideOfContact(int(own.frame[row]), contact, sign * change, chance)
                out[number] = replace(own, sides=(*own.sides, side))
    return out


def _square_beside(velocities: HalfVelocities, *, after: bool) -> float:
    """The square of the known velocity of a path nearest to the contact after which it starts, or at which it ends."""
    mean = (velocities.even + velocities.odd) / 2
    nearest = np.vstack([mean[-2], mean[:-2]] if after else [mean[-1], mean[-3::-1]])
    square = (nearest[np.isfinite(nearest[:, 0])] ** 2).sum(axis=1)
    return float(square[0]) if len(square) else np.nan


def sum_sides(paths: Sequence[FreePath]) -> pd.DataFrame:
    """Sum the changes of the squares of velocities over the balls of a contact: frame, and the variance of the sum."""
    every = [side for path in paths for side in path.sides]
    table = pd.DataFrame(every, columns=list(SideOfContact._fields)).astype(float).astype({"frame": np.int64})
    sums = table.groupby(["frame", "contact"]).agg({"change": "sum", "chance": "max"}).reset_index()
    return pd.DataFrame({"frame": sums["frame"], "variance": sums["chance"] * sums["change"] ** 2})


def _continue_slides(
    paths: Sequence[FreePath], free: Sequence[tuple[Array, Array]], contacts: pd.DataFrame, noise: float
) -> tuple[list[FreePath], float]:
    """Correct the first velocities of paths by the friction that the film shows, if it shows it.

    Also returns the deceleration of slides, m/s^2.

    A path with another kink near its start is fitted without its first rows. If that does not help, it is not usable.
    free: times and positions of each path that count in its velocities.
    """
    skipped = 3  # rows, if another kink is near
    out, friction, fits = list(paths), None, None
    after = {(path.ball, path.end): k for k, path in enumerate(paths) if path.end >= 0}
    rows = [k for k, path in enumerate(paths) if path.start >= 0 and (path.ball, path.start) in after]
    rows = [k for k in rows if len(free[k][0]) >= 2]
    for _ in range(2):  # then with better velocities before the contacts
        numbers, starts = _gather_starts(rows, out, free, contacts, noise, after, fits)
        if starts is not None and friction is None:
            friction = measure_friction(starts, noise)
        if starts is None or friction is None:
            return out, USUAL_FRICTION
        found, later = fit_slides(starts, friction, noise), fit_slides(starts.skip(skipped), friction, noise)
        enough = np.count_nonzero(starts.used, axis=1) >= skipped + 4
        use_later = (found.chi2_per_dof > MAX_CHI2_PER_DOF) & enough & (later.chi2_per_dof < MAX_CHI2_PER_DOF)
        chosen = found.replace_where(use_later, later)
        fits = chosen, {k: n for n, k in enumerate(numbers)}
        for n, k in enumerate(numbers):
            out[k] = _correct_start(paths[k], chosen, n, friction, float(starts.time_std[n]), use_later[n])
    return out, USUAL_FRICTION if friction is None else friction.decel


def _gather_starts(
    rows: Sequence[int],
    paths: Sequence[FreePath],
    free: Sequence[tuple[Array, Array]],
    contacts: pd.DataFrame,
    noise: float,
    after: Mapping[tuple[int, int], int],
    fits: tuple[SlideFits, Mapping[int, int]] | None,
) -> tuple[list[int], PathStarts | None]:
    """The starts of those paths whose ball has a velocity before the contact; and which paths these are.

    after: the path that ends with a contact, by ball and contact. fits: of an earlier turn, with the row of each path.
    """
    balls, normal = contacts[["particle1", "particle2"]].to_numpy(), contacts[["nx", "ny"]].to_numpy(dtype=np.float64)
    std = contacts["t_s_std"].to_numpy(dtype=np.float64) if "t_s_std" in contacts else np.zeros(len(contacts))
    numbers, parts = [], []

    def find_end(ball: int, contact: int) -> tuple[Array, float]:
        path = paths[after[ball, contact]] if (ball, contact) in after else None
        if path is None:
            return np.full(2, np.nan), np.nan
        last = path.velocities.take(slice(-1, None))
        gain = last.gain_even[0] + last.gain_odd[0] + 2 * last.gain_common[0]
        return (last.even[0] + last.odd[0]) / 2, float(np.hypot(noise * np.sqrt(gain) / 2, path.unsure_in_all[-1]))

    for k in rows:
        path, (time, position) = paths[k], free[k]
        before, before_std = find_end(path.ball, path.start)
        if not np.isfinite(before).all():
            continue
        one, two = balls[path.start]
        of_other = before if two < 0 else find_end(int(one + two - path.ball), path.start)[0]
        left, earlier = np.zeros(2), after[path.ball, path.start]
        if fits is not None and earlier in fits[1]:
            left = fits[0].find_left(fits[1][earlier], path.start_time - paths[earlier].start_time)
        n = min(len(time), ROWS)
        since, where = np.zeros(ROWS), np.zeros((ROWS, 2))
        since[:n], where[:n] = time[:n] - path.start_time, position[:n]
        rolled = before + np.nan_to_num(of_other)
        numbers.append(k)
        parts.append(
            (since, where, np.arange(ROWS) < n, std[path.start], before, before_std, left, rolled, normal[path.start])
        )
    return numbers, None if not parts else PathStarts(*(np.array(part) for part in zip(*parts, strict=True)))


def _correct_start(
    path: FreePath, fits: SlideFits, row: int, friction: PlateFriction, time_std: float, late: bool
) -> FreePath:
    """A path with the velocities of its slide: at its start, and in the rows that a slide too short to be seen moves.

    late: whether the first rows do not count, because another kink is near.
    """
    hidden, chi2 = not np.isfinite(path.velocities.even[-2, 0]), float(fits.chi2_per_dof[row])
    if not hidden and not chi2 < MAX_CHI2_PER_DOF:
        return path
    since = np.append(path.time, [path.start_time, path.end_time]) - path.start_time
    slid = np.minimum(since, fits.duration[row])
    wrong = min(max(float(fits.slip_std[row]), 0.5 if late else 0.0), 1.0)  # relative, of the slip
    lever = slid - fits.slid[row]  # s, of a wrong friction
    unsure = friction.decel * np.hypot(lever * wrong, time_std)
    along = fits.slip[row] / max(float(np.hypot(*fits.slip[row])), 1e-12)
    by_friction = -friction.decel * friction.decel_std * lever[:, None] * along
    wider = 1.0 if chi2 < MAX_CHI2_PER_DOF else chi2  # a kink was missed
    replaced = np.zeros(len(since), dtype=bool)
    if hidden:
        replaced = (since <= fits.until[row]) | (len(path.time) <= ROWS)
    replaced[-2] = True
    halves = {one.name: getattr(path.velocities, one.name).copy() for one in fields(HalfVelocities)}
    halves["even"][replaced] = halves["odd"][replaced] = fits.find_velocities(row, since)[replaced]
    for name, factor in (("gain_even", wider), ("gain_odd", wider), ("gain_common", 1.0)):
        halves[name][replaced] = factor * fits.gain[row]
    return replace(
        path,
        velocities=HalfVelocities(**halves),
        unsure=np.where(replaced, unsure, 0.0),
        by_friction=np.where(replaced[:, None], by_friction, 0.0),
        usable=path.usable and (chi2 < MAX_CHI2_PER_DOF or len(path.time) > ROWS * 3 // 2),
    )


def extrapolate_to_contact(ball: BallTrack, breaks: Array, at: float, later: bool) -> tuple[Array, bool]:
    """Find a ball's position at one of its contacts, by its path beyond it, and whether two positions show that path.

    breaks: times of all its contacts, s. later: whether that path comes after the contact.
    """
    beyond = breaks[breaks > at].min(initial=np.inf) if later else breaks[breaks < at].max(initial=-np.inf)
    inside = np.flatnonzero((ball.time > min(at, beyond)) & (ball.time < max(at, beyond)))
    rows = inside[:2] if later else inside[-2:]
    if len(rows) < 2:
        return np.array([np.interp(at, ball.time, axis) for axis in ball.position.T]), False
    (one, other), (start, end) = ball.position[rows], ball.time[rows]
    return one + (other - one) * (at - start) / (end - start), True
