"""Repair of tracks of other programs before a fit: balls that exchange their numbers, lost points, numbers reused.

An exchange is undone where that makes both tracks smoother by more than a radius. Positions that no ball can reach are
left out. A number that continues elsewhere, with a path of its own, becomes a new one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.notes import Note, NoteKind

NEAR_STEPS = 5  # steps on either side that show how fast a ball moves


@dataclass(frozen=True)
class RepairedTracks:
    """Tracks, and notes with the frames in which they were repaired."""

    tracks: Tracks
    notes: tuple[Note, ...] = ()


def repair_tracks(tracks: Tracks, camera: Camera, clip: int | None = None) -> RepairedTracks:
    """Repair tracks: undo exchanges of numbers, and leave out or renumber what cannot belong to a ball.

    camera: gives the diameter of a ball, px, without which nothing is done.
    """
    if not camera.metric or not camera.knows_diameter or len(tracks) < 3:
        return RepairedTracks(tracks)
    order = np.lexsort((tracks.frame, tracks.particle))
    if not np.array_equal(order, np.arange(len(order))):
        tracks = tracks.take(order)
    notes, diameter = list[Note](), camera.diameter_px
    lost = find_unreachable_positions(tracks, diameter)[1]
    # a point on the path of another ball may be one of an exchange
    lost[lost] = ~_is_near_another(tracks, lost, diameter)
    kept, lost_frames = tracks.take(np.flatnonzero(~lost)), tracks.frame[lost].tolist()
    if lost.any():
        tracks = kept
    exchanged, frames, unsure = undo_exchanges(tracks, diameter)
    if frames:
        text = f"balls exchange their numbers in {_name_frames(frames)}; exchanged back, which makes their paths smooth"
        notes.append(Note(NoteKind.REPAIR, text, clip, tuple(frames)))
        tracks = replace(tracks, particle=exchanged).take(np.lexsort((tracks.frame, exchanged)))
    if unsure:
        text = f"balls may exchange their numbers in {_name_frames(unsure)}; they move too far in a frame to be certain"
        notes.append(Note(NoteKind.REPAIR, text, clip, tuple(unsure)))
    renumbered, gone = find_unreachable_positions(tracks, diameter)
    lost_frames += tracks.frame[gone].tolist()
    if lost_frames:
        every = sorted(set(lost_frames))
        many = f"{len(lost_frames)} position{'s' * (len(lost_frames) > 1)} that no ball can reach"
        text = f"{many}, in {_name_frames(every)}: left out"
        notes.append(Note(NoteKind.REPAIR, text, clip, tuple(every)))
    for new in np.setdiff1d(renumbered[~gone], tracks.particle).tolist():
        rows = (renumbered == new) & ~gone
        old, first, last = int(tracks.particle[rows][0]), int(tracks.frame[rows][0]), int(tracks.frame[rows][-1])
        text = f"number {old} is far from its path in frames {first} to {last}; there it becomes number {new}"
        notes.append(Note(NoteKind.REPAIR, text, clip, (first, last)))
    if gone.any() or (renumbered != tracks.particle).any():
        tracks = replace(tracks, particle=renumbered)
        tracks = tracks.take(np.flatnonzero(~gone)[np.lexsort((tracks.frame[~gone], renumbered[~gone]))])
    return RepairedTracks(tracks, tuple(notes))


def undo_exchanges(tracks: Tracks, diameter: float) -> tuple[Ints, list[int], list[int]]:
    """Undo exchanges of the numbers of balls in tracks: the numbers, their frames, and frames that are not certain.

    Balls are assigned to their last positions so that all move least. Two balls that touch are a diameter apart, so
    that numbers exchanged even at a hit cost two diameters more.
    """
    max_gap_frames = 3  # between two sightings that can show an exchange
    max_step_diameters = 1.75  # of a ball between two sightings; beyond it an exchange is not certain
    particle, frame, xy = np.array(tracks.particle, dtype=np.int64), np.asarray(tracks.frame), tracks.xy
    renamed = particle.copy()
    follows = np.flatnonzero((np.diff(particle) == 0) & (np.diff(frame) <= max_gap_frames)) + 1
    far = follows[np.hypot(*(xy[follows] - xy[follows - 1]).T) > diameter / 4]
    follows = follows[np.argsort(frame[follows], kind="stable")]
    names = {int(p): int(p) for p in np.unique(particle[far])}  # the true number by the table's
    frames, unsure = list[int](), list[int]()
    # an exchange moves at least one ball by more than a quarter of a diameter: the others need no look
    for now in np.unique(frame[far]).tolist():
        rows = follows[slice(*np.searchsorted(frame[follows], [now, now + 1]))]
        cost = np.hypot(*(xy[rows][:, None] - xy[rows - 1][None]).transpose(2, 0, 1))
        found = linear_sum_assignment(cost)[1]
        for cycle in _cycles(found):
            # a radius is far more than any error of a position
            if sum(cost[k, k] - cost[k, found[k]] for k in cycle) <= diameter / 2:
                continue
            # paths of balls that move by more can cross within a frame
            if max(_slowest(tracks, int(rows[k])) for k in cycle) > max_step_diameters * diameter:
                unsure.append(now)
                continue
            frames.append(now)
            numbers = [int(particle[rows[k]]) for k in cycle]
            given = [names.setdefault(int(p), int(p)) for p in particle[rows[found[cycle]]]]
            for number, true in zip(numbers, given, strict=True):
                names[number] = true
                own = slice(*np.searchsorted(particle, [number, number + 1]))
                renamed[own][frame[own] >= now] = true
    return renamed, sorted(set(frames)), sorted(set(unsure))


def _slowest(tracks: Tracks, row: int) -> float:
    """How far a ball moves from the frame before this row to the row, by the slowest of its three steps before; px."""
    own = np.arange(max(row - 4, 0), row)
    own = own[tracks.particle[own] == tracks.particle[row]]
    if len(own) < 2:
        return 0.0
    speeds = np.hypot(*np.diff(np.column_stack([tracks.x[own], tracks.y[own]]), axis=0).T) / np.diff(tracks.frame[own])
    return float(speeds.min() * (tracks.frame[row] - tracks.frame[row - 1]))


def _cycles(found: NDArray[np.intp]) -> Iterator[list[int]]:
    """The cycles of a permutation, longer than one."""
    left = set(range(len(found)))
    while left:
        cycle = [left.pop()]
        while (following := int(found[cycle[-1]])) in left:
            left.remove(following)
            cycle.append(following)
        if len(cycle) > 1:
            yield cycle


def find_unreachable_positions(tracks: Tracks, diameter: float) -> tuple[Ints, Flags]:
    """Numbers of particles, new ones for paths far from a ball's own, and the rows of lost points."""
    min_path_positions, xy = 5, tracks.xy  # the former make a path of their own
    renumbered, gone = np.array(tracks.particle, dtype=np.int64), np.zeros(len(tracks), dtype=bool)
    following = int(renumbered.max(initial=-1)) + 1
    far = (np.diff(tracks.particle) == 0) & (np.hypot(*np.diff(xy, axis=0).T) > diameter)
    for particle in np.unique(tracks.particle[1:][far]):
        rows = np.arange(*np.searchsorted(tracks.particle, [particle, particle + 1]))
        pieces = _cut(tracks.frame[rows], xy[rows], diameter)
        if len(pieces) == 1:
            continue
        # numbers that stay exactly where they are after a jump mark a ball that is not seen
        still = [piece for piece in pieces if np.ptp(xy[rows[piece]], axis=0).max() == 0 and len(piece) > 1]
        moving = [piece for piece in pieces if not any(piece is other for other in still)]
        own = True
        while moving:
            chain = _longest_chain(moving, tracks.frame[rows], xy[rows], diameter)
            every = np.concatenate([moving[k] for k in chain])
            if not own and len(every) < min_path_positions:
                break
            if not own:
                renumbered[rows[every]] = following
                following += 1
            moving, own = [piece for k, piece in enumerate(moving) if k not in chain], False
        for piece in (*moving, *still):
            gone[rows[piece]] = True
    return renumbered, gone


