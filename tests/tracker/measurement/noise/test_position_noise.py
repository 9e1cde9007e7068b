"""The noise of tracks that carry no errors, from the tracks themselves."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from tracker_noisy import BENCHMARK, dataset, noisy, truth_of

from synthcam.scene.scene import check_scene
from tracker.camera.warp import Warp
from tracker.measurement.estimate import measure
from tracker.measurement.noise.position_noise import ScatterRatio, measure_scatter
from tracker.measurement.positions import BallTrack, to_ball_tracks

pytestmark = pytest.mark.usefixtures("not_local")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return dataset(tmp_path_factory.mktemp("scatter") / "data", BENCHMARK, 12)


@pytest.fixture(scope="module")
def clips(data):
    return [truth_of(data, clip) for clip in range(12)]


def balls_of(frame, particle, xy, claimed=1.0):
    """Courses in px that claim an error of one px."""
    rows = [np.flatnonzero(particle == ball) for ball in np.unique(particle)]
    rows = [r[np.argsort(frame[r])] for r in rows]
    cov = claimed**2 * np.eye(2)
    return [BallTrack(0, frame[r], frame[r] / 250, xy[r], np.tile(cov, (len(r), 1, 1)), 5e-4, width=1.0) for r in rows]


def noise_of(*table):
    return np.sqrt(measure_scatter(balls_of(*table)).ratio)


def test_noise_is_found_in_spite_of_contact_and_slides(clips):
    for noise in (0.005, 0.05):
        found = []
        for i, (truth, _) in enumerate(clips):
            tracks = noisy(truth, np.random.default_rng(i), noise)
            found.append(noise_of(tracks.frame, tracks.particle, tracks.xy))
        assert np.mean(found) == pytest.approx(noise, rel=0.03)
        assert np.std(found) < 0.12 * noise


def test_its_own_error_is_known():
    """The spread of 300 draws of white noise, against the degrees of freedom that each claims."""
    rng, frame, particle = np.random.default_rng(3), np.tile(np.arange(60), 2), np.repeat([0, 1], 60)
    way = np.column_stack([frame * 1.5, frame * 0.0])
    sizes = [measure_scatter(balls_of(frame, particle, way + rng.normal(0, 0.2, (120, 2)), 0.2)) for _ in range(300)]
    spread = np.std([size.ratio for size in sizes])
    assert np.sqrt(2 / sizes[0].dof) == pytest.approx(spread, rel=4 / np.sqrt(600))
    assert np.mean([size.ratio for size in sizes]) == pytest.approx(1, abs=4 * spread / np.sqrt(300))


@functools.cache
def tray(side):
    """The true positions of 64 steel balls in a tray, px, and their diameter; side: of the tray, px."""
    corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    ends = (side / 2 * 1e-4 * np.array(corners)).tolist()
    inside = side * 1e-4 - 2.4e-3
    scene = {
        "groups": [{"count": 64, "arrangement": "lattice", "size": [inside, inside], "gap": 1e-6, "rms_speed": 0.15}],
        "walls": [{"start": a, "end": b} for a, b in zip(ends, ends[1:] + ends[:1], strict=True)],
        "timing": {"frames": 25},
        "camera": {"size": [side + 30, side + 30], "scale": 1e-4},
    }
    clip = check_scene(scene, "tray").draw(seed=5)
    true = clip.tracks
    return true["frame"].to_numpy(), true["particle"].to_numpy(), true[["x_mean_px", "y_mean_px"]].to_numpy(), 23.8


@pytest.mark.parametrize(("side", "free"), [(380, True), (310, True), (215, False)])  # covered: 20, 30 and 62 %
@pytest.mark.parametrize("claimed", [0.05, 0.025])
def test_kinks_of_a_dense_tray_are_no_noise(side, free, claimed):
    """Most windows have a kink. Counted as noise, they make errors 2 to 4 times too large."""
    frame, particle, xy, diameter = tray(side)
    balls = balls_of(frame, particle, xy + np.random.default_rng(1).normal(0, 0.05, xy.shape), claimed)
    size = measure_scatter(balls, diameter)
    relative = ScatterRatio(size.ratio * (claimed / 0.05) ** 2, size.dof)  # to that of the noise
    assert abs(relative.sigmas) < 3
    assert measure_scatter(balls).sigmas - size.sigmas > 10
    if free:
        assert size.dof > 100
        assert (size.sigmas > 5) == (claimed < 0.05)


def test_balls_that_always_may_touch_show_no_noise():
    """Three balls move side by side, 1.01 diameters apart; with 3 diameters between them they show their noise."""
    frame, particle = np.tile(np.arange(40), 3), np.repeat([0, 1, 2], 40)
    noise = np.random.default_rng(2).normal(0, 0.05, (120, 2))
    near, far = (
        balls_of(frame, particle, np.column_stack([particle * apart, frame * 2.0]) + noise, 0.05)
        for apart in (10.1, 30)
    )
    assert measure_scatter(near, 10.0) is None
    assert measure_scatter(far, 10.0) == measure_scatter(far)


def test_errors_that_a_resting_ball_repeats_are_not_missed():
    """A creeping ball shares most of its errors from frame to frame: claimed so, they are as large as claimed."""
    rng, frame = np.random.default_rng(4), np.arange(120)
    position = np.column_stack([0.02 * frame, 0.0 * frame])
    fixed = 0.9 * 0.1**2 * np.eye(2)
    own, ratios = 0.1 * np.sqrt(0.1), []
    for _ in range(40):
        shared = np.sqrt(0.9) * 0.1 * rng.standard_normal(2)
        xy = position + shared + rng.normal(0, own, (120, 2))
        cov = np.tile(0.1**2 * np.eye(2), (120, 1, 1))
        ratios.append(
            measure_scatter([BallTrack(0, frame, frame / 250, xy, cov, 0.0, np.tile(fixed, (120, 1, 1)), 50.0)]).ratio
        )
    assert np.mean(ratios) == pytest.approx(1, abs=0.1)


def test_a_ball_at_rest_in_whole_pixels_shows_no_error(clips):
    truth, camera = clips[0]
    tracks = noisy(truth, np.random.default_rng(0), 0.02)
    tracks = replace(tracks, x=np.round(tracks.x), y=np.round(tracks.y), cov=np.full_like(tracks.cov, np.nan))
    found = to_ball_tracks(tracks, camera)[0].cov[0]
    assert np.sqrt(np.trace(found) / 2) / camera.scale == pytest.approx(np.sqrt(1 / 12), rel=0.3)


def test_gaps_and_order_do_not_matter_and_too_little_says_so():
    rng = np.random.default_rng(0)
    frame, particle = np.tile(np.arange(400), 2), np.repeat([4, 1], 400)
    xy = np.column_stack([frame * 1.5, 0.01 * frame**1.5]) + rng.normal(0, 0.2, (800, 2))
    kept = rng.permutation(800)[:700]
    assert noise_of(frame[kept], particle[kept], xy[kept]) == pytest.approx(0.2, rel=0.1)
    assert measure_scatter(balls_of(frame[:6], particle[:6], xy[:6])) is None
    assert measure_scatter(balls_of(frame[::2], particle[::2], xy[::2])) is None


def test_perfect_positions_do_not_divide_by_zero():
    frame = np.arange(50)
    assert 0 < noise_of(frame, np.zeros(50, int), np.column_stack([frame, frame]) * 1.0) <= 1e-5


def test_a_row_says_where_its_errors_come_from(clips):
    z = []
    for i, (truth, camera) in enumerate(clips[:6]):
        tracks = noisy(truth, np.random.default_rng(i), 0.02)
        (given,) = measure(tracks, camera)
        (found,) = measure(replace(tracks, cov=np.full_like(tracks.cov, np.nan)), camera)
        assert given["noise"] == "given"
        assert np.isnan(given["noise_px"])
        assert found["noise"] == "scatter"
        assert found["noise_px"] == pytest.approx(0.02, rel=0.3)
        assert found["r"] == pytest.approx(given["r"], abs=given["r_std"])
        z.append(found["chi2_free"] / found["dof_free"])
    assert np.mean(z) == pytest.approx(1, abs=0.15)


def test_a_quarter_of_an_encoders_variance_persists_while_a_ball_moves_on(clips):
    """At errors of .075 px, over 250 px; benchmarks/tracker/codecs.py has the errors of what is measured so."""
    truth, camera = clips[0]
    tracks = noisy(truth, np.random.default_rng(0), 0.075)
    plain = to_ball_tracks(tracks, camera)
    coded = to_ball_tracks(tracks, replace(camera, sensor=replace(camera.sensor, codec_noise=3.0)))
    for before, after in zip(plain, coded, strict=True):
        share = after.fixed[:, 0, 0] / before.cov[:, 0, 0]
        assert share == pytest.approx(0.25, rel=0.3)  # the size of the errors is estimated
        np.testing.assert_allclose(after.cov - before.cov, after.fixed, atol=1e-18)
        assert after.drift[1] == pytest.approx(250 * camera.scale)
        assert before.drift == (0.0, 0.0)


def test_a_warp_keeps_its_error_when_the_scatter_resizes_the_others(clips):
    """The error of the map is smooth: that tracks claim five times their noise says nothing about it."""
    truth, camera = clips[0]
    knots = np.linspace(-0.1, 0.1, 4)
    camera = replace(camera, warp=Warp(knots, knots, np.zeros((4, 4)), np.zeros((4, 4)), std=1e-4, length=0.05))
    ball = to_ball_tracks(noisy(truth, np.random.default_rng(0), 0.075), camera)[0]
    smaller, own = ball.scale_errors(ScatterRatio(0.04, 50.0)), 1e-8 * np.eye(2)
    np.testing.assert_allclose(smaller.cov - own, 0.04 * (ball.cov - own))
    np.testing.assert_allclose(smaller.fixed - own, 0.04 * (ball.fixed - own), atol=1e-20)
    assert smaller.drifts == ((1e-4, 0.05),)


@pytest.mark.gate
def test_of_an_encoded_film_errors_are_as_large_as_a_free_fit_leaves(clips):
    """A wobble too slow for windows of seven frames, as large as the noise, is an encoder's doing."""
    seen = []
    for i, (truth, camera) in enumerate(clips[:4]):
        tracks = noisy(truth, np.random.default_rng(i), 0.05)
        wobble = 0.055 * np.sin(tracks.frame / 4.0 + tracks.particle)
        wobbly = replace(tracks, x=tracks.x + wobble, y=tracks.y + wobble)
        (plain,) = measure(wobbly, camera)
        (coded,) = measure(wobbly, replace(camera, sensor=replace(camera.sensor, codec_noise=3.0)))
        if plain["adequate_free"] < 1e-6 and plain["noise"] == "given":
            assert (coded["status"], coded["noise"]) == ("ok", "scatter")
            quick = plain["chi2_free"] / plain["dof_free"]  # what lasts comes on top of that
            assert coded["noise_ratio"] == pytest.approx(np.sqrt(quick), rel=0.02)
        seen.append((plain["status"], coded["status"]))
    assert seen.count(("misfit", "ok")) >= 2
    tracks = noisy(clips[0][0], np.random.default_rng(0), 0.05)
    torn = replace(tracks, x=tracks.x + 0.5 * np.sin(tracks.frame / 4.0))
    camera = clips[0][1]
    (row,) = measure(torn, replace(camera, sensor=replace(camera.sensor, codec_noise=3.0)))
    assert row["status"] != "ok"  # no encoder does that
