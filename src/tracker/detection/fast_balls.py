"""Finds how far balls move in a frame where a film shows faster ones than its linker expects."""

from dataclasses import replace

import numpy as np

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.camera.camera import Camera
from tracker.detection.detector import View
from tracker.detection.glints import Glints
from tracker.detection.link import Tracks, assign_track_numbers, find_reach
from tracker.settings import USUAL_SPEED_M_S, USUAL_STEP_PX, LinkSettings

MIN_GAIN = 5  # detections that faster balls must explain
MIN_UNLINKED_SHARE = 0.005  # of all detections; a crowd always leaves some out
MAX_DETECTIONS = 1500  # that are linked with each reach
MIN_GAIN_SHARE = 0.1  # of the detections that slow balls leave unexplained
SPEED_MARGIN = 1.5  # of the speed limit over the fastest ball: others may be lost until the limit is raised


def may_be_fast(glints: Glints, tracks: Tracks, settings: LinkSettings) -> bool:
    """Tell whether tracks leave so much out that faster balls may be the cause, and the user gave no limit."""
    lengths = np.unique(tracks.particle, return_counts=True)[1]
    unlinked = len(glints) - int(lengths[lengths >= 4].sum())
    given = settings.max_speed_m_s is not None or settings.max_step_px is not None
    return not given and unlinked >= max(MIN_GAIN, MIN_UNLINKED_SHARE * len(glints))


def allow_fast_balls(camera: Camera, settings: LinkSettings) -> LinkSettings:
    """Allow for balls of eight times the usual speed, whose glints the exposure may smear out of their windows."""
    return _set_reach(8 * find_reach(camera, settings), camera, settings)


def set_link_settings(view: View, settings: LinkSettings) -> View:
    """Return a view with other settings of linking."""
    return replace(view, settings=view.settings.model_copy(update={"link": settings}))


def raise_speed_limit(glints: Glints, camera: Camera, settings: LinkSettings) -> LinkSettings:
    """Raise the greatest speed of a ball in its first frame to what a film shows.

    The detections are linked with two, four, ... times the usual reach. Detections are explained if they lie on smooth
    paths: specks seldom make such a path of four frames, however far they may move. Of the reaches that explain nearly
    as many as the best, the least counts. In films of many detections the frames with most unexplained ones decide.

    glints: detected with the settings of `allow_fast_balls`.
    Returns the same settings if the usual reach explains as much.
    """
    if len(glints) < MIN_GAIN:
        return settings
    usual, farthest = find_reach(camera, settings), float(np.hypot(*camera.size)) / 3  # px; seen in four frames
    is_slow = np.isfinite(_find_smooth_steps(glints, camera, settings))
    rows = _select_frames(glints, ~is_slow)
    glints, slow = glints.take(rows), int(is_slow[rows].sum())
    tried = list[tuple[int, float]]()  # detections that a reach explains, and the longest step
    for doubled in range(1, 1 + max(0, int(np.log2(farthest / usual)))):
        steps = _find_smooth_steps(glints, camera, _set_reach(usual * 2.0**doubled, camera, settings))
        tried.append((int(np.isfinite(steps).sum()), float(np.fmax.reduce(steps, initial=0.0))))
    gain = max((explained for explained, _ in tried), default=0) - slow
    if gain < max(MIN_GAIN, MIN_GAIN_SHARE * (len(glints) - slow)):
        return settings
    longest = next(step for explained, step in tried if explained - slow >= 0.9 * gain)
    return _set_reach(max(SPEED_MARGIN * longest, usual), camera, settings)


def describe_speed_limit(used: LinkSettings, given: LinkSettings) -> str:
    """Describe the speed limit that a film has raised; empty where it has not."""
    if used is given:
        return ""
    if used.max_speed_m_s is not None:
        return f"some balls are faster than {USUAL_SPEED_M_S:g} m/s; link.max_speed_m_s is {used.max_speed_m_s:.2g}"
    return f"some balls move by more than {USUAL_STEP_PX:g} px a frame; link.max_step_px is {used.max_step_px:.0f}"


def _select_frames(glints: Glints, unexplained: Flags) -> Ints:
    """Select the detections of successive frames, `MAX_DETECTIONS` at most, of which most are unexplained."""
    order = np.argsort(glints.frame, kind="stable")
    starts = np.append(np.unique(glints.frame[order], return_index=True)[1], len(order))
    ends = starts[np.searchsorted(starts, starts[:-1] + MAX_DETECTIONS, side="right") - 1]
    total = np.append(0, np.cumsum(unexplained[order]))
    best = int(np.argmax(total[ends] - total[starts[:-1]]))
    return np.asarray(order[starts[best] : ends[best]])


def _find_smooth_steps(glints: Glints, camera: Camera, settings: LinkSettings) -> Array:
    """Find the detections (n,) that these settings link into smooth paths: the longest step there, px; NaN for others.

    A path is smooth where two second differences in a row, of four successive frames, are under 1 px and 5 % of a step.
    """
    ids, steps = assign_track_numbers(glints, camera, settings=settings), np.full(len(glints), np.nan)
    order = np.lexsort((glints.frame, ids))
    rows = order[ids[order] >= 0]
    if len(rows) < 4:
        return steps
    follows = (np.diff(glints.frame[rows]) == 1) & (np.diff(ids[rows]) == 0)
    step = np.diff(glints.xy[rows], axis=0)
    length, bend = np.hypot(*step.T), np.hypot(*np.diff(step, axis=0).T)
    straight = follows[1:] & follows[:-1] & (bend < 1.0 + 0.05 * length[1:])
    for first in np.flatnonzero(straight[1:] & straight[:-1]).tolist():
        own = rows[first : first + 4]
        steps[own] = np.fmax(steps[own], length[first : first + 3].max())
    return steps


def _set_reach(reach: float, camera: Camera, settings: LinkSettings) -> LinkSettings:
    """Let balls move by `reach`, px, in their first frame."""
    if camera.metric:
        return settings.model_copy(update={"max_speed_m_s": reach * camera.scale * camera.fps})
    return settings.model_copy(update={"max_step_px": reach})
