"""A known smooth map in the positions of balls that slide and roll freely is found; without one it is refused."""

import json

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from synthcam_shared.errors import InputError
from tracker.calibration import camera_warp
from tracker.calibration.camera_warp import _leave_out_bad, _WarpProblem, fit_camera_warp
from tracker.calibration.free_stretches import find_free_stretches, fit_stretch
from tracker.camera.camera import Camera
from tracker.camera.warp import Warp
from tracker.cli import app
from tracker.measurement.positions import BallTrack, to_ball_tracks
from tracker.results import read_clip

SIDES, FPS, NOISE = np.array([2.8, 1.4]), 50, 2e-4
KEYS = {"scale": 1e-3, "size": [2900, 1500], "fps": FPS}
SLIDE, LOSS = 2.0, 0.05  # m/s^2, mu g of cloth and the loss of a ball that rolls


def true_shift(at):
    """The error of the map, m, with a wave length of about a metre."""
    x, y = at.T
    return 2e-3 * np.column_stack([np.sin(6 * x) * np.cos(5 * y), np.cos(7 * x + 1) * np.sin(6 * y)])


def move_freely(rng, frames=50):
    """A ball that slides for up to .3 s and then rolls, in closed form: times and positions within the table."""
    time = np.arange(frames) / FPS
    velocity = rng.uniform(0.8, 2.0) * np.array([np.cos(turn := rng.uniform(0, 2 * np.pi)), np.sin(turn)])
    push = SLIDE * np.array([np.cos(turn := rng.uniform(0, 2 * np.pi)), np.sin(turn)])
    end = rng.uniform(0, 0.3)
    early, late = np.minimum(time, end)[:, None], np.maximum(time - end, 0)[:, None]
    rolls = velocity + push * end
    along = rolls / np.hypot(*rolls)
    path = velocity * early + push * early**2 / 2 + rolls * late - along * LOSS * late**2 / 2
    path += rng.uniform(-0.5, 0.5, 2) * SIDES - path[frames // 2]
    inside = (np.abs(path) < SIDES / 2).all(axis=1)
    first = int(np.argmax(inside))
    last = first + int(np.argmin(np.append(inside[first:], False)))
    return time[first:last], path[first:last]


def film(shift, recordings=20, seed=0):
    """Positions as a camera without the shift sees them, by recording and ball."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(recordings):
        balls = [one for one in (move_freely(rng) for _ in range(8)) if len(one[0]) >= 20][:4]
        out.append([(t, path - shift * true_shift(path) + rng.normal(0, NOISE, path.shape)) for t, path in balls])
    return out


def stretches_of(recordings):
    return [[fit_stretch(t, xy, np.full(len(t), NOISE)) for t, xy in one] for one in recordings]


def without_affine(at, shift):
    """The shift without what free motion does not show."""
    terms = np.column_stack([np.ones(len(at)), at])
    return shift - terms @ np.linalg.lstsq(terms, shift, rcond=None)[0]


def write_results(folder, recordings):
    """RESULTS of these positions, in the pixels of the camera; a clip for each recording."""
    camera = Camera.from_dict(KEYS)
    (folder / "clips").mkdir(parents=True)
    (folder / "camera.json").write_text(json.dumps(KEYS))
    for clip, one in enumerate(recordings):
        (folder / f"clips/{clip:06d}").mkdir()
        rows = []
        for particle, (time, path) in enumerate(one):
            level = np.full((len(path), 1), camera.centre_height)
            x, y = camera.project(np.concatenate([path, level], axis=1)).T
            rows.append(pd.DataFrame({"frame": np.rint(time * FPS).astype(int), "particle": particle, "x": x, "y": y}))
        pd.concat(rows).to_parquet(folder / f"clips/{clip:06d}/tracks.parquet")
    return folder


@pytest.mark.gate
def test_the_command_finds_a_known_map_within_its_error(tmp_path):
    """The balls of a recording may pass through each other here: the file gives no diameter by which they touch."""
    recordings = film(1.0)
    results, output = write_results(tmp_path / "results", recordings), tmp_path / "camera.json"
    said = CliRunner().invoke(app, ["warp", str(results), "-o", str(output), "--json"])
    assert said.exit_code == 0, said.output
    found = json.loads(said.stdout)
    assert found["recordings"] == 20
    camera = Camera.read(output)
    at = np.concatenate([xy for one in recordings for _, xy in one])
    true = without_affine(at, true_shift(at))
    off = camera.warp.displace(at)[0] - true
    rms = np.sqrt(np.mean(np.sum(true**2, axis=1)))
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 0.35 * rms
    assert found["certain"] > 0.85
    assert 0.5 < found["halves"] < 0.99  # each map has the noise of its own half
    assert found["size"] == pytest.approx(rms, rel=0.15)
    assert found["rms_after"] < 1.4 * NOISE < 0.6 * found["rms_before"]
    error = np.sqrt(np.mean(np.sum(off**2, axis=1)) / 2)
    assert found["error"] == pytest.approx(error, rel=0.5)
    assert 0 < camera.warp.std < 0.5 * found["error"]
    track = to_ball_tracks(read_clip(results, 0)[0], camera)[0]
    assert track.fixed[0] == pytest.approx(camera.warp.std**2 * np.eye(2))
    assert track.warp == (camera.warp.std, camera.warp.length)
    again = CliRunner().invoke(app, ["warp", str(results), "-o", str(results / "camera.json")])
    assert "exists and was not made by" in str(again.exception)


def test_maps_of_the_error_and_their_rest_are_the_covariance_of_the_displacements():
    problem = _WarpProblem.of(stretches_of(film(1.0, 6)))
    found = problem.solve()
    root = found.root
    matrix, vector, square, dof = (sum(part) for part in zip(*problem.sums, strict=True))
    precision = matrix + found.smoothness * problem.prior
    noise = (square - vector @ np.linalg.solve(precision, vector)) / dof  # chi^2 of the fit, for a degree of freedom
    assert np.trace(root.T @ precision @ root) == pytest.approx(noise * len(root))
    maps, std = problem.split_error(root)
    at = np.concatenate([stretch.position for group in problem.groups for stretch in group])
    error = problem.displace(root).reshape(len(at), 2, -1)
    x, y = problem._knots
    shared = np.stack([Warp(x, y, *one).displace(at)[0] for one in maps], axis=-1)
    assert np.mean(np.sum(shared**2, axis=-1)) + std**2 == pytest.approx(np.mean(np.sum(error**2, axis=-1)), rel=0.02)
    assert std**2 < 0.1 * np.mean(np.sum(error**2, axis=-1)) or len(maps) == 12
    far, other = 0, len(at) // 2  # two recordings share the errors of both axes
    one, two = (np.einsum("ik,jk->ij", maps[far], maps[other]) for maps in (shared, error))
    np.testing.assert_allclose(one, two, atol=3 * std**2)


def test_an_undistorted_map_is_refused():
    with pytest.raises(InputError, match=r"refused, the free stretches show none: .* expected under 0\.001"):
        fit_camera_warp(Camera.from_dict(KEYS), stretches := stretches_of(film(0.0, 5)))
    assert fit_camera_warp(Camera.from_dict(KEYS), stretches, max_p=1.1).halves < 0.5


def test_held_out_stretches_have_no_part_in_the_map_that_they_test(monkeypatch):
    problem = _WarpProblem.of([[stretch] for group in stretches_of(film(1.0, 3)) for stretch in group])
    folds, without = [], _WarpProblem.without

    def leave_out(self, fold):
        rest = without(self, fold)
        folds.append(({id(stretch.time) for stretch in rest.stretches}, set()))
        return rest

    def note_tested(time, *rest):
        folds[-1][1].add(id(time))
        return fit_stretch(time, *rest)

    monkeypatch.setattr(_WarpProblem, "without", leave_out)
    monkeypatch.setattr(camera_warp, "fit_stretch", note_tested)
    problem.test_on_held_out(lambda done, of: None)
    every = {id(stretch.time) for stretch in problem.stretches}
    for fitted, tested in folds:
        assert tested
        assert fitted == every - tested


def test_stretches_that_do_not_move_freely_are_left_out():
    recordings = stretches_of(film(1.0, 2))
    time, path = film(1.0, 1, seed=1)[0][0]
    kinked = path + np.maximum(time - time.mean(), 0)[:, None]
    recordings[1].append(fit_stretch(time, kinked, np.full(len(time), NOISE)))
    assert _leave_out_bad(recordings) == [recordings[0], recordings[1][:-1]]


def test_too_few_stretches_are_refused():
    with pytest.raises(InputError, match="free stretches, expected at least 20"):
        fit_camera_warp(Camera.from_dict(KEYS), stretches_of(film(1.0, 3)))


def test_stretches_end_at_contacts_and_bounces():
    """A ball that bounces off a wall at .5 s and passes another ball closely has three stretches."""
    rng, time = np.random.default_rng(3), np.arange(80) / FPS
    x = np.where(time < 0.51, time, 1.02 - time) * 1.2
    ball, rest = (np.column_stack([x, np.zeros(80)]), np.tile([0.2, 0.062], (80, 1)))
    noisy = [xy + rng.normal(0, NOISE, xy.shape) for xy in (ball, rest)]
    cov = np.tile(np.eye(2) * NOISE**2, (80, 1, 1))
    tracks = [BallTrack(k, np.arange(80), time, xy, cov, 0.0) for k, xy in enumerate(noisy)]
    found = find_free_stretches(tracks, 0.06)
    assert [round(one.time[0], 2) for one in found] == [0.24, 0.56, 0.92]
    assert all(one.chi2 / one.dof < 2 for one in found)
    assert all(np.hypot(*(one.position - rest[0]).T).min() > 0.06 for one in found)
