"""Bodies that stay together after the hit, such as discs with tape."""

from functools import cache

import numpy as np
import pytest
from tracker_contacts import SoftHit

import tracker
from tracker.measurement.collision.staying_together import find_staying_pairs, leave_contact, measure_first_parting
from tracker.measurement.positions import BallTrack
from tracker.report.estimates_text import format_for_terminal

pytestmark = pytest.mark.usefixtures("not_local")


@cache
def measure(hit, seed=0, support="air"):
    camera = hit.camera | {"support": support}
    return tracker.measure(hit.tracks(np.random.default_rng(seed)), camera, unit="m").estimates


@pytest.mark.parametrize(
    ("noise", "b"),
    [
        pytest.param(noise, b, marks=[pytest.mark.gate] * (noise > 2e-5 and b >= 0))
        for noise in (2e-5, 1e-4)
        for b in (0.0, 0.3, -0.5)
    ],
)
def test_tape_has_a_restitution_of_zero(b, noise):
    table = measure(SoftHit(0.012, sticky=True, b=b, noise=noise, after=180))
    assert table["status"].tolist() == ["stay_together"]
    row = table.iloc[0]
    assert (row["flags"], row["r"]) == ("stay together", 0)
    assert 0 < row["r_std"] < 0.05
    assert row["contact_first"] == pytest.approx(30, abs=2)
    assert row["contact_last"] == 209
    assert row["v0"] == pytest.approx(0.3, abs=4 * row["v0_std"])
    assert abs(row["b"]) == pytest.approx(abs(b), abs=4 * row["b_std"])


@pytest.mark.parametrize("seed", [0, 1])
def test_tape_is_seen_where_noise_hides_the_approach_from_frame_to_frame(seed):
    """The balls come nearer by .15 mm in each frame, with noise of .16 mm: eight frames do not show that."""
    row = measure(SoftHit(0.013, sticky=True, v0=0.18, b=0.58, fps=1000.0, before=80, noise=1.13e-4), seed).iloc[0]
    assert row["status"] == "stay_together"
    assert row["v0"] == pytest.approx(0.18, abs=4 * row["v0_std"])


def test_the_answer_names_the_frames():
    table = measure(SoftHit(0.012, sticky=True, after=180))
    text = "\n".join(format_for_terminal(table))
    assert "stay together from frame" in text
    assert "coefficient of restitution" in text


@pytest.mark.parametrize("r", [0.4, 0.1, 0.01])
def test_friction_stops_balls_that_part(r):
    """They come 1 mm nearer from frame to frame. After the hit they part with r of that, and rest after 20 frames."""
    frames, noise = np.arange(60.0), 0.002
    until = np.minimum(frames, 20)
    excess = r * (until - until**2 / 40) + np.random.default_rng(1).normal(0, noise, 60)
    excess[:2] = -0.5
    assert r / 2 < measure_first_parting(excess, noise) < 1.5 * r


@pytest.mark.parametrize(("r", "bounces"), [(0.01, False), (0.4, True)])
def test_a_slow_parting_is_an_error_of_bodies_that_stay_together(r, bounces):
    """Discs in tape turn, so that their distance grows by more than the noise."""
    frames, step, noise, diameter = np.arange(90), 2e-4, 2e-7, 0.05
    since = np.clip(frames - 30, 0, 20)
    apart = diameter - step * np.minimum(frames - 30.5, 0) + step * r * (since - since**2 / 40)
    apart[30:32] -= step / 2
    rng, cov = np.random.default_rng(2), np.tile(noise**2 * np.eye(2), (90, 1, 1))
    ways = [np.column_stack([x, 0 * x]) + rng.normal(0, noise, (90, 2)) for x in (0 * apart, -apart)]
    tracks = [BallTrack(k, frames, frames * 2e-3, way, cov, 0.0) for k, way in enumerate(ways)]
    [pair] = find_staying_pairs(*tracks, diameter, may_roll=False)
    assert pair.bounces == bounces
    assert pair.r_std > r / 2


@pytest.mark.parametrize("support", ["air", "cloth"])
@pytest.mark.parametrize("r", [0.2, 0.5, 0.9])
def test_bodies_that_part_do_not_stay(r, support):
    assert measure(SoftHit(0.02, r, after=180), support=support)["status"].iloc[0] != "stay_together"


