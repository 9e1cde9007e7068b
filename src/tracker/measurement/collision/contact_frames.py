"""Which frames show two balls in contact: more are left out until the others fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from synthcam_shared.arrays import Array, Flags
from tracker.measurement.collision.adequacy import TOO_FEW, compute_p_value
from tracker.measurement.collision.contacts import ContactCandidate, fit_velocity
from tracker.measurement.collision.lasting_fit import LastingFit
from tracker.measurement.collision.lasting_motion import LastingResiduals
from tracker.measurement.collision.least_squares import ROUGH_TOLERANCE, BallPair
from tracker.measurement.positions import BallTrack, measure_separation

MIN_FRAMES = 4  # outside the contact, before and after it
MAX_WINDOWS = 12  # of frames in contact that are tried one after the other
STRAIGHT_CHI2 = 16.0  # rise of chi^2 up to which straight lines describe the balls after the hit


def find_frames_in_contact(pair: BallPair, window: tuple[int, int]) -> tuple[LastingFit, tuple[int, int]] | str | None:
    """Leave out more frames until the others fit: a rough fit, and the first and last frame that are left out."""
    fit = None
    for _ in range(MAX_WINDOWS):
        outside = leave_out_frames(pair, *window)
        if outside is None:
            return TOO_FEW
        fit = _fit_outside(outside, window, fit)
        if fit is None:
            return None
        wider = _widen(fit, pair, window)
        if wider == window:
            break
        window = wider
    assert fit is not None
    return fit, window


def _fit_outside(pair: BallPair, window: tuple[int, int], last: LastingFit | None) -> LastingFit | None:
    """A rough free fit, of straight lines where the balls do not slide visibly. None if there is no collision."""
    kind = "free" if last is None else last.problem.kind
    starts = [last.x] if last is not None else guess_free_motions(pair, *window)
    if not starts:
        return None
    free = LastingFit.to(pair, "free", starts, tolerance=ROUGH_TOLERANCE) if kind == "free" else None
    dof, level = pair.striker.noise_dof, 1e-3
    if free is not None and compute_p_value(_chi2_of_lines(pair, *window), 2 * len(pair), dof) < level:
        return free
    start = guess_straight_motion(free, pair) if free is not None else starts[0]
    straight = LastingFit.to(pair, "straight", [start], tolerance=ROUGH_TOLERANCE)
    describes = compute_p_value(straight.chi2, straight.dof, dof) >= level
    if free is None:
        starts = guess_free_motions(pair, *window)
        if not starts:  # without the frames of this window the lines after the contact do not lead back to it
            return straight if describes else None
        free = LastingFit.to(pair, "free", starts, tolerance=ROUGH_TOLERANCE)
    if not describes:
        return free
    return straight if straight.chi2 < free.chi2 + STRAIGHT_CHI2 else free


def _chi2_of_lines(pair: BallPair, first: int, last: int) -> float:
    """A lower bound on chi^2 of straight motions: each ball by itself, before and after the frames in contact."""
    square = 0.0
    for _, track in pair.balls:
        for rows in (track.frame < first, track.frame > last):
            part = track.where(rows)
            if len(part) < 3:
                continue
            columns = np.zeros((5, len(part), 2))
            columns[0, :, 0] = columns[1, :, 1] = 1.0
            columns[2, :, 0] = columns[3, :, 1] = part.time - part.time.mean()
            columns[4] = part.position - part.position.mean(axis=0)
            r = np.linalg.qr(part.whiten(columns).T, mode="r")
            square += float(np.diag(r)[-1] ** 2)
    return square


def count_contact_frames(candidate: ContactCandidate, diameter: float) -> int:
    """Count the frames of a contact that lasts: balls are nearer than a diameter (m) by more than their noise."""
    one, two = candidate.one, candidate.other
    frames, apart, first, second = measure_separation(one, two)
    noise = np.sqrt(np.trace(one.cov[first] + two.cov[second], axis1=1, axis2=2) / 2)
    return int(((apart < diameter - 3 * noise) & (np.abs(frames - candidate.frame) < 100)).sum())


def find_frames_within(candidate: ContactCandidate, diameter: float) -> tuple[int, int]:
    """First and last frame about a contact in which the balls are within a diameter; the frame itself if none."""
    frames, apart, _, _ = measure_separation(candidate.one, candidate.other)
    at, outside = int(np.argmin(np.abs(frames - candidate.frame))), np.flatnonzero(apart >= diameter)
    begin = int(outside[outside < at].max(initial=-1)) + 1
    end = int(outside[outside > at].min(initial=len(frames))) - 1
    return int(frames[min(begin, at)]), int(frames[max(end, at)])


def leave_out_frames(pair: BallPair, first: int, last: int) -> BallPair | None:
    """The pair without some frames; None if it is then not seen for long enough before and after."""
    struck, striker = (track.where((track.frame < first) | (track.frame > last)) for _, track in pair.balls)
    for track in (struck, striker):
        few = 1 if track is struck and not pair.target_moves else MIN_FRAMES
        if (track.frame < first).sum() < few or (track.frame > last).sum() < MIN_FRAMES + 1:
            return None
    return replace(pair, struck=struck, striker=striker)


def guess_free_motions(pair: BallPair, first: int, last: int) -> list[Array]:
    """Starts (p,) of a free fit: straight lines before and after, and several slide times."""
    near, fitted = 8, LastingResiduals(pair, "free").index

    def line(track: BallTrack, rows: Flags) -> tuple[Array, Array]:
        part = track.where(rows)
        velocity, middle, _ = fit_velocity(part)
        return velocity, middle - velocity * part.time.mean()

    (v1, x1), (v2, x2) = (line(t, (t.frame < first) & (t.frame >= first - near)) for _, t in pair.balls)
    if not pair.target_moves:
        rest = pair.struck.where(pair.struck.frame < first)
        v1, x1 = np.zeros(2), rest.position.mean(axis=0)
    (w1, y1), (w2, y2) = (line(t, (t.frame > last) & (t.frame <= last + near)) for _, t in pair.balls)
    jump, gap = (w1 - w2) - (v1 - v2), (y1 - y2) - (x1 - x2)
    launch = v2 - v1
    if not (jump @ jump > 0 and launch @ launch > 0):
        return []
    t_c = -float(jump @ gap) / float(jump @ jump)
    apart = (x1 - x2) + (v1 - v2) * t_c
    heading = float(np.arctan2(launch[1], launch[0]))
    beta = float(np.angle(np.exp(1j * (heading - np.arctan2(apart[1], apart[0])))))
    if abs(beta) > 1.5:
        return []
    ends = [fit_velocity(t.where(t.frame > max(last, t.frame[-1] - 3 * near)))[0] for _, t in pair.balls]
    base = [t_c, *(x1 + v1 * t_c), heading, beta, float(np.hypot(*launch)), 0.0, 0.0]
    slides = np.log([0.05, 0.015, 0.15])
    starts = (np.array([*base, *w1, *ends[0], log, *w2, *ends[1], log, 0, 0, *v1]) for log in slides)
    return [np.append(free[fitted], [0.0, np.hypot(*apart)]) for free in starts]


def _widen(fit: LastingFit, pair: BallPair, window: tuple[int, int]) -> tuple[int, int]:
    """Frames in contact by a fit, no fewer than before; one more on a side if the frames beside them do not fit."""
    before, after = fit.times(fit.x)
    step = float(np.median(np.diff(pair.striker.start)))
    margin = 0.5 * step + 0.05 * max(before + after, 0.0)
    begin, end = fit.x[0] - before - margin, fit.x[0] + after + margin
    first, last = window
    for _, track in pair.balls:
        inside = track.frame[(track.start + track.exposure > begin) & (track.start < end)]
        if len(inside) and abs(end - begin) < 200 * step:
            first, last = min(first, int(inside[0])), max(last, int(inside[-1]))
    if (first, last) != window:
        return first, last
    for side in (-1, 1):
        square = 0.0
        for ball, track in fit.problem.pair.balls:
            ahead = first - track.frame if side < 0 else track.frame - last
            beside = track.where((ahead > 0) & (ahead <= 2))
            if len(beside):
                off, _ = fit.predict_left_out(beside, ball)
                square += float(beside.whiten.distance(off).sum())
        if chdtrc(8, square) < 1e-3:
            first, last = (first - 1, last) if side < 0 else (first, last + 1)
    return first, last


def guess_straight_motion(free: LastingFit, pair: BallPair) -> Array:
    """Start (p,) of the straight motion: mean velocities over the first half of the positions after the contact."""
    problem = LastingResiduals(pair, "straight")
    whole = np.concatenate([free.free[:8], np.zeros(4), free.free[-2:]])
    for ball, track in pair.balls:
        late = track.where(track.start > free.x[0])
        whole[6 + 2 * ball : 8 + 2 * ball] = fit_velocity(late)[0]
    return np.append(whole[problem.index], free.x[-2:])