def _is_near_another(tracks: Tracks, some: Flags, diameter: float) -> Flags:
    """True if those rows, or some of their run, lie where another ball was or will be within two frames."""
    rest = np.flatnonzero(~some)
    every = tracks.xy
    frame, particle, xy = tracks.frame[rest], tracks.particle[rest], every[rest]
    same = (np.diff(particle) == 0) & (np.diff(frame) == 1)
    steps = np.hypot(*np.diff(xy, axis=0).T)[same]
    reach = diameter + 2 * float(np.quantile(steps, 0.9)) if len(steps) else diameter
    order = np.argsort(frame, kind="stable")
    ordered, near = frame[order], list[bool]()
    for row in np.flatnonzero(some):
        now = tracks.frame[row]
        others = order[slice(*np.searchsorted(ordered, [now - 2, now + 3]))]
        others = others[particle[others] != tracks.particle[row]]
        near.append(bool((np.hypot(*(xy[others] - every[row]).T) < reach).any()))
    rows = np.flatnonzero(some)
    joined = (np.diff(rows) == 1) & (np.diff(tracks.particle[rows]) == 0)
    joined &= np.hypot(*np.diff(every[rows], axis=0).T) < reach
    run = np.concatenate([[0], np.cumsum(~joined)])[: len(rows)]
    return np.isin(run, run[np.array(near, dtype=bool)])


