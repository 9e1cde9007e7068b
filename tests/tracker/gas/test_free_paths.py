"""Free paths against motions in closed form: balls that bounce, slide until they roll, and are kicked once more."""

import numpy as np
import pandas as pd
import pytest

from tracker.gas.free_paths import PathCuts, cut_free_paths
from tracker.measurement.positions import BallTrack

FPS, NOISE, DECEL, SHARE, CONTACT = 500.0, 1e-6, 2.0, 0.25, 0.0403


def make_bounces(count, seed=0):
    """Balls that roll at a wall and bounce off with 0.9 of their normal velocity; their tracks, and true velocities.

    Each slides until it has lost 2/7 of its slip, which is its kick and what the wall takes of its spin.
    """
    rng, time = np.random.default_rng(seed), np.arange(50) / FPS
    turn, before = rng.uniform(0, 2 * np.pi, count), rng.normal(0, 0.15, (count, 2))
    normal = np.column_stack([np.cos(turn), np.sin(turn)])
    kick = -1.9 * (before * normal).sum(axis=1)[:, None] * normal
    slip = kick + SHARE * 2 * (before * normal).sum(axis=1)[:, None] * normal
    size, since = np.hypot(*slip.T)[:, None], np.maximum(time - CONTACT, 0.0)
    rolls = 2 * size / (7 * DECEL)
    way = np.where(since < rolls, DECEL * since**2 / 2, DECEL * rolls * (since - rolls / 2))
    path = before[:, None] * np.minimum(time - CONTACT, 0)[:, None] + (before + kick)[:, None] * since[:, None]
    path = path - way[..., None] * (slip / size)[:, None] + rng.normal(0, NOISE, (count, len(time), 2))
    cov, frame = np.tile(np.eye(2) * NOISE**2, (len(time), 1, 1)), np.arange(len(time))
    balls = [
        BallTrack(particle=k, frame=frame, start=time, position=path[k], cov=cov, exposure=0.0) for k in range(count)
    ]
    contacts = pd.DataFrame({"t_s": CONTACT, "t_s_std": 1e-5, "particle1": range(count), "particle2": -1})
    return balls, contacts.assign(nx=normal[:, 0], ny=normal[:, 1]), before + kick


@pytest.mark.parametrize("kicked", [False, True])
def test_the_velocity_after_a_contact_is_that_of_the_slide_also_beside_a_kink_that_was_missed(kicked):
    """The first ball has two positions 0.3 mm off; later ones show the velocity before them."""
    balls, contacts, true = make_bounces(60)
    if kicked:
        balls[0].position[21:23] += 3e-4
    cuts = PathCuts(10, np.full(60, 1.0 / FPS), 2.5 / FPS, NOISE, slides=True)
    starts = {path.ball: path for path in cut_free_paths(balls, contacts, cuts) if path.start >= 0}
    off = np.array([(starts[k].velocities.even[-2] + starts[k].velocities.odd[-2]) / 2 - true[k] for k in range(60)])
    assert np.isfinite(off).all()
    assert np.median(np.abs(off[1:])) < 0.002
    assert np.hypot(*off[0]) < 0.02
    assert starts[0].usable


def test_a_frame_beside_a_contact_is_doubted_also_if_the_slide_hides_the_velocity_there():
    """A ball bounces with 0.4 of 0.5 m/s, and its slide is too short for the rows. The bounce may precede frame 20."""
    frame = np.arange(40)
    time, cov = frame / FPS, np.tile(np.eye(2) * NOISE**2, (40, 1, 1))
    since = time - CONTACT
    path = np.column_stack([np.where(since < 0, 0.5, -0.4) * since, np.zeros(40)])
    ball = BallTrack(particle=0, frame=frame, start=time, position=path, cov=cov, exposure=0.0)
    contacts = pd.DataFrame({"t_s": [CONTACT], "t_s_std": 1e-3, "particle1": 0, "particle2": -1})
    before, after = cut_free_paths([ball], contacts, PathCuts(10, np.full(1, 1e-3), 2.5 / FPS, NOISE, slides=True))
    assert np.isnan(after.velocities.even[-2, 0])
    (side,) = before.sides
    assert side.frame == 20
    assert side.change == pytest.approx(0.4**2 - 0.5**2)


def test_a_straight_line_between_contacts_is_too_slow_and_nothing_else():
    """One position between contacts 3 ms apart, at 1 m/s. Positions within 1 ms of a contact do not count."""
    frame = np.arange(40)
    time, cov = frame / FPS, np.tile(np.eye(2) * NOISE**2, (40, 1, 1))
    ball = BallTrack(particle=0, frame=frame, start=time, position=np.outer(time, [1.0, 0.0]), cov=cov, exposure=0.0)
    contacts = pd.DataFrame({"t_s": [0.0385, 0.0415], "t_s_std": 1e-5, "particle1": 0, "particle2": -1})
    paths = cut_free_paths([ball], contacts, PathCuts(10, np.full(2, 1e-3), 2.5 / FPS, NOISE, slides=False))
    (line,) = (path for path in paths if min(path.start, path.end) >= 0)
    assert not line.unsure.any()  # else the same error would count twice, as one for each ball and as one for all
    np.testing.assert_allclose(line.smoothed, 1.0 * (1e-3 + 1e-3) / 4 / 3e-3)
    np.testing.assert_allclose(line.unsure_in_all, line.smoothed)
