"""Glints of known position found again: precision, true error bars, no bias, nothing that is not there."""

import copy
import importlib.util
import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tracker_film import CAMERA, collision, disc, expose, film, spot

import synthcam
from benchmarks.tracker.codecs import encode
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.mirror_images import locate_secondary_glints
from tracker.camera.recordings import Frames, Recording, open_frames
from tracker.detection import detect as detect_module
from tracker.detection.detect import detect, find_detected_point, list_detectors, make_view
from tracker.detection.glints import Glints, PositionFlag
from tracker.detection.likelihood.cramer_rao import localisation_bound
from tracker.detection.link import assign_track_numbers

CAM = Camera.from_dict({k: v for k, v in CAMERA.items() if k != "lamp"})  # no lamp: the profile is centred on the glint
CODED = {"bits": 8, "gain": 124.0, "read_noise": 3.4, "black_level": 8.0, "codec_noise": 17.0}
GRID = [(x, y) for y in range(20, 150, 26) for x in range(20, 190, 26)]


def clip(frames, camera=CAM):
    return Recording(0, camera, Frames(len(frames), frames.shape[1:], frames.dtype, lambda k: frames[k]))


def many_glints(rng, peak, frames=14, blur=(0.0, 0.0), profile=4.0, sigma=1.0):
    """Frames of balls at rest, each anywhere within its pixel, and their positions; the first frames are blank."""
    pictures, positions = [], []
    for k in range(frames):
        picture = np.full((160, 200), 0.5)
        for x, y in GRID if k else ():
            at = np.array([x, y]) + rng.uniform(-0.5, 0.5, 2)
            part = picture[y - 12 : y + 13, x - 12 : x + 13]
            local = at - [x - 12, y - 12]
            part += peak * 2 * math.pi * sigma**2 * spot(part.shape, *local, sigma, blur, steps=30)
            part += profile * peak / 200 * disc(part.shape, *local, 7.44)
            positions.append((k, *at))
        pictures.append(expose(rng, picture))
    return np.array(pictures), np.array(positions)


def errors(found, positions):
    """Errors (n, 2) in the order of `positions`; every position must be found once, and nothing else."""
    assert len(found) == len(positions)
    order = [
        int(np.argmin((found.frame != k) * 1e9 + (found.x - x) ** 2 + (found.y - y) ** 2)) for k, x, y in positions
    ]
    assert len(set(order)) == len(positions)
    return found.xy[order] - positions[:, 1:], found.take(order)


@pytest.mark.parametrize(("peak", "limit"), [(700, 1.12), (200, 1.08), (100, 1.08), (25, 1.10), (12, 1.12)])
def test_precision_is_the_bounds_and_errors_are_honest(peak, limit):
    rng = np.random.default_rng(peak)
    frames, positions = many_glints(rng, peak)
    view = make_view(clip(frames))
    miss, found = errors(detect(clip(frames), view).glints, positions)
    flux = np.full(len(positions), peak * 2 * math.pi)
    bound = localisation_bound(CAM, flux, positions[:, 1:], background=8.5 + 4.0 * peak / 200)
    ratio = math.sqrt(np.mean(miss**2) / (np.trace(bound, axis1=1, axis2=2).mean() / 2))
    assert 0.9 < ratio < limit
    z = np.linalg.solve(np.linalg.cholesky(found.cov), miss[..., None])[..., 0]
    assert abs(z.mean()) < 4 / math.sqrt(z.size)
    assert abs(z.std() - 1) < 4 / math.sqrt(2 * z.size)
    assert ((found.flags & PositionFlag.CLIPPED) > 0).all() == (peak == 700)


def test_glints_are_found_among_more_specks_that_an_encoder_leaves(tmp_path):
    """At crf 28 there are five specks to a glint; the ball's own shine is learnt from glints all the same."""
    drawn = synthcam.Scene.read("benchmark").draw(0, seed=13)
    encode(drawn.pictures(), tmp_path / "frames.mp4", "h264_28", 250.0)
    known = {"psf": {"sigma_px": 1.09}, "fps": 250.0, "scale": 1.6e-4, "size": [640, 480], "ball_diameter": 2.38e-3}
    camera = Camera.from_dict(known | {"sensor": CODED})
    encoded = Recording(0, camera, open_frames(tmp_path / "frames.mp4"))
    found = detect(encoded, make_view(encoded)).glints
    truth = drawn.tracks.query("visible")
    near = [
        np.hypot(*(found.xy[found.frame == k] - at).T).min(initial=9)
        for k, *at in truth[["frame", "glint_x_px", "glint_y_px"]].itertuples(index=False)
    ]
    assert np.quantile(near, 0.95) < 0.5


