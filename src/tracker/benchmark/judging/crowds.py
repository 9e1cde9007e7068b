"""Scores of a tracker on films of crowds: identities, errors, contacts, and the temperature of the balls as a gas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array, Ints
from synthcam_shared.errors import InputError
from tracker.benchmark.judging.position_errors import PositionMatches, match_positions
from tracker.benchmark.judging.tracker_results import TrackerResults
from tracker.benchmark.suite.definition import Suite, SuitePart
from tracker.camera.camera import Camera
from tracker.gas.observe import observe_gas
from tracker.measurement.crowd.track_contacts import NO_BALL
from tracker.recording import Result
from tracker.tables.rows import to_tracks

SUMMARY = ("hota", "contacts_found", "temperature_error")  # what the leaderboard has of all crowds
OF_POSITIONS = "ratio rmse_px bound_px found false hota idf1 mota swaps n missed clips".split()  # of `match_positions`


@dataclass(frozen=True)
class ContactRules:
    """Which contacts count, and when one that was found is a true one."""

    max_frames_apart: float = 2.0
    min_kick_px: float = 0.1  # change of a ball's velocity, px a frame; no tracker has to see a weaker contact
    frames_at_ends: float = 3.0  # of a film, where paths are too short for a contact
    max_frames_to_position: int = 10  # from a contact to the position by which its ball is known


def judge_crowds(suite: Suite, tracked: TrackerResults) -> dict[str, dict[str, float] | None]:
    """Score a tracker on all crowds of a suite: by part, None where it was not run; empty if it was run on none."""
    parts = [suite.parts[name] for name in suite.definition.crowds]
    if not any(tracked.sample.of(part) for part in parts):
        return {}
    return {part.name: judge_crowd(suite, tracked, part) if tracked.sample.of(part) else None for part in parts}


def judge_crowd(suite: Suite, tracked: TrackerResults, part: SuitePart) -> dict[str, float]:
    """Score a tracker on the clips of a part with more than two balls.

    Returns some figures of `match_positions`, and

    - contacts: number of true contacts that a tracker has to find, with balls and walls;
    - contacts_found, contacts_false: share of these that the tracks show, and share of the shown ones that are none;
    - temperature_error: rms over all frames of the relative error of the temperature; NaN where the tracks give none.

    The contacts and the temperature of all trackers follow from their tracks, by the methods of this package.
    """
    near = match_positions(suite, tracked, part)
    counts, errors = np.zeros(4, int), [np.empty(0)]
    for clip in tracked.sample.of(part):
        camera, truth = suite.camera(part.film, clip), suite.tracks(part.truth, clip)
        table, rows = tracked.of(part.film, clip)
        result = Result(clip, camera, to_tracks(table, part.name), tuple(map(dict, rows)), pd.DataFrame())
        counts += count_contacts(
            list_true_contacts(truth, suite.events(part.truth, clip), camera),
            name_balls(result.contacts, near, clip, camera.fps),
            camera.fps,
            int(truth["frame"].max()) + 1,
        )
        errors.append(measure_temperature_errors(result, truth))
    contacts, matched, shown, false = counts.tolist()
    every = np.concatenate(errors)
    figures = {name: near.statistics[name] for name in OF_POSITIONS}
    return figures | {
        "contacts": contacts,
        "contacts_found": matched / contacts if contacts else np.nan,
        "contacts_false": false / shown if shown else np.nan,
        "temperature_error": float(np.sqrt((every**2).mean())) if len(every) else np.nan,
    }


def list_true_contacts(truth: pd.DataFrame, events: pd.DataFrame, camera: Camera) -> pd.DataFrame:
    """List the contacts of a clip by time: t_s, one, other (NO_BALL of a wall), kick (px a frame, 0 out of view)."""
    hits = events[events["kind"].isin(["contact", "wall"])].sort_values("t_s")
    at, count = hits["t_s"].to_numpy(float), truth["frame"].nunique()
    every = truth.sort_values(["particle", "frame"])
    times = every["t_s"].to_numpy(float)[:count]
    velocity = every[["vx", "vy"]].to_numpy(float).reshape(-1, count, 2)
    visible = every["visible"].to_numpy(bool).reshape(-1, count)
    before = np.clip(np.searchsorted(times, at) - 1, 0, count - 2)
    one = hits["i"].to_numpy(int)
    other = np.where(hits["kind"] == "wall", NO_BALL, hits["j"].to_numpy(int))
    changes, seen = np.zeros(len(hits)), np.ones(len(hits), bool)
    for ball in (one, np.where(other == NO_BALL, one, other)):
        change = velocity[ball, before + 1] - velocity[ball, before]
        changes = np.maximum(changes, np.abs((change * hits[["nx", "ny"]].to_numpy(float)).sum(axis=1)))
        seen &= visible[ball, before] & visible[ball, before + 1]
    kick = np.where(seen, changes / (camera.fps * camera.scale), 0.0)
    return pd.DataFrame({"t_s": at, "one": one, "other": other, "kick": kick})


def name_balls(
    contacts: pd.DataFrame, near: PositionMatches, clip: int, fps: float, rules: ContactRules | None = None
) -> pd.DataFrame:
    """List the contacts that tracks show by their true balls: t_s, one, other; -2 for a track of no ball.

    A track may pass from one ball to another. So its ball is that of its position next to the contact.
    """
    longest = (rules or ContactRules()).max_frames_to_position
    own = near.pairs[near.pairs["clip"] == clip]
    every: list[int] = own["track"].unique().tolist()
    tracks = {track: own[own["track"] == track].sort_values("frame") for track in every}

    def ball_of(track: int, at: float) -> int:
        if track == NO_BALL:
            return NO_BALL
        rows = tracks.get(track)
        apart = np.array([np.inf]) if rows is None else np.abs(rows["frame"].to_numpy() - at)
        return int(rows["particle"].iloc[apart.argmin()]) if rows is not None and apart.min() <= longest else -2

    listed = [
        (at, ball_of(int(one), at * fps), ball_of(int(other), at * fps))
        for at, one, other in zip(contacts["t_s"], contacts["particle1"], contacts["particle2"], strict=True)
    ]
    return pd.DataFrame(listed, columns=["t_s", "one", "other"]).astype({"t_s": float, "one": int, "other": int})


def count_contacts(
    true: pd.DataFrame, shown: pd.DataFrame, fps: float, frames: int, rules: ContactRules | None = None
) -> Ints:
    """Count true contacts, those that were found, all that tracks show, and those of them that are none.

    Each true contact takes the nearest in time of the same balls, the strongest contact first. Weak contacts and those
    at the ends of a film may be found, and count for nothing.
    """
    rules = rules or ContactRules()
    left = [(float(at), {int(one), int(other)}) for at, one, other in shown[["t_s", "one", "other"]].to_numpy()]
    first, last = rules.frames_at_ends / fps, (frames - rules.frames_at_ends) / fps
    count = found = 0
    strongest_first = true.sort_values("kick", ascending=False, kind="stable")
    for at, one, other, kick in strongest_first[["t_s", "one", "other", "kick"]].to_numpy(dtype=np.float64).tolist():
        counts = kick >= rules.min_kick_px and first <= at <= last
        near = [c for c in left if c[1] == {int(one), int(other)} and abs(c[0] - at) * fps <= rules.max_frames_apart]
        if near:
            left.remove(near[int(np.argmin([abs(c[0] - at) for c in near]))])
        count, found = count + int(counts), found + int(counts and bool(near))
    false = sum(first <= at <= last for at, _ in left)
    return np.array([count, found, found + false, false])


def measure_temperature_errors(result: Result, truth: pd.DataFrame) -> Array:
    """Measure the relative error of the temperature in each frame that has one; none where tracks give none."""
    try:
        time = observe_gas(result).time
    except InputError:  # fewer than three balls with a velocity, or no lengths
        return np.empty(0)
    seen = truth[truth["visible"]].groupby("frame")[["vx", "vy"]]
    true = seen.var(ddof=1).mean(axis=1)
    ratio = time.set_index("frame")["temperature"] / true
    off = ratio.to_numpy(float) - 1
    return np.asarray(off[np.isfinite(off)])


def summarise_crowds(crowds: Mapping[str, Mapping[str, Any] | None]) -> dict[str, float | None]:
    """Summarise the crowds of an entry; all None without crowds.

    hota, contacts_found: means; a crowd without the figure counts as 0.
    temperature_error: the median, because a few false tracks may give any temperature; a crowd without it is the worst.
    None if that is half of them.
    """
    if not crowds:
        return dict.fromkeys(SUMMARY)
    columns = [[(one or {}).get(name) for one in crowds.values()] for name in SUMMARY]
    hota, contacts = (float(np.mean([value or 0.0 for value in column])) for column in columns[:2])
    error = float(np.median([np.inf if value is None else value for value in columns[2]]))
    return dict(zip(SUMMARY, (hota, contacts, error if np.isfinite(error) else None), strict=True))
