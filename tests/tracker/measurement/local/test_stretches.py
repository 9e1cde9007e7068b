"""Paths of one stretch: derivatives, and averaged positions."""

import numpy as np
import pytest

from tracker.measurement.local.stretches import (
    KEPT_POSITIONS,
    MAX_POSITIONS,
    NEAR_ERRORS,
    REST,
    ROLL,
    SLIDE,
    SLIDE_AND_ROLL,
    SLIDE_AND_STOP,
    cut_stretch,
    evaluate_path,
)
from tracker.measurement.positions import BallTrack

VALUES = {
    REST: [0.1, 0.2],
    ROLL: [0.1, 0.2, 0.5, -0.3, 0.05],
    SLIDE: [0.1, 0.2, 0.5, -0.3, -1.2, 0.6],
    SLIDE_AND_ROLL: [0.1, 0.2, 0.5, -0.3, -1.2, 0.6, np.log(0.1), 0.05],
    SLIDE_AND_STOP: [0.1, 0.2, 0.5, -0.3, -2.2, 0.9],
}


FALL = 0.8  # 1/s, of the loss of a roll


@pytest.mark.parametrize("half_s", [None, 0.04])
@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("motion", VALUES)
def test_derivatives_are_those_of_differences(motion, after, half_s):
    since = np.linspace(0.013, 0.4, 7) * (1 if after else -1)
    values, step = np.array(VALUES[motion]), 1e-6
    reach = None if half_s is None else np.minimum(half_s, np.abs(since))
    slope = evaluate_path(motion, values, since, after, reach, FALL)[1]
    moves = np.eye(motion.size + 1 + motion.rolls) * step  # the instant of the contact, and the fall of the loss
    for k, move in enumerate(moves):
        late, faster = step * (k == motion.size), step * (k == motion.size + 1)
        high, low = (
            evaluate_path(
                motion, values + sign * move[: motion.size], since - sign * late, after, reach, FALL + sign * faster
            )[0]
            for sign in (1, -1)
        )
        assert slope[k] == pytest.approx((high - low) / (2 * step), abs=1e-7)
    assert len(slope) == len(moves)
    falls = np.array([[1.5 * FALL], [FALL]])
    both = evaluate_path(motion, np.stack([0.9 * values, values]), np.stack([since + 0.01, since]), after, reach, falls)
    np.testing.assert_array_equal(both[0][1], evaluate_path(motion, values, since, after, reach, FALL)[0])
    np.testing.assert_array_equal(both[1][1], slope)


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("motion", VALUES)
def test_a_path_of_means_is_the_mean_of_the_path(motion, after):
    """Some of the means hold the end of a slide, or the stop of a body."""
    since, half_s = np.linspace(0.03, 0.4, 23) * (1 if after else -1), 0.025
    values, shifts = np.array(VALUES[motion]), (np.arange(2000) + 0.5) / 1000 - 1
    path = evaluate_path(motion, values, since, after, np.full(23, half_s), FALL)[0]
    single = [evaluate_path(motion, values, since + half_s * shift, after, None, FALL)[0] for shift in shifts]
    assert path == pytest.approx(np.mean(single, axis=0), abs=1e-9)


@pytest.mark.parametrize("motion", [ROLL, SLIDE_AND_ROLL])
@pytest.mark.parametrize("after", [False, True])
def test_a_loss_that_falls_with_the_speed_is_that_of_its_equation_of_motion(motion, after):
    """dv/dt = -(D + C v), solved in steps, to the error that the fourth power of the time leaves: L C^2 t^4/24."""
    rate, values = 0.2, np.array(VALUES[motion])
    tau = 0.1 if motion.ends else 0.0
    lasts = 0.3 if after or not motion.ends else tau  # of the roll: a slide comes before it
    push = values[4:6] if motion.ends else np.zeros(2)
    start = values[:2], values[2:4]
    if motion.ends and after:
        start = values[:2] + values[2:4] * tau + push * tau**2 / 2, values[2:4] + push * tau
    speed, way, steps, loss = float(np.hypot(*start[1])), 0.0, 20000, values[-1]
    at_start, dt = speed, lasts / steps * (1 if after else -1)
    for _ in range(steps):
        middle = speed - (loss + rate * (speed - at_start)) * dt / 2
        way, speed = way + middle * dt, speed - (loss + rate * (middle - at_start)) * dt
    seen = np.array([(tau if motion.ends else 0.0) + lasts if after else -lasts])
    end = start[0] + way * start[1] / at_start
    error = loss * rate**2 * lasts**4 / 24
    found = evaluate_path(motion, values, seen, after, None, rate)[0][0]
    assert np.hypot(*(found - end)) < 1.1 * error + 1e-12
    without = evaluate_path(motion, values, seen, after)[0][0]
    assert np.hypot(*(without - end)) > 10 * error


