"""Targets that move before the hit, and several hits in one recording, against balls simulated by themselves."""

import json

import numpy as np
import pytest
from tracker_billiard import Physics, play, positions, rolling, slip, truth

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.estimate import measure
from tracker.measurement.painter_behringer import slip_directions

pytestmark = pytest.mark.usefixtures("not_local")

FPS, NOISE = 250.0, 0.01
D = 2.38e-3


@pytest.fixture(scope="module")
def camera(tmp_path_factory):
    path = tmp_path_factory.mktemp("camera") / "camera.json"
    known = {"scale": 1.6e-4, "size": [640, 480], "fps": FPS, "exposure": 0.0, "ball_diameter": D}
    path.write_text(json.dumps(known))
    return Camera.read(path)


def seen(legs, frames, camera, rng, p, drop=0.0):
    """Tracks of all balls within the picture, with noise."""
    xy = positions(legs, np.arange(frames) / FPS, p)
    parts = []
    for ball, way in enumerate(xy):
        px = camera.project(np.column_stack([way, np.full(frames, D / 2)])) + rng.normal(0, NOISE, (frames, 2))
        inside = ((px > 8) & (px < [631, 471])).all(axis=1) & (rng.uniform(size=frames) >= drop)
        parts.append((np.flatnonzero(inside), np.full(inside.sum(), ball), px[inside]))
    frame, ball, px = (np.concatenate(part) for part in zip(*parts, strict=True))
    n = len(frame)
    cov = np.broadcast_to(np.eye(2) * NOISE**2, (n, 2, 2))
    return Tracks(frame, ball, px[:, 0], px[:, 1], cov, np.full(n, 1e3), np.full(n, ""), px[:, 0], px[:, 1])


def meeting(rng, p, moving=True):
    """Two rolling balls that touch about .1 s from now, well aimed, at any angle to each other."""
    b, heading = rng.uniform(-0.4, 0.4), rng.uniform(0, 2 * np.pi)
    w = rng.uniform(0.05, 0.2) * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a)]) * moving
    v = w + rng.uniform(0.15, 0.4) * np.array([np.cos(heading), np.sin(heading)])
    if np.linalg.norm(v) < 1.2 * np.linalg.norm(w):  # ball 2 is to be the faster
        return meeting(rng, p, moving)
    d, t = np.array([np.cos(heading), np.sin(heading)]), rng.uniform(0.09, 0.12)
    n = np.sqrt(1 - b * b) * d - b * np.array([-d[1], d[0]])
    return [rolling(-w * t, w, p.radius), rolling(-v * t - D * n, v, p.radius)]


def measure_moving(camera, count):
    """(row, truth) of hits on moving targets."""
    rng, out = np.random.default_rng(0), []
    for _ in range(count):
        p = Physics(rng.uniform(0.75, 0.97), rng.uniform(0.15, 0.35), rng.uniform(0.1, 0.36))
        legs, hits = play(meeting(rng, p), 0.4, p)
        (row,) = measure(seen(legs, 100, camera, rng, p), camera)
        out.append((row, truth(hits[0], p), hits[0], p))
    return out


@pytest.fixture(scope="module")
def moving(camera):
    return measure_moving(camera, 28)


@pytest.mark.parametrize("count", [2, pytest.param(28, marks=pytest.mark.gate)])
def test_a_moving_target_is_measured(camera, count, request):
    for row, true, hit, _ in request.getfixturevalue("moving") if count == 28 else measure_moving(camera, count):
        assert row["status"] == "ok"
        assert (row["particle1"], row["particle2"]) == (hit[2], hit[1])
        assert abs(row["r"] - true["r"]) < 2e-3
        assert np.hypot(row["v1ix"] - hit[3][hit[2]][1][0], row["v1iy"] - hit[3][hit[2]][1][1]) < 2e-3


@pytest.mark.gate
@pytest.mark.parametrize("kind", ["", "_free"])
def test_error_bars_of_moving_targets_are_true(moving, kind):
    off = []
    for name in QUANTITY_NAMES:
        z = np.array([(row[f"{name}{kind}"] - true[name]) / row[f"{name}{kind}_std"] for row, true, _, _ in moving])
        z = z[np.isfinite(z)]
        assert len(z) > 14, name
        if abs(z.mean()) > 4 / np.sqrt(len(z)) or abs(z.std() - 1) > 4 / np.sqrt(2 * len(z)):
            off.append((name, len(z), z.mean(), z.std()))
    assert off == []


