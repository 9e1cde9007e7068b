"""Pixels' offsets learnt from a film: as well as the theory of linear estimates says, and nothing that a ball hides."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, uniform_filter
from tracker_film import CAMERA, disc, spot

from tracker.camera.camera import Camera
from tracker.camera.recordings import Frames, Recording
from tracker.detection.candidates import EmptyPlate
from tracker.detection.detect import detect, make_view
from tracker.detection.likelihood.dsnu import MIN_FRAMES, SURROUNDINGS_PX, DsnuEstimator

SHAPE, SPREAD, NOISE = (240, 320), 0.3, 1.0
ALL = np.indices(SHAPE)


def shown(rng, frames, spread=SPREAD, texture=None, reach=3, finds=()):
    """A plate that brightens to one side, seen for some frames, and the offsets of its pixels."""
    own = spread * rng.standard_normal(SHAPE)
    light = 8.0 + ALL[1] / 80 + (0.0 if texture is None else texture)
    hot = np.flatnonzero(light > 20)
    level = np.rint(8.0 + ALL[1] / 80).astype(np.uint8)
    plate = DsnuEstimator(EmptyPlate(level, noise(), hot), reach)
    for k in range(frames):
        frame = np.rint(light + own + NOISE * rng.standard_normal(SHAPE)).astype(np.uint8)
        at = np.array([f(k) for f in finds], dtype=np.int64).reshape(-1, 2)
        for row, column in at:  # what the ball shows there must not be learnt
            frame[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1] = 90
        plate.add(frame, at[:, 0], at[:, 1])
    return plate, own


def noise(frames=1):
    return math.sqrt((NOISE**2 + 1 / 12) / frames)


@pytest.mark.parametrize("frames", [MIN_FRAMES, 60])
def test_what_is_left_is_what_the_best_linear_estimate_leaves(frames):
    plate, own = shown(np.random.default_rng(frames), frames)
    found, left = plate.offsets(*ALL, SPREAD)
    # a known variance a, seen with noise of variance e, leaves a e / (a + e)
    theory = math.sqrt(SPREAD**2 * noise(frames) ** 2 / (SPREAD**2 + noise(frames) ** 2))
    miss = own - found
    miss -= uniform_filter(miss, SURROUNDINGS_PX)  # a level that neighbours share is the glint's background
    assert np.std(miss) == pytest.approx(theory, rel=0.03)
    assert left == pytest.approx(theory, rel=0.03)


def test_a_film_that_shows_less_than_the_camera_file_says_is_believed():
    plate, own = shown(np.random.default_rng(3), 60, spread=0.05)
    found, left = plate.offsets(*ALL, SPREAD)
    assert np.std(own - found) < 0.055
    assert left < 0.06
    found, left = shown(np.random.default_rng(4), 60, spread=0.0)[0].offsets(*ALL, SPREAD)
    assert np.std(found) < 0.02
    assert left < 0.03


def test_texture_is_no_offset():
    """A ball hides the plate's texture: were it taken for offsets, it would be added to the ball."""
    rng = np.random.default_rng(5)
    texture = 1.0 * rng.standard_normal(SHAPE)
    plate, own = shown(rng, 60, texture=texture)
    found, left = plate.offsets(*ALL, SPREAD)
    assert np.std(own - found) < SPREAD
    assert left == pytest.approx(np.std(own - found), rel=0.05)
    marked = np.zeros(SHAPE)
    marked[40, 50] = 6.0
    plate, _ = shown(rng, 60, texture=marked)
    assert plate.offsets(np.array([40]), np.array([50]), SPREAD)[0] == 0.0


def test_hot_pixels_do_not_spoil_their_surroundings():
    hot = np.zeros(SHAPE)
    hot[10::10, 10::10] = 60.0
    plate, own = shown(np.random.default_rng(9), 60, texture=hot)
    found, left = plate.offsets(*ALL, SPREAD)
    assert np.std((own - found)[hot == 0]) == pytest.approx(left, rel=0.1)


