"""Assigns the detections of a frame to the balls that are predicted there, as one problem of greatest likelihood."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from synthcam_shared.arrays import Array, Ints
from tracker.detection.following.motion_filter import (
    MAX_BALLS_FOR_ALL_PAIRS,
    MAX_SIGMA_OF_OWN,
    MotionNoise,
    PredictedBalls,
    PredictedHits,
    find_near_balls,
    predict_hits,
)

Coming: TypeAlias = tuple[Array, int]  # the positions of the next frame, and how many frames later that is


@dataclass(frozen=True, eq=False)
class _Step:
    """The balls of one frame, and the detections of a later one."""

    before: PredictedBalls
    free: PredictedBalls  # the same in the later frame, if nothing hits them
    found: Array  # (m, 2): positions in the later frame
    frames: int  # from one to the other
    frame: int  # the later one
    noise: MotionNoise

    @property
    def unhit_frames(self) -> Ints:
        """How many frames ago each ball (n,) was surely on its way."""
        return self.frame - self.before.seen if self.noise.hidden_hits else np.full(len(self.before), self.frames)

    @property
    def unhit_xy(self) -> Array:
        """Where each ball (n, 2) then was."""
        return self.before.last if self.noise.hidden_hits else self.before.xy


@dataclass(frozen=True, eq=False)
class LinkedFrame:
    """The balls of a frame, and the detections that are theirs."""

    balls: PredictedBalls  # one that is not found is where it was predicted
    track: Ints  # (m,) number of each detection, or -1
    doubts: Ints  # (d, 2) numbers of balls that may have exchanged their tracks in this frame


_NO_DOUBTS = np.empty((0, 2), dtype=np.int64)


def link_frame(
    before: PredictedBalls, found: Array, frames: int, frame: int, coming: Coming | None, noise: MotionNoise
) -> LinkedFrame:
    """Assign the detections of a frame to balls.

    before: the balls some `frames` earlier. found: positions (m, 2).
    """
    own = np.full(len(found), -1, dtype=np.int64)
    if not len(before):
        return LinkedFrame(before, own, _NO_DOUBTS)
    step = _Step(before, before.advance(frames, noise), found, frames, frame, noise)
    pairs = find_near_balls(before, frames, noise)
    if not len(pairs[0]) and (plain := _match_plainly(step)) is not None:
        own[plain] = before.number
        links = np.arange(len(before)), plain, np.full(len(before), -1)
        return LinkedFrame(_update(step, None, links, frame), own, _NO_DOUBTS)
    hits = predict_hits(before, step.free, pairs, frames, noise)
    near = _find_near(step)
    gain, kind = _weigh(step, hits, near)
    if coming is not None:
        _confirm(step, near, gain, *coming)
    ball, column = _uncross(step, near, gain, *_assign(gain, near, len(found)))
    seen = near[ball, column]
    own[seen] = before.number[ball]
    doubts = before.number[_find_doubts(step, near, gain, ball, column)]
    return LinkedFrame(_update(step, hits, (ball, seen, kind[ball, column]), frame), own, doubts)


def _match_plainly(step: _Step) -> Ints | None:
    """The detection (n,) of each ball where every ball and every detection has its own; None otherwise."""
    free, found = step.free, step.found
    if len(free) != len(found) or len(free) > MAX_BALLS_FOR_ALL_PAIRS or (free.count < 2).any():
        return None
    off = ((free.xy[:, None] - found) ** 2).sum(axis=2)
    nearest = off.argmin(axis=1)
    close = off[np.arange(len(free)), nearest] < MAX_SIGMA_OF_OWN**2 * (free.cov[:, 0] + step.noise.position**2)
    return nearest if close.all() and len(set(nearest.tolist())) == len(free) else None


def _find_near(step: _Step) -> Ints:
    """The detections (n, k) nearest to each ball, by number; m for none."""
    free, found, most = step.free, step.found, 8
    if len(found) <= most:
        return np.tile(np.arange(len(found)), (len(free), 1))
    fastest = float(np.hypot(*free.v.T).max())
    limit = max(step.noise.reach * step.frames, (0.6 * step.noise.diameter + 2.2 * fastest) * step.frames)  # px
    return np.asarray(cKDTree(found).query(free.xy, k=most, distance_upper_bound=limit)[1])


def _weigh(step: _Step, hits: PredictedHits, near: Ints) -> tuple[Array, Ints]:
    """The log likelihood (n, k) of each detection as that of a ball over that of a false one, and how the ball came.

    How: -1 freely, -2 after a hit by something unseen, or the number of one of `hits`.
    """
    before, free, frames, noise = step.before, step.free, step.frames, step.noise
    there = np.append(step.found, [[np.inf, np.inf]], axis=0)[near]  # (n, k, 2)
    old = before.count > 1
    meets = np.ones(len(before))
    np.multiply.at(meets, hits.ball, 1 - hits.chance)
    alone = np.log(np.maximum(meets, noise.least_free))
    off = ((there - free.xy[:, None]) ** 2).sum(axis=2)
    variance = free.cov[:, 0] + noise.position**2
    variance[~old] = np.minimum(variance[~old], 1 / (2 * np.pi * noise.false_density))  # it is seen in the picture
    best = alone[:, None] + _log_density(off, variance)
    if noise.usual_share > 0:
        usual = _log_density(off[~old], np.full((~old).sum(), (noise.usual_step * frames) ** 2 + noise.position**2))
        best[~old] = np.logaddexp(best[~old], np.log(noise.usual_share) + usual)  # faster ones keep their chance
    best[~old] = np.where(off[~old] < (noise.reach * frames) ** 2, best[~old] + noise.log_new, -np.inf)
    total, kind = best, np.full(near.shape, -1)
    unhit_for = step.unhit_frames
    speed = (np.hypot(*before.v.T) + (np.sqrt(before.cov[:, 2]) if noise.hidden_hits else 0.0)) * unhit_for
    lost = 0.6 * noise.diameter * unhit_for + noise.tolerance * speed
    way = ((there - step.unhit_xy[:, None]) ** 2).sum(axis=2)
    around = (off < lost[:, None] ** 2) | (way < (0.3 * noise.diameter * unhit_for + speed)[:, None] ** 2)
    level = np.log(noise.unseen_hits * unhit_for / (np.pi * np.maximum(lost, speed) ** 2))
    unseen = np.where(around & old[:, None], level[:, None], -np.inf)
    kind[unseen > total] = -2
    total, best = np.logaddexp(total, unseen), np.maximum(best, unseen)
    for h in np.flatnonzero(hits.chance > 1e-9):
        i = hits.ball[h]
        own = ((there[i] - hits.xy[h]) ** 2).sum(axis=1)
        more = np.log(hits.chance[h]) + _log_density(own, hits.cov[h, 0] + noise.position**2)
        kind[i, more > best[i]] = h
        total[i], best[i] = np.logaddexp(total[i], more), np.maximum(best[i], more)
    return total + noise.log_seen - np.log(noise.false_density), kind


def _log_density(square: Array, variance: Array | float) -> Array:
    """The log density of a normal distribution in a plane, at these squared distances (n, k); variance: (n,)."""
    var = np.asarray(variance)[..., None]
    return np.asarray(-np.log(2 * np.pi * var) - square / (2 * var))


def _confirm(step: _Step, near: Ints, gain: Array, following: Array, later: int) -> None:
    """Lower the gain of a first step that none of the detections continues which follow some frames later.

    After a longer step more room is searched, in which a detection of another ball may lie by chance. It confirms less.
    """
    unconfirmed = 0.05  # probability that the next frame does not show a ball where its motion leads
    i, k = np.nonzero((step.before.count == 1)[:, None] & (gain > 0))
    if not len(i):
        return
    there = step.found[near[i, k]]
    speed = (there - step.before.xy[i]) / step.frames
    fall = np.array(step.noise.fall) * (later * (step.frames + later) / 2)
    apart = cKDTree(following).query(there + speed * later + fall)[0] if len(following) else np.full(len(i), np.inf)
    least = 3 * step.noise.position + step.noise.acceleration * (later * (step.frames + later) / 2)
    wide = least + step.noise.bend * np.hypot(*speed.T)
    gain[i, k] += np.log(unconfirmed + (least / wide) ** 2 * np.exp(-((apart / wide) ** 2) / 2))


def _assign(gain: Array, near: Ints, found: int) -> tuple[Ints, Ints]:
    """Pairs of ball and column of `near` with the greatest sum of gains, none of which is negative."""
    ball, column = np.nonzero(gain > 0)
    seen = near[ball, column]
    single = (np.bincount(ball, minlength=len(gain))[ball] == 1) & (np.bincount(seen, minlength=found + 1)[seen] == 1)
    out = [np.column_stack([ball[single], column[single]])]
    ball, column, seen = ball[~single], column[~single], seen[~single]
    if len(ball):
        size = len(gain) + found
        graph = coo_array((np.ones(len(ball)), (ball, len(gain) + seen)), shape=(size, size))
        part = connected_components(graph, directed=False)[1][ball]
        for number in np.unique(part):
            own = part == number
            rows, i = np.unique(ball[own], return_inverse=True)
            columns, j = np.unique(seen[own], return_inverse=True)
            table = np.zeros((len(rows), len(columns)))
            table[i, j] = gain[ball[own], column[own]]
            at = np.full(table.shape, -1)
            at[i, j] = column[own]
            i, j = linear_sum_assignment(table, maximize=True)
            good = table[i, j] > 0
            out.append(np.column_stack([rows[i[good]], at[i[good], j[good]]]))
    pairs = np.concatenate(out)
    return pairs[:, 0], pairs[:, 1]


def _find_doubts(step: _Step, near: Ints, gain: Array, ball: Ints, column: Ints) -> Ints:
    """Pairs (d, 2) of balls whose links, exchanged, would be nearly as likely.

    The first of a pair has a detection that the second, with one of its own or without, may have left in its place.
    Balls that were seen once before have no past to confuse. Links are balls, and their columns of `near`.
    """
    nearly = np.log(100.0)  # the odds of the links over those of the exchange, below which there is doubt
    owner, mine = np.full(len(step.found) + 1, -1), np.full(len(gain), -1)
    value = np.zeros(len(gain))
    owner[near[ball, column]], mine[ball], value[ball] = ball, near[ball, column], gain[ball, column]
    old = step.before.count > 1
    other, k = np.nonzero(np.isfinite(gain) & old[:, None] & (owner[near] >= 0))
    one, instead = owner[near[other, k]], gain[other, k]
    rival = (one != other) & old[one]
    one, other, instead = one[rival], other[rival], instead[rival]
    swapped = np.where((near[one] == mine[other][:, None]) & (mine[other] >= 0)[:, None], gain[one], 0.0)
    back = np.maximum(swapped.max(axis=1, initial=0.0), 0.0)
    doubtful = value[one] + value[other] - instead - back < nearly
    return np.unique(np.column_stack([one, other])[doubtful], axis=0)


def _uncross(step: _Step, near: Ints, gain: Array, ball: Ints, column: Ints) -> tuple[Ints, Ints]:
    """The links, with those of two new balls exchanged that would pass through one another, and exchanged would not.

    A hit before the second frame hides the first step of both, so that likelihoods may prefer such an exchange. The
    right links of two balls that hit once never pass through one another. Both positions of one ball, seen from the
    other, lie beyond the tangent at the contact. If they pass through one another either way, a third body or a wall
    was hit too, and the likelihood decides. Links are balls, and their columns of `near`.
    """
    first, found, seen = step.before.xy, step.found, near[ball, column]
    new = np.flatnonzero(step.before.count[ball] == 1)
    i, j = (new[side] for side in np.triu_indices(len(new), 1))
    start, end = first[ball[j]] - first[ball[i]], found[seen[j]] - found[seen[i]]
    through, past = _find_least_distance(start, end), _find_least_distance(start, -end)
    column = column.copy()
    least = 0.8 * step.noise.diameter  # to which balls may seem to come near one another
    for k in np.flatnonzero((through < least) & (past >= least)).tolist():
        pair = [i[k], j[k]]
        if (near[ball[pair], column[pair]] != seen[pair]).any():
            continue  # exchanged before
        others = [np.flatnonzero(near[ball[a]] == seen[b]) for a, b in (pair, pair[::-1])]
        if all(len(other) and gain[ball[a], other[0]] > 0 for a, other in zip(pair, others, strict=True)):
            column[pair] = [other[0] for other in others]
    return ball, column


def _find_least_distance(start: Array, end: Array) -> Array:
    """The least distance (n,) from the origin to straight ways from `start` to `end` (n, 2)."""
    way = end - start
    share = np.clip(-(start * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(start + share[:, None] * way).T))


def _update(step: _Step, hits: PredictedHits | None, links: tuple[Ints, Ints, Ints], frame: int) -> PredictedBalls:
    """The balls with what was found of them; links: ball, detection, and how it came, as `_weigh` says."""
    before, free, found, noise = step.before, step.free, step.found, step.noise
    ball, seen, kind = links
    xy, v, cov = free.xy.copy(), free.v.copy(), free.cov.copy()
    number, last, count = free.seen.copy(), free.last.copy(), free.count.copy()
    number[ball], last[ball], count[ball] = frame, found[seen], count[ball] + 1
    if hits is not None:
        missed = np.ones(len(before), dtype=bool)
        missed[ball] = False
        unseen, taken = np.flatnonzero(missed[hits.ball] & (hits.chance > 0.5)), np.flatnonzero(kind >= 0)
        rows, chosen = np.append(hits.ball[unseen], ball[taken]), np.append(unseen, kind[taken])
        xy[rows], v[rows], cov[rows] = hits.xy[chosen], hits.v[chosen], hits.cov[chosen]
    xx, xv, vv = cov[ball].T
    off, whole = found[seen] - xy[ball], xx + noise.position**2
    xy[ball] += (xx / whole)[:, None] * off
    v[ball] += (xv / whole)[:, None] * off
    cov[ball] = np.column_stack([xx - xx**2 / whole, xv - xx * xv / whole, vv - xv**2 / whole])
    turned = ball[kind == -2]
    if len(turned):
        way = (last[turned] - before.last[turned]) / (frame - before.seen[turned])[:, None]
        speed = np.hypot(*before.v[turned].T)
        xy[turned], v[turned] = last[turned], way
        error = 0.5 * (speed + np.hypot(*way.T)) + 0.1 * noise.diameter
        cov[turned] = np.column_stack([np.full(len(turned), noise.position**2), 0 * error, error**2])
    return PredictedBalls(free.number, number, count, last, xy, v, cov)