@pytest.mark.gate
def test_slip_directions_of_a_moving_target(moving):
    for row, _, hit, p in moving[:10]:
        for ball, way in slip_directions(row).items():
            u = slip(hit[4][ball], p.radius)[:2]
            assert way @ u / np.linalg.norm(u) > 0.999


def test_a_resting_target_is_found_to_rest(camera):
    rng, p = np.random.default_rng(3), Physics()
    for _ in range(10):
        legs, _ = play(meeting(rng, p, moving=False), 0.4, p)
        (row,) = measure(seen(legs, 100, camera, rng, p), camera)
        assert (row["v1ix"], row["v1iy"]) == (0.0, 0.0)


def chain(camera, rng, p, gap=0.012):
    """Ball 0 hits ball 1, which rolls on and hits ball 2."""
    balls = [rolling((-0.035, 0.00002), (0.35, 0.0), p.radius), rolling((0, 0), (0, 0), p.radius)]
    balls.append(rolling((gap, -0.01 * gap), (0, 0), p.radius))
    return play(balls, 0.5, p)


def test_two_hits_in_one_recording(camera):
    rng, p = np.random.default_rng(1), Physics(mu=0.35)
    scores = []
    for _ in range(6):
        legs, hits = chain(camera, rng, p, gap=0.03)
        rows = measure(seen(legs, 125, camera, rng, p), camera)
        assert [row["collision"] for row in rows] == [0, 1]
        assert [row["status"] for row in rows] == ["ok", "ok"]
        for row, hit in zip(rows, hits, strict=True):
            true = truth(hit, p)
            scores += [(row[q] - true[q]) / row[f"{q}_std"] for q in ("r", "mu_k", "C", "tau1", "v1f", "t_c", "b")]
            assert row["frame_first"] < hit[0] * camera.fps < row["frame_last"]
        assert (rows[0]["frame_first"], rows[1]["frame_last"]) == (0, 124)
    assert np.abs(scores).max() < 4.5
    assert 0.75 < np.std(scores) < 1.25


def test_a_ball_hit_while_it_slides_is_no_rolling_one(camera):
    rng, p = np.random.default_rng(1), Physics()
    legs, hits = chain(camera, rng, p, gap=0.011)
    assert hits[1][0] - hits[0][0] < truth(hits[0], p)["tau1"]
    rows = measure(seen(legs, 125, camera, rng, p), camera)
    assert [row["status"] for row in rows][1].startswith("a ball still slides when it is hit again")
    assert np.isnan(rows[1]["r"])


def test_a_ball_that_rolled_to_a_stop_is_a_resting_target(camera):
    rng, p = np.random.default_rng(2), Physics(drag=0.5, decel=0.2)
    balls = [rolling((0, 0), (0.03, 0), p.radius), rolling((-0.055, 0.0004), (0.3, 0.0), p.radius)]
    legs, hits = play(balls, 0.7, p)
    assert np.linalg.norm(hits[0][3][0][1]) == 0
    (row,) = measure(seen(legs, 160, camera, rng, p), camera)
    true = truth(hits[0], p)
    assert (row["v1ix"], row["status"]) == (0.0, "ok")
    for name in ("r", "mu_k", "C", "b", "t_c"):
        assert abs(row[name] - true[name]) < 4 * row[f"{name}_std"]


def test_a_long_recording_with_gaps(camera):
    """A target that rests for 900 frames, a fifth of all positions missing, and the rest of them given once."""
    rng, p = np.random.default_rng(4), Physics()
    balls = [rolling((0, 0), (0, 0), p.radius), rolling((-0.048, 0.0004), (0.24, 0.0), p.radius)]
    legs, hits = play(balls, 0.6, p)
    late = 3.0
    legs = [(0.0, balls)] + [(t + late if i else late, state) for i, (t, state) in enumerate(legs)]
    legs[0] = (0.0, [balls[0], rolling((-0.9, 0.0004), (0.0, 0.0), p.radius)])  # out of view until then
    (row,) = measure(seen(legs, 880, camera, rng, p, drop=0.2), camera)
    true = truth(hits[0], p)
    assert row["status"] == "ok"
    assert abs(row["t_c"] - true["t_c"] - late) < 4 * row["t_c_std"]
    assert abs(row["r"] - true["r"]) < 4 * row["r_std"]