def test_a_centroid_is_far_from_the_bound():
    """The test above can fail: a plain centroid does, and worst where the glint clips."""
    for peak, least in ((200, 1.3), (700, 1.5)):
        frames, positions = many_glints(np.random.default_rng(peak), peak)
        miss, _ = errors(detect(clip(frames), make_view(clip(frames)), "centroid").glints, positions)
        bound = localisation_bound(CAM, np.full(len(positions), peak * 2 * math.pi), positions[:, 1:], background=12.5)
        assert math.sqrt(np.mean(miss**2) / (np.trace(bound, axis1=1, axis2=2).mean() / 2)) > least


def test_position_does_not_depend_on_the_position_within_the_pixel():
    frames, positions = many_glints(np.random.default_rng(9), 200, frames=20)
    miss, found = errors(detect(clip(frames), make_view(clip(frames))).glints, positions)
    phase = 2 * math.pi * positions[:, 1:]
    for axis in range(2):
        wave = np.column_stack([np.cos(phase[:, axis]), np.sin(phase[:, axis]), np.ones(len(positions))])
        fit = np.linalg.lstsq(wave, miss[:, axis], rcond=None)[0]
        assert 2 * math.hypot(fit[0], fit[1]) < 0.005
    assert (found.flags & PositionFlag.MISFIT).mean() < 0.01


def test_what_a_resting_ball_shares_between_frames():
    """One fixed pattern: a ball's errors average out over frames only down to the part called fixed."""
    rng = np.random.default_rng(12)
    data = {k: v for k, v in CAMERA.items() if k != "lamp"}
    camera = Camera.from_dict({**data, "sensor": {**CAMERA["sensor"], "prnu": 0.02, "dsnu": 10.0}})
    response, offset = 1 + 0.02 * rng.standard_normal((160, 200)), 0.5 * rng.standard_normal((160, 200))
    means, fixed, whole = [], [], []
    for _ in range(3):
        picture, positions = np.full((160, 200), 0.5), []
        for x, y in GRID:
            positions.append(np.array([x, y]) + rng.uniform(-0.5, 0.5, 2))
            part = picture[y - 12 : y + 13, x - 12 : x + 13]
            part += 200 * 2 * math.pi * spot(part.shape, *(positions[-1] - [x - 12, y - 12]), 1.0)
        frames = np.array([expose(rng, picture * response + offset) for _ in range(30)])
        found = detect(clip(frames, camera), make_view(clip(frames, camera))).glints
        for position in positions:
            own = found.take(np.hypot(*(found.xy - position).T) < 2)
            assert len(own) == 30
            means.append(own.xy.mean(axis=0) - position)
            fixed.append(np.diagonal(own.fixed.mean(axis=0)))
            whole.append(np.diagonal(own.cov.mean(axis=0)))
    fixed, whole = np.array(fixed), np.array(whole)
    shared = fixed + (whole - fixed) / 30
    z = np.array(means) / np.sqrt(shared)
    assert abs(z.std() - 1) < 4 / math.sqrt(2 * z.size)
    assert (np.array(means) / np.sqrt(whole / 30)).std() > 2  # taken as independent they would be far too sure


def two_rolling(rng, speed, **more):
    """Two balls far from each other, and the middle of their glints in each frame."""
    time = np.arange(25.0)
    paths = np.stack(
        [
            np.column_stack([20.3 + speed * time, 40 + 0.3 * time]),
            np.column_stack([180 - 0.4 * speed * time, 120.2 - 0.2 * time]),
        ],
        axis=1,
    )
    paths = paths[paths[:, 0, 0] < 180]
    return film(rng, paths, **more), paths


def test_a_blurred_glint_is_measured_at_its_middle():
    rng = np.random.default_rng(3)
    camera = Camera.from_dict({**{k: v for k, v in CAMERA.items() if k != "lamp"}, "exposure": 2e-3})
    misses, covs = [], []
    for _ in range(3):
        frames, paths = two_rolling(rng, 9.0, exposure_share=0.5)
        shown = clip(frames, camera)
        found = detect(shown, make_view(shown)).glints
        positions = np.array([(k, *p) for k in range(len(paths)) for p in paths[k]])
        miss, ordered = errors(found, positions)
        assert (ordered.flags[::2] & PositionFlag.STREAK).all()
        misses.append(miss)
        covs.append(ordered.cov)
    z = np.linalg.solve(np.linalg.cholesky(np.concatenate(covs)), np.concatenate(misses)[..., None])[..., 0]
    assert abs(z.mean()) < 4 / math.sqrt(z.size)
    assert abs(z.std() - 1) < 4 / math.sqrt(2 * z.size)


