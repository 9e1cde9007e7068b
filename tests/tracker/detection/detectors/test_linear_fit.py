"""The errors that linear fits claim in films of crowds, whose frames show too many balls for a full fit of each."""

import functools

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.special import ndtr

from synthcam import Scene
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import make_recording
from tracker.detection.detect import detect, load_detector, make_view
from tracker.detection.glints import PositionFlag


def read_errors(clip, detector):
    """Errors (n, 2) of the glints of a film, px, over their claimed errors and by themselves."""
    recording = make_recording(0, wrap_frames(clip.film()), Camera.from_dict(clip.camera_json))
    found = detect(recording, make_view(recording, detector), detector).glints
    true = clip.tracks[clip.tracks.visible]
    shift = true[["x_mean_px", "y_mean_px"]].to_numpy() - true[["x_px", "y_px"]].to_numpy()
    glint = np.column_stack([1e4 * true.frame, true[["glint_x_px", "glint_y_px"]].to_numpy() + shift])
    apart, nearest = cKDTree(np.column_stack([1e4 * found.frame, found.xy])).query(glint)
    seen = apart < 1
    assert seen.mean() > 0.98
    off = found.xy[nearest[seen]] - glint[seen, 1:]
    return off / np.sqrt(found.cov[nearest[seen]][:, [0, 1], [0, 1]]), off


@pytest.mark.parametrize(
    ("scene", "frames", "changes"),
    [
        pytest.param("crowd", 20, {}, id="balls of 15 px", marks=pytest.mark.gate),
        pytest.param("cooling", 5, {}, id="balls of 24 px"),
        pytest.param("crowd", 20, {"camera": {"scale": 2.6e-4}}, id="balls of 9 px", marks=pytest.mark.gate),
        pytest.param("crowd", 20, {"timing": {"exposure": 3e-3}}, id="glints that move by three widths"),
    ],
)
def test_errors_have_the_size_that_is_claimed(scene, frames, changes):
    clip = Scene.read(scene, **{**changes, "timing": {"frames": frames, **changes.get("timing", {})}}).draw(seed=5)
    z, _ = read_errors(clip, "linear_fit")
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.08)
    assert np.sqrt((z**2).mean(axis=0)).max() < 1.12
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.02)


def test_light_of_neighbours_shifts_no_glint():
    """Balls of 9 px: the errors of centroids are half as large again."""
    clip = Scene.read("crowd", camera={"scale": 2.6e-4}, timing={"frames": 20}).draw(seed=5)
    (z, fit), (_, centroid) = (read_errors(clip, name) for name in ("linear_fit", "centroid"))
    assert np.sqrt((fit**2).mean()) < 0.012
    assert np.sqrt((centroid**2).mean()) > 1.4 * np.sqrt((fit**2).mean())
    shifted = np.abs(fit - centroid) > 0.02
    assert shifted.sum() > 100
    assert np.sqrt((z[shifted] ** 2).mean()) == pytest.approx(1.0, abs=0.09)


@functools.cache
def make_crowd_view():
    """The view of a film of noise with the camera of `crowd`, whose balls have 15 px."""
    camera = Camera.from_dict(Scene.read("crowd").draw().camera_json)
    noise = np.random.default_rng(1).integers(7, 10, (9, 480, 640)).astype(np.uint8)
    return make_view(make_recording(0, wrap_frames(noise), camera), "linear_fit")


def draw_smear(at, length, direction, counts, sigma):
    """A picture (480, 640) of a spot of so many counts that moves straight through `at` by so many px."""
    edges, picture = np.arange(641) - 0.5, np.full((480, 640), 8.0)
    for off in np.linspace(-length / 2, length / 2, 61):
        middle = at + off * np.array(direction)
        x, y = (np.diff(ndtr((edges - k) / sigma)) for k in middle)
        picture += counts / 61 * y[:480, None] * x
    return picture


@pytest.mark.parametrize("blur", [0.0, 3.0])
def test_a_spot_on_a_tilted_plane_of_light_is_where_it_is(blur):
    """Without noise the fit removes at least four fifths of the shift of a centroid."""
    at, view = np.array([60.3, 40.6]), make_crowd_view()
    picture = draw_smear(at, blur, (0.8, 0.6), 900, view.sigma)
    rows, columns = np.indices(picture.shape)
    body = np.hypot(columns - at[0], rows - at[1]) < 7
    picture += np.where(body, 20 + columns - at[0] + (rows - at[1]) / 2, 0.0)
    fit, centroid = (
        load_detector(name)(view)(np.rint(picture).astype(np.uint8)) for name in ("linear_fit", "centroid")
    )
    off = np.hypot(*(centroid.xy[0] - at))
    assert off > 0.05
    assert np.hypot(*(fit.xy[0] - at)) < 0.2 * off


@pytest.mark.parametrize("length", [10, 14, 18, 26, 30, 36])
@pytest.mark.parametrize("direction", [(0.8, 0.6), (0.28, -0.96)])
def test_a_long_smear_is_at_its_middle_or_has_the_error_of_one_that_no_window_holds(length, direction):
    """The largest window has 23 px. Positions of longer smears were 20 to 60 claimed errors off."""
    at, view = np.array([200.3, 140.6]), make_crowd_view()
    picture = draw_smear(at, length, direction, 200 * length, view.sigma)
    noise = np.random.default_rng(4).uniform(-1.5, 1.5, picture.shape)
    found = load_detector("linear_fit")(view)(np.rint(picture + noise).clip(0, 255).astype(np.uint8))
    off = found.xy - at
    assert len(found)
    if length < 20:
        assert len(found) == 1
        assert np.hypot(*off[0]) < 0.15
        assert not found.flags[0] & PositionFlag.MISFIT
    else:
        assert (np.abs(off) < 3 * np.sqrt(found.cov[:, [0, 1], [0, 1]])).all()
        assert (found.flags & PositionFlag.MISFIT).all()