def _cut(frame: Ints, xy: Array, diameter: float) -> list[Ints]:
    """The rows of one track in pieces, between jumps longer than a ball can move by its speed before and after."""
    if len(frame) < 2:
        return [np.arange(len(frame))]
    gap = np.diff(frame)
    step = np.hypot(*np.diff(xy, axis=0).T)
    speed = step / gap
    jumps = []
    for k in np.flatnonzero(step > diameter):
        sides = speed[max(k - NEAR_STEPS, 0) : k], speed[k + 1 : k + 1 + NEAR_STEPS]
        # one or two steps at an end may be jumps themselves
        fast = max(_usual(side if len(side) > 2 else side[side <= diameter]) for side in sides)
        if step[k] > diameter + 2 * gap[k] * fast:
            jumps.append(int(k) + 1)
    return np.split(np.arange(len(frame)), jumps)


def _usual(speeds: Array) -> float:
    """The speed of a ball by its steps on one side, of which some may be jumps: the second lowest, or lowest."""
    return float(np.sort(speeds)[1 if len(speeds) > 3 else 0]) if len(speeds) else 0.0


def _longest_chain(pieces: list[Ints], frame: Ints, xy: Array, diameter: float) -> list[int]:
    """The pieces, in order of time, each within reach of the one before, that have the most positions."""

    def speed(rows: Ints) -> float:
        return _usual(np.hypot(*np.diff(xy[rows], axis=0).T) / np.diff(frame[rows]))

    usual = speed(max(pieces, key=len))
    ends = [(speed(rows[-NEAR_STEPS - 1 :]), speed(rows[: NEAR_STEPS + 1])) for rows in pieces]
    best, source = [len(rows) for rows in pieces], [-1] * len(pieces)
    for k, rows in enumerate(pieces):
        # a jump that is far back in a track with thousands of them says nothing
        for j in range(max(k - 50, 0), k):
            apart, gap = np.hypot(*(xy[rows[0]] - xy[pieces[j][-1]])), frame[rows[0]] - frame[pieces[j][-1]]
            near = apart <= diameter + 2 * gap * max(ends[j][0], ends[k][1], usual)
            if near and best[j] + len(rows) > best[k]:
                best[k], source[k] = best[j] + len(rows), j
    k, chain = int(np.argmax(best)), list[int]()
    while k >= 0:
        chain.append(k)
        k = source[k]
    return chain[::-1]


def _name_frames(frames: list[int]) -> str:
    """Frames for a sentence, the first few of many."""
    shown = ", ".join(map(str, frames[:6]))
    return f"frame{'s' * (len(frames) > 1)} {shown}{f' and {len(frames) - 6} more' if len(frames) > 6 else ''}"