def test_ball_at_rest_through_the_whole_clip_is_found_in_every_frame():
    rng = np.random.default_rng(4)
    paths = np.tile(np.array([[[60.3, 70.2], [130.4, 90.1]]]), (30, 1, 1))
    frames = film(rng, paths)
    found = detect(clip(frames), make_view(clip(frames))).glints
    assert len(found) == 60
    assert np.bincount(found.frame).tolist() == [2] * 30


@pytest.mark.parametrize("gap", [14.9, *(pytest.param(gap, marks=pytest.mark.gate) for gap in (15.5, 18.0))])
def test_neighbour_and_its_secondary_glints_do_not_pull(gap):
    rng = np.random.default_rng(int(gap * 10))
    misses = []
    for _ in range(24):
        angle = rng.uniform(0, 2 * math.pi)
        way = np.array([math.cos(angle), math.sin(angle)])
        one = np.array([100.0, 80.0]) + rng.uniform(-0.5, 0.5, 2)
        centres = np.array([one, one + gap * way])
        seen = CAM_LAMP.glint_of_centre(CAM_LAMP.unproject(centres)[0])
        picture = np.full((160, 200), 0.5)
        for k, (glint, centre) in enumerate(zip(seen, centres, strict=True)):
            picture += 200 * 2 * math.pi * spot(picture.shape, *glint, 1.0)
            picture += 4 * disc(picture.shape, *centre, 7.44)
            side = way if k == 0 else -way
            picture += 0.055 * 200 * 2 * math.pi * spot(picture.shape, *(centre + 0.7 * 7.44 * side), 1.0)
        blank = np.full((160, 200), 0.5)
        frames = np.array([expose(rng, p) for p in (blank, picture, blank)])
        shown = clip(frames, CAM_LAMP)
        found = detect(shown, make_view(shown)).glints
        assert len(found) == 2
        assert ((found.flags & PositionFlag.NEAR) > 0).all()
        order = np.argsort(np.hypot(*(found.xy - seen[0]).T))
        miss = found.xy[order] - seen
        misses.append([miss[0] @ way, -miss[1] @ way])
    along = np.array(misses)
    assert np.abs(along.mean(axis=0)).max() < 0.005 + 4 * 0.009 / math.sqrt(len(along))
    assert np.abs(along).max() < 0.05


def test_a_neighbour_three_diameters_off_does_not_pull_either():
    """Without noise, for it is a matter of a few thousandths of a pixel."""
    rng, pulls = np.random.default_rng(3), []
    for _ in range(12):
        angle = rng.uniform(0, 2 * math.pi)
        way = np.array([math.cos(angle), math.sin(angle)])
        one = np.array([80.0, 80.0]) + rng.uniform(-0.5, 0.5, 2)
        centres = np.array([one, one + 45 * way])
        seen = CAM_LAMP.glint_of_centre(CAM_LAMP.unproject(centres)[0])
        picture = np.full((160, 200), 8.5)
        for glint, centre, second in zip(
            seen, centres, locate_secondary_glints(CAM_LAMP, seen, seen[::-1]), strict=True
        ):
            picture += 1500 * spot(picture.shape, *glint, 1.0) + 80 * spot(picture.shape, *second, 1.0)
            picture += 4 * disc(picture.shape, *centre, 7.44)
        blank = np.full((160, 200), 8.0)
        shown = clip(np.rint([blank, picture, blank]).clip(0, 255).astype(np.uint8), CAM_LAMP)
        found = detect(shown, make_view(shown)).glints
        miss = found.xy[np.argsort(np.hypot(*(found.xy - seen[0]).T))] - seen
        pulls += [miss[0] @ way, -miss[1] @ way]
    assert abs(np.mean(pulls)) < 0.0015


CAM_LAMP = Camera.from_dict(CAMERA)


def test_two_balls_two_detections_through_a_collision():
    frames = film(np.random.default_rng(5), collision(60, speed=2.5))
    shown = clip(frames)
    found = detect(shown, make_view(shown)).glints
    assert np.bincount(found.frame, minlength=60).tolist() == [2] * 60
    assert set(assign_track_numbers(found, CAM).tolist()) == {0, 1}