@pytest.mark.parametrize("after", [False, True])
def test_averaged_positions_of_a_parabola_lie_on_its_path(after):
    """Some frames are missing. Every mean lies inside the curve, by up to 1e-5 m."""
    rows = np.delete(np.arange(400), [60, 130, 131, 132, 300])
    time = rows / 1000.0
    contact = (time[0] - 1e-3) if after else (time[-1] + 1e-3)
    values = np.array([0.1, 0.2, 0.5, -0.3, -1.2, 0.6])
    position = evaluate_path(SLIDE, values, time - contact, after)[0]
    track = BallTrack(1, rows, time, position, np.tile(np.eye(2) * 1e-12, (len(rows), 1, 1)), exposure=0.0)
    stretch = cut_stretch(track, 1, after, 1.0, (contact, contact), 1e-3)
    path = evaluate_path(SLIDE, values, stretch.time - contact, after, stretch.reach)[0]
    assert stretch.position == pytest.approx(path, abs=1e-12)


def test_a_slide_ends_at_the_velocity_that_friction_leaves():
    """v + a tau, and a loss along that from then on: the textbook's two legs, one after the other."""
    values, tau, loss = np.array(VALUES[SLIDE_AND_ROLL]), 0.1, 0.05
    at, v, a = values[:2], values[2:4], values[4:6]
    final = v + a * tau
    left = np.array([0.02, 0.1])
    legs = at + v * tau + a * tau**2 / 2 + left[:, None] * final
    legs -= loss * left[:, None] ** 2 / 2 * final / np.hypot(*final)
    assert evaluate_path(SLIDE_AND_ROLL, values, tau + left, True)[0] == pytest.approx(legs, abs=1e-12)


@pytest.mark.parametrize("across", [0.0, 0.2])
def test_dry_friction_stops_a_body_after_half_its_speed_times_the_time(across):
    """v t/2 as for any constant deceleration; a push across the path, in m/s^2, acts until then."""
    speed, friction = 0.5, 2.0
    stops_s = speed / friction
    values = np.array([0.1, 0.2, speed, 0.0, -friction, across])
    path = evaluate_path(SLIDE_AND_STOP, values, stops_s + np.array([-1e-9, 0.1, 3.0]), True)[0]
    end = [0.1 + speed * stops_s / 2, 0.2 + across * stops_s**2 / 2]
    assert path == pytest.approx(np.tile(end, (3, 1)), abs=1e-9)
    since = np.linspace(-0.3, -0.01, 4)  # before the contact it was faster, and never at rest
    faster = speed * since - friction * since**2 / 2
    assert evaluate_path(SLIDE_AND_STOP, values, since, False)[0][:, 0] == pytest.approx(0.1 + faster)


@pytest.mark.parametrize("after", [False, True])
def test_many_positions_are_averaged_far_from_the_contact_alone(after):
    time = np.arange(400) / 1000.0
    position = np.column_stack([time, 2 * time])
    cov = np.tile(np.eye(2) * 4e-6, (400, 1, 1))
    track = BallTrack(particle=1, frame=np.arange(400), start=time, position=position, cov=cov, exposure=0.0)
    contact = time[0] - 1e-3 if after else time[-1] + 1e-3
    stretch = cut_stretch(track, 1, after, 1.0, (contact, contact), 1e-3)
    near = slice(0, KEPT_POSITIONS) if after else slice(-KEPT_POSITIONS, None)
    assert KEPT_POSITIONS < len(stretch) <= MAX_POSITIONS
    assert stretch.time[near] == pytest.approx(time[near])
    assert stretch.position[:, 1] == pytest.approx(2 * stretch.time)
    assert (1 / stretch.std**2).sum() == pytest.approx((400 - 1 + 1 / NEAR_ERRORS**2) / 4e-6)
    assert stretch.near.sum() == 1
    assert stretch.count.sum() == 400
    assert (stretch.count[near] == 1).all()
    assert stretch.count.max() > 1