def test_balls_are_left_out_and_what_they_hid_is_not_known():
    rest, passing, twin = (lambda k: (30, 40)), (lambda k: (80, 2 * k + 10)), (lambda k: (82, 2 * k + 12))
    plate, own = shown(np.random.default_rng(6), 60, finds=[rest, passing, twin, lambda k: (0, 319)])
    found, left = plate.offsets(*ALL, SPREAD)
    hidden = np.zeros(SHAPE, bool)
    hidden[27:34, 37:44] = hidden[:4, 316:] = True
    assert np.isnan(found[hidden]).all()
    assert np.isfinite(found[~hidden]).all()
    beside = binary_dilation(hidden, iterations=4) & ~hidden
    assert np.std((own - found)[beside]) == pytest.approx(left, rel=0.2)
    passed = slice(77, 86), slice(20, 120)
    assert np.std((own - found)[passed]) == pytest.approx(left, rel=0.12)


@pytest.mark.parametrize("level", [8, 90])
@pytest.mark.parametrize("change", [0, -15, -60, 20, 120])
def test_sums_in_bytes_are_those_in_numbers_of_more_bytes(level, change):
    """Also where the light on the plate changes for a third of the film, and where a ball passes."""
    rng, spread = np.random.default_rng(level), 1.0
    own = spread * rng.standard_normal(SHAPE)
    plate = EmptyPlate(np.full(SHAPE, level, np.uint8), noise(), np.empty(0, np.int64))
    short, long = DsnuEstimator(plate, 3), DsnuEstimator(plate, 3)
    long.bytes = None
    for k in range(45):
        light = level + own + change * (10 < k < 25) + NOISE * rng.standard_normal(SHAPE)
        frame = np.clip(np.rint(light), 0, 255).astype(np.uint8)
        at = np.array([60, 63]), np.array([5 * k, 5 * k + 4])
        frame[60:64, 5 * k : 5 * k + 3] = 200
        for one in (short, long):
            one.add(frame, *at)
    (found, left), (wanted, wanted_left) = (one.offsets(*ALL, spread) for one in (short, long))
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert left == pytest.approx(wanted_left, rel=1e-5)


def test_too_few_frames_measure_nothing():
    plate, _ = shown(np.random.default_rng(7), MIN_FRAMES - 1)
    found, left = plate.offsets(*ALL, SPREAD)
    assert np.isnan(found).all()
    assert left == SPREAD


def test_positions_gain_what_the_pattern_costs():
    """Dim glints on pixels of strong offsets: nearly as good as on even pixels, error bars true, and as claimed."""
    rng, dsnu = np.random.default_rng(8), 1.0
    grid = [(x, y) for y in range(20, 150, 26) for x in range(20, 190, 26)]
    pattern = dsnu * rng.standard_normal((160, 200))
    frames, positions = [], []
    for k in range(40):
        picture = np.full((160, 200), 0.5)
        for x, y in grid if k % 2 else ():
            at = np.array([x, y]) + rng.uniform(-0.5, 0.5, 2)
            part, local = picture[y - 12 : y + 13, x - 12 : x + 13], at - [x - 12, y - 12]
            part += 25 * 2 * math.pi * spot(part.shape, *local, 1.0) + disc(part.shape, *local, 7.44)
            positions.append((k, *at))
        frames.append(np.rint(rng.poisson(picture * 20) / 20 + 8.0 + pattern + rng.standard_normal(picture.shape)))
    frames, positions = np.clip(frames, 0, 255).astype(np.uint8), np.array(positions)
    known = {k: v for k, v in CAMERA.items() if k != "lamp"}
    camera = Camera.from_dict(known | {"sensor": CAMERA["sensor"] | {"dsnu": 20 * dsnu}})
    clip = Recording(0, camera, Frames(len(frames), frames.shape[1:], frames.dtype, lambda k: frames[k]))

    def errors(view):
        found = detect(clip, view).glints
        order = [int(np.argmin((found.frame != k) * 1e9 + np.hypot(found.x - x, found.y - y))) for k, x, y in positions]
        z = np.linalg.solve(np.linalg.cholesky(found.cov[order]), (found.xy[order] - positions[:, 1:])[..., None])
        return np.sqrt(np.mean((found.xy[order] - positions[:, 1:]) ** 2)), np.sqrt(np.mean(z**2))

    view = make_view(clip)
    rms, z = errors(view)
    raw = dataclasses.replace(camera, sensor=dataclasses.replace(camera.sensor, dsnu=0.0, read_noise=20 * math.sqrt(2)))
    ignorant, _ = errors(dataclasses.replace(view, camera=raw))
    assert rms < 0.85 * ignorant
    assert z == pytest.approx(1.0, abs=0.06)