def test_a_neighbour_takes_the_learnt_profile_from_no_clipped_glint():
    """Beside another ball clipped glints are known as well as alone, and are where they say."""
    paths, stds, misses = collision(60, speed=2.5), [], []
    for seed in range(4):
        shown = clip(film(np.random.default_rng(seed), paths, peak=700.0, profile=14.0))
        found = detect(shown, make_view(shown)).glints
        off = found.xy[:, None] - paths[found.frame]
        pick = np.argmin(np.hypot(*np.moveaxis(off, 2, 0)), axis=1)
        std = np.sqrt(np.trace(found.cov, axis1=1, axis2=2) / 2)
        near = (found.flags & PositionFlag.NEAR) > 0
        stds.append([np.median(std[near]), np.median(std[~near])])
        misses.append((off[np.arange(len(off)), pick] / std[:, None])[near])
    beside, alone = np.mean(stds, axis=0)
    assert beside < 1.02 * alone
    z = np.concatenate(misses)
    assert abs(z.std() - 1) < 4 / math.sqrt(2 * z.size)
    assert np.abs(z.mean(axis=0)).max() < 4 / math.sqrt(len(z))


def mirrored_sky(camera, centre, shape):
    """cos of the angle from the zenith, of what each pixel's ray meets by a ball at ``centre`` (2,) m; 0 elsewhere."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    way = np.stack([columns - camera.K[0, 2], rows - camera.K[1, 2], np.full(shape, camera.K[0, 0])], axis=-1)
    way = way @ camera.R / np.linalg.norm(way, axis=-1, keepdims=True)
    offset = camera.position - np.array([*centre, camera.radius])
    half = way @ offset
    root = half**2 - (offset @ offset - camera.radius**2)
    normal = (offset + way * (-half - np.sqrt(np.maximum(root, 0)))[..., None]) / camera.radius
    up = way[..., 2] - 2 * np.sum(way * normal, axis=-1) * normal[..., 2]
    return np.where(root > 0, np.clip(up, 0, None), 0)


def test_far_from_the_axis_the_profile_pulls_no_clipped_glint():
    """Without noise: balls seen at a slant, that mirror a sky brightest overhead."""
    data = copy.deepcopy(CAMERA)
    data["K"][0][2], data["K"][1][2] = -300.0, -250.0
    camera, rng = Camera.from_dict(data), np.random.default_rng(8)
    frames, true = [np.full((160, 200), 8, np.uint8)], []
    for _ in range(40):
        centre = camera.unproject(np.array([[100.0, 80.0]]) + rng.uniform(-20, 20, 2))[0]
        glint = camera.glint_of_centre(centre)[0]
        picture = 8.5 + 14 * gaussian_filter(mirrored_sky(camera, centre[0], (160, 200)), 1.0)
        picture += 700 * 2 * math.pi * spot(picture.shape, *glint, 1.0)
        frames.append(np.rint(picture).clip(0, 255).astype(np.uint8))
        true.append(glint)
    shown = clip(np.array([*frames, frames[0]]), camera)
    off = detect(shown, make_view(shown)).glints.xy - np.array(true)
    assert np.abs(off.mean(axis=0)).max() < 0.0008


def test_hot_pixels_are_no_balls_and_pull_none():
    rng = np.random.default_rng(11)
    paths = collision(60, speed=3.0)
    frames = film(rng, paths)
    on_the_way = np.rint(paths[::4, 1]).astype(int) + rng.integers(-2, 3, (15, 2))
    x, y = np.concatenate([on_the_way, rng.integers(5, 155, (25, 2))]).T
    lone = np.hypot(x - 100, y - 80) > 8  # not under the ball at rest
    x, y = x[lone], y[lone]
    leak = np.zeros(frames.shape[1:], np.int64)
    leak[y, x] = rng.integers(15, 90, len(x))
    frames = np.clip(frames + leak, 0, 255).astype(np.uint8)
    view = make_view(clip(frames))
    assert set((y * 200 + x).tolist()) <= set(view.plate.hot.tolist())
    found = detect(clip(frames), view).glints
    assert np.bincount(found.frame, minlength=60).tolist() == [2] * 60
    assert (found.flags & PositionFlag.MISFIT).sum() == 0
    for k in range(60):
        own = found.xy[found.frame == k]
        assert max(np.hypot(*(own - position).T).min() for position in paths[k]) < 0.06


@pytest.mark.parametrize("level", [0, 3, 250])
def test_empty_frames_have_nothing(level):
    rng = np.random.default_rng(6)
    frames = np.array([expose(rng, np.full((160, 200), float(level))) for _ in range(20)])
    shown = clip(frames)
    assert len(detect(shown, make_view(shown)).glints) == 0


def test_a_profile_without_its_glint_is_no_glint():
    rng = np.random.default_rng(7)
    picture = np.full((160, 200), 0.5) + 20 * disc((160, 200), 80.2, 70.3, 7.44)
    frames = np.array([expose(rng, np.full((160, 200), 0.5))] * 8 + [expose(rng, picture) for _ in range(12)])
    shown = clip(frames)
    assert len(detect(shown, make_view(shown)).glints) == 0


def test_sixteen_bit_frames():
    rng = np.random.default_rng(8)
    data = {**CAMERA, "sensor": {**CAMERA["sensor"], "bits": 12, "gain": 2.0, "read_noise": 4.0, "full_well": 1e5}}
    camera = Camera.from_dict(data)
    pictures = []
    for k in range(12):
        picture = np.full((160, 200), 3.0) + 2500 * 2 * math.pi * spot((160, 200), 60.25 + 5 * k, 80.4, 1.0)
        pictures.append(expose(rng, picture, gain=2.0, read=4.0, black=8.0, bits=12))
    shown = clip(np.array(pictures), Camera.from_dict({**data, "exposure": 0.0}))
    found = detect(shown, make_view(shown)).glints
    miss = found.x - (60.25 + 5 * np.arange(12))
    assert np.abs(miss).max() < 4 * np.sqrt(found.cov[:, 0, 0]).min() < 0.03
    assert camera.sensor.ceiling == 4095


def test_every_detector_keeps_the_promise():
    """One contract over all that the folder holds."""
    frames = film(np.random.default_rng(10), collision(12, contact=30.0, speed=2.0))
    shown = clip(frames)
    view = make_view(shown)
    assert {"maximum_likelihood", "centroid"} <= set(list_detectors())
    for name, make in list_detectors().items():
        if name.startswith("trackpy") and importlib.util.find_spec("trackpy") is None:
            continue
        if find_detected_point(name, shown.camera) == "centre":  # looks for outlines that move, where these are glints
            continue
        one = make(view)(frames[3])
        if name == "trackpy_defaults":  # which finds all that it can, untold
            assert len(one) >= 2
            continue
        assert len(one) == 2, name
        assert one.cov.shape == (2, 2, 2)
        assert (np.linalg.eigvalsh(one.cov) > 0).all()
        whole = detect(shown, view, name).glints
        assert sorted(whole.frame.tolist()) == sorted([*range(12)] * 2)


def test_outsiders_come_by_entry_point(monkeypatch):
    class Point:
        name = "outsider"

        def load(self):
            return lambda view: None

    monkeypatch.setattr(detect_module, "entry_points", lambda group: [Point()] if group == "tracker.detectors" else [])
    assert "outsider" in list_detectors()
    with pytest.raises(InputError, match=r"expected one of .*maximum_likelihood.*outsider"):
        detect_module.load_detector("nobody")


def promised(**wrong):
    """A detector that finds two glints in every frame, with some of its arrays wrong."""
    right = {
        "frame": np.zeros(2, np.int64), "x": np.array([50.0, 90.0]), "y": np.array([60.0, 70.0]),
        "cov": np.tile(1e-4 * np.eye(2), (2, 1, 1)), "flux": np.ones(2), "background": np.ones(2),
        "flags": np.zeros(2, np.int64),
    }  # fmt: skip
    return lambda view: lambda frame: Glints(**right | wrong)


@pytest.mark.parametrize(
    ("finder", "said"),
    [
        (lambda view: lambda frame: [(50.0, 60.0)], "returned list, expected Glints"),
        (promised(cov=np.eye(2)), r"cov has shape \(2, 2\), expected \(2, 2, 2\)"),
        (promised(cov=np.full((2, 2), 1e-4)), r"cov has shape \(2, 2\), expected \(2, 2, 2\)"),
        (promised(y=np.array([60.0])), r"y has shape \(1,\), expected \(2,\) for 2 glints"),
        (promised(frame=np.zeros(3, np.int64)), r"frame has shape \(3,\), expected \(2,\)"),
        (promised(x=50.0), r"frame has shape \(2,\), expected \(1,\) for 1 glints"),
        (promised(x=np.array([50.0, np.nan])), "x holds NaN or infinity"),
        (promised(cov=np.full((2, 2, 2), np.nan)), "cov holds NaN or infinity"),
        (promised(cov=np.zeros((2, 2, 2))), "cov holds a variance of zero or less"),
    ],
)
def test_a_detector_that_returns_something_else_is_named(monkeypatch, finder, said):
    monkeypatch.setattr(detect_module, "list_detectors", lambda: {"outsider": finder})
    shown = clip(np.zeros((9, 160, 200), np.uint8))
    with pytest.raises(InputError, match=rf"^detector outsider, frame 0: {said}") as error:
        detect(shown, make_view(shown), "outsider")
    assert "\n" not in str(error.value)
