"""Cuts collisions into free stretches, for a search without a law of the impact: one ball between two contacts.

A stretch is evidence on the plate, the air, the camera and the clock, whatever the impact was and however the ball came
to move. It is a `MeasuredCollision` of which only the striker is seen, launched so that it meets nothing. The time of
that launch is fixed, so no law of the impact counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.first_guess import fit_slide
from discrepancy.data.launch import MEETS_NOTHING, T_C
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array, Ints
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.crowd.track_contacts import find_track_contacts
from tracker.measurement.positions import to_ball_tracks
from tracker.measurement.stretch_cuts import CUTTER, measure_path_noise


def cut_stretches(clips: Sequence[MeasuredCollision]) -> list[MeasuredCollision]:
    """Cut each collision into its free stretches: the striker before the contact, and both balls after it.

    `tracker.measurement.stretch_cuts` cuts: positions beside the contact, or beside a kink of the path, are left out. A
    ball that moves by less than a radius, or that is seen in fewer than `SearchPolicy.min_stretch_positions` frames,
    gives no stretch. A part that is a stretch already, as those of a crowd, stays.
    """
    stretches = [clip for clip in clips if clip.is_stretch]
    for clip in clips:
        if clip.is_stretch:
            continue
        time, frame_s = clip.frame / clip.fps + clip.exposure / 2, 1 / clip.fps
        balls = [np.flatnonzero(clip.ball == ball) for ball in (0, 1)]
        noise = measure_path_noise((clip.frame[rows], clip.xy[rows]) for rows in balls)
        late = time > clip.launch[T_C]
        for ball, side in ((1, ~late), (1, late), (0, late)):
            rows = np.flatnonzero((clip.ball == ball) & side)
            rows = rows[~CUTTER.is_beside(time[rows], clip.launch[T_C], clip.launch[T_C], frame_s)]
            kinks = CUTTER.find_kinks(time[rows], CUTTER.measure_kinks(time[rows], clip.xy[rows], noise))
            for part in CUTTER.cut(time[rows], clip.frame[rows], kinks, frame_s):
                stretches += _build_stretch(clip, rows[part])
    return stretches


def cut_crowd(tracks: Tracks, camera: Camera, number: int) -> list[MeasuredCollision]:
    """Cut the paths of more than two balls into free stretches between contacts, with one another and with walls."""
    balls = to_ball_tracks(tracks, camera)
    contacts = find_track_contacts(balls, camera.ball_diameter, glides=camera.glides)
    stretches = list[MeasuredCollision]()
    for ball in balls:
        whole = MeasuredCollision(
            clip=number,
            striker=camera.striker,
            camera=camera,
            frame=ball.frame,
            ball=np.ones(len(ball), dtype=np.int64),
            xy=ball.position,
            covariance=ball.cov,
            launch=np.zeros(9),
            slide_ends=np.zeros(2),
        )
        own = np.array([contact.time for contact in contacts if ball.particle in contact.balls])
        for part in CUTTER.cut(ball.time, ball.frame, own, 1 / camera.fps):
            stretches += _build_stretch(whole, part)
    return stretches


def _build_stretch(clip: MeasuredCollision, rows: Ints) -> list[MeasuredCollision]:
    """The stretch of these rows; none if they are too few, or if the ball hardly moves."""
    moved = np.hypot(*np.ptp(clip.xy[rows], axis=0)) if len(rows) else 0.0
    if len(rows) < current_policy().min_stretch_positions or not moved > clip.camera.radius:
        return []
    other = "a" if clip.striker == "b" else "b"
    own = clip.striker if clip.ball[rows[0]] == 1 else other
    opens = clip.frame[rows] / clip.fps
    start = float(opens[0]) - 0.5 / clip.fps
    launch, end = _guess_start(opens + clip.exposure / 2 - start, clip.xy[rows], start)
    stretch = replace(clip.select(rows), striker=own, launch=launch, slide_ends=np.array([start, end]), offset=0.0)
    return [replace(stretch, ball=np.ones(len(rows), dtype=clip.ball.dtype))]


def _guess_start(times: Array, xy: Array, start: float) -> tuple[Array, float]:
    """A launch (9,) at the time zero of `times`, and the time at which the slide ends, s."""
    first, path, end = fit_slide(times, xy)
    pull, velocity, place = 2 * path[0], path[1] - 2 * path[0] * first, path[2] - path[1] * first + path[0] * first**2
    slides = np.hypot(*pull) > current_policy().sliding_deceleration_m_s2
    if not slides:
        slope, place = np.polyfit(times, xy, 1)
        velocity, end = slope, 0.0
    speed, heading = float(np.hypot(*velocity)), float(np.arctan2(velocity[1], velocity[0]))
    ahead = velocity / speed
    left = np.array([-ahead[1], ahead[0]])
    slip_per_loss = 3.5  # a solid ball's slip ends at 7/2 of the deceleration of its centre
    slip = -slip_per_loss * end * pull if slides else np.zeros(2)
    return np.array([*place, start, speed, heading, MEETS_NOTHING, slip @ ahead, slip @ left, 0.0]), start + end