@pytest.mark.parametrize(("stops_s", "creep"), [(0.12, 0.0), (0.3, 0.0), (0.6, 0.0), (0.05, 4.5e-4)])
def test_a_stretch_ends_where_its_body_stops(stops_s, creep):
    """A puck slides to its stop. Its positions at rest have a tenth of the errors, as in a film with loss.

    creep: of the last 30 positions, a quarter of the way, m.
    """
    rng, time = np.random.default_rng(2), np.arange(1, 121) / 240.0
    moving = np.minimum(time, stops_s)
    way = 1.5 * (stops_s * moving - moving**2 / 2)
    errors = rng.normal(0, 1e-4, (120, 2)) * np.where(time < stops_s, 1.0, 0.1)[:, None]
    position = np.column_stack([way, 0 * way]) + errors
    position[-30:, 1] += creep * np.linspace(0, 1, 30)
    cov = np.tile(np.eye(2) * 1e-8, (120, 1, 1))
    track = BallTrack(particle=1, frame=np.arange(120), start=time, position=position, cov=cov, exposure=0.0)
    last = cut_stretch(track, 1, True, 1.0, (0.0, 0.0), 1 / 240).time[-1]
    assert last > 0.98 * time[-1] if stops_s > time[-1] else 0.4 * stops_s < last < 1.01 * stops_s


@pytest.mark.parametrize("stops_s", [0.02, 0.05, 0.15, 0.6])
def test_all_positions_at_rest_count_as_one(stops_s):
    """The error of the last moving position lasts, as in a film with loss. Errors of neighbours correlate by 0.7."""
    rng, time = np.random.default_rng(2), np.arange(-30, 121) / 240.0
    moving = np.clip(time, -1.0, stops_s)
    errors = rng.normal(0, 1e-4, (151, 2))
    for k in range(1, 151):
        errors[k] = 0.7 * errors[k - 1] + 0.71 * errors[k] if time[k] < stops_s else errors[k - 1] + 0.05 * errors[k]
    position = np.column_stack([1.5 * (stops_s * moving - moving**2 / 2), 0 * moving]) + errors
    cov = np.tile(np.eye(2) * 1e-8, (151, 1, 1))
    track = BallTrack(particle=1, frame=np.arange(151), start=time, position=position, cov=cov, exposure=0.0)
    stretch = cut_stretch(track, 1, True, 1.0, (-1e-3, -1e-3), 1 / 240, stops=True)
    assert (stretch.time > stops_s).sum() <= 10 if stops_s < 0.5 else stretch.time[-1] == pytest.approx(0.5, abs=0.01)
    if stops_s < 0.5:
        last = stretch.position[-1]
        assert last == pytest.approx([1.5 * stops_s**2 / 2, 0.0], abs=4e-4)
        assert stretch.std[-1] == pytest.approx(1e-4)
    np.testing.assert_array_equal(stretch.as_one.cov, len(stretch) * stretch.cov)


@pytest.mark.parametrize("moves", [False, True])
def test_an_error_that_lasts_averages_only_while_the_ball_moves(moves):
    """Half of the variance is the same in all frames of a ball at rest; the covariance of either axis differs."""
    time, way = np.arange(400) / 1000.0, np.outer(np.arange(400), [1.0, 0.5]) * moves
    cov = np.tile([[4e-6, 1e-6], [1e-6, 2e-6]], (400, 1, 1))
    track = BallTrack(1, np.arange(400), time, way, cov, 0.0, fixed=cov / 2, width=1e-3)
    stretch = cut_stretch(track, 1, True, 2.0, (-1.0, -1.0), 1e-3)
    count = (400 - KEPT_POSITIONS) // (MAX_POSITIONS - KEPT_POSITIONS) + 1
    share = 1 / count if moves else (1 + 1 / count) / 2
    assert stretch.cov[KEPT_POSITIONS] == pytest.approx(cov[0] * share, rel=1e-3)
    error = np.random.default_rng(1).normal(0, 1e-3, (len(stretch), 2))
    whole = np.tile(0.5 * cov[0], (len(stretch), len(stretch))) if not moves else np.zeros((2 * len(stretch),) * 2)
    for k, own in enumerate(stretch.cov - (0 if moves else 0.5 * cov[0])):
        whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += own
    assert np.sum(stretch.whiten(error) ** 2) == pytest.approx(error.ravel() @ np.linalg.solve(whole, error.ravel()))


@pytest.mark.parametrize("frames", [6, 11])
def test_a_short_track_on_a_dry_plate_is_cut_too(frames):
    """It is shorter than the parts of a track in which the noise is measured."""
    time, rng = np.arange(frames) / 240, np.random.default_rng(0)
    position = np.column_stack([0.3 * time, 0 * time]) + rng.normal(0, 1e-5, (frames, 2))
    track = BallTrack(1, np.arange(frames), time, position, np.tile(1e-10 * np.eye(2), (frames, 1, 1)), 0.0)
    assert len(cut_stretch(track, 1, True, 1.0, (-1e-3, -1e-3), 1 / 240, stops=True)) == frames