def test_the_error_contains_a_bounce_of_rolling_balls_that_the_noise_hides():
    """Friction brings balls back that part with r of 0.16 m/s before they are 0.2 mm apart, three times the noise.

    Without friction, the same tracks show that they stay.
    """
    hit = SoftHit(0.0, 0.25, v0=0.16, friction=0.2, noise=6.4e-5, law="cut", fps=1000.0, before=80, after=350)
    rows = [measure(hit, seed, "cloth").iloc[0] for seed in range(4)]
    staying = [row for row in rows if row["status"] == "stay_together"]
    assert staying
    assert all(row["r_std"] > 0.1 for row in staying)
    tape = SoftHit(0.012, sticky=True, noise=1e-4, after=180)
    small, large = (measure(tape, support=support)["r_std"].iloc[0] for support in ("air", "cloth"))
    assert small < 0.05 < large < 0.15


@pytest.mark.gate
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_balls_that_part_slowly_after_a_second_touch_do_not_stay(seed):
    """They move apart at 1.6 % of the closing speed, and never leave each other by 2 % of a diameter."""
    hit = SoftHit(0.022, 0.219, v0=0.242, friction=0.059, noise=2.5e-5, law="hertz", before=40, after=175)
    row = measure(hit, seed, "cloth").iloc[0]
    assert row["status"] != "stay_together"
    assert not abs(row["r"] - hit.r) > 4 * row["r_std"]  # no value, or one that holds


def find(hit, seed, *, rests_until=0, may_roll=True):
    """Pairs that stay together, by the tracks alone. The striker may rest until a frame, in which a cue hits it."""
    balls = []
    for particle, part in hit.tracks(np.random.default_rng(seed)).groupby("particle"):
        cov, frame = np.tile(np.eye(2) * hit.noise**2, (len(part), 1, 1)), part["frame"].to_numpy()
        way = part[["x", "y"]].to_numpy(copy=True)
        if particle == 1:
            way[:, 0] += hit.v0 / hit.fps * np.maximum(rests_until - frame, 0)
        balls.append(BallTrack(particle, frame, frame / hit.fps, way, cov, 1e-6))
    return [pair for pair in find_staying_pairs(*balls, hit.diameter, may_roll=may_roll) if not pair.bounces]


@pytest.mark.parametrize("rests_until", [0, 68, 70, 72])
@pytest.mark.parametrize("seed", range(3))
def test_only_frames_since_the_last_kink_show_the_approach(seed, rests_until):
    """A cue hits the striker 8 to 12 frames before the touch, in frame 80."""
    hit = SoftHit(0.012, sticky=True, before=80, after=180)
    [pair] = find(hit, seed, rests_until=rests_until, may_roll=False)
    assert pair.speed == pytest.approx(hit.v0, abs=4 * pair.speed_std)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "hit",
    [
        SoftHit(0.0107, 0.281, v0=0.357, friction=0.215, noise=9.7e-5, law="cut", before=40, after=175),
        SoftHit(0.0147, 0.231, v0=0.233, friction=0.144, noise=5.9e-5, law="cut", fps=250.0, before=20, after=87),
        SoftHit(0.0063, 0.237, v0=0.226, friction=0.197, noise=1.1e-4, law="viscous", before=40, after=175),
    ],
)
def test_balls_that_lie_apart_in_the_end_do_not_stay(hit, seed):
    """Friction stops them 1 or 2 % of a diameter apart."""
    assert find(hit, seed) == []


def test_balls_that_leave_each_other_by_more_than_they_were_nearer_do_not_stay():
    """Friction stops balls on a parabola, whose first touch has no depth. Tape swings out by less than its depth."""
    time, noise = np.arange(0.9, 80), 7e-5
    scatter = np.random.default_rng(0).normal(0, noise, 81)
    ball = np.maximum(3e-4 * (1 - ((time - 3) / 3) ** 2), 0.0) * (time < 6)
    assert leave_contact(np.append(-3e-5, ball) + scatter[: len(ball) + 1], noise, 0.05)
    tape = -7e-4 * np.exp(-time / 4 * 0.79) * np.sin(np.pi * time / 4)  # the next swing is .456 of the one before
    assert not leave_contact(np.append(-3e-5, tape) + scatter[: len(tape) + 1], noise, 0.05)


def test_balls_that_lie_beside_each_other_do_not_meet():
    rng = np.random.default_rng(0)
    hit = SoftHit(0.01)
    table = hit.tracks(rng).query("frame < 60").copy()
    still = table["particle"] == 1
    table.loc[still, ["x", "y"]] = np.array([0.05, 0.0]) + rng.normal(0, 2e-5, (int(still.sum()), 2))
    assert "stay_together" not in tracker.measure(table, hit.camera, unit="m").estimates["status"].tolist()
