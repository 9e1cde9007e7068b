"""Films of a camera with an altered clock, shutter or lens, against each law written out; its file stays nominal."""

import numpy as np
import pytest

from synthcam.scene.ground_truth import make_true_tracks
from synthcam.scene.scene import Scene, check_scene

FPS = 250.0


def clip_of(**effects):
    settings = {"launch": {"v0": 0.4, "b": 0.3, "heading": 1.0}, "timing": {"frames": 60, "contact_frame": 20}}
    return check_scene(settings | {"effects": effects}, "x").draw(0, 0)


PLAIN = clip_of()


def pixels(clip):
    view = clip.view
    return view.camera.project(view.at(np.arange(60) / FPS)[..., :3])


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("scale_error", {"e": 1e-3}),
        ("aspect_error", {"e": 2e-3}),
        ("lens_distortion", {"k1": 0.1}),
        ("camera_tilt", {"x": 5e-3, "y": -3e-3}),
        ("clock_error", {"e": 1e-2}),
        ("clock_drift", {"e": 0.05}),
        ("dropped_frame", {"lost": 1.0, "frame": 30.0}),
        ("exposure_blur", {"longer": 1e-3}),
        ("rolling_shutter", {"line": 1e-5}),
    ],
)
def test_the_camera_file_stays_nominal(name, values):
    clip = clip_of(**{name: values})
    assert clip.camera_json == PLAIN.camera_json
    base, bent = (make_true_tracks(c.launch.bodies, c.view, c.lamp, 60) for c in (PLAIN, clip))
    moved = np.abs(bent[["x_mean_px", "y_mean_px"]] - base[["x_mean_px", "y_mean_px"]]).to_numpy().max()
    assert moved > 0.01


def test_scale_and_aspect_stretch_the_picture_about_its_middle():
    middle = np.array([319.5, 239.5])
    base = pixels(PLAIN) - middle
    np.testing.assert_allclose(pixels(clip_of(scale_error={"e": 0.01})) - middle, 1.01 * base, rtol=0, atol=1e-9)
    stretched = pixels(clip_of(aspect_error={"e": 0.01})) - middle
    np.testing.assert_allclose(stretched, base * [1.005, 0.995], rtol=0, atol=1e-9)


def test_lens_distortion_is_opencvs():
    focal = PLAIN.camera.K[0, 0]
    base = (pixels(PLAIN) - [319.5, 239.5]) / focal
    square = (base**2).sum(axis=-1, keepdims=True)
    bent = (pixels(clip_of(lens_distortion={"k1": 0.7})) - [319.5, 239.5]) / focal
    np.testing.assert_allclose(bent, base * (1 + 0.7 * square), rtol=0, atol=1e-12)


def test_a_turned_camera_keeps_its_position_and_aim():
    clip = clip_of(camera_tilt={"x": 5e-3, "y": -3e-3})
    np.testing.assert_allclose(clip.camera.centre, clip.nominal.centre, rtol=0, atol=1e-12)
    np.testing.assert_allclose(clip.camera.project([0, 0, 0]), clip.nominal.project([0, 0, 0]), rtol=0, atol=1e-9)
    turn = clip.camera.R @ clip.nominal.R.T
    assert np.arccos((np.trace(turn) - 1) / 2) == pytest.approx(np.hypot(5e-3, 3e-3), rel=1e-4)
    points = np.array([[0.04, 0, 0], [-0.04, 0, 0]])  # the keystone: one side is nearer than the other
    width = [np.ptp(c.project(points)[:, 0]) for c in (clip.camera, clip.nominal)]
    assert width[0] != pytest.approx(width[1], rel=1e-7)


@pytest.mark.parametrize(
    ("name", "values", "law"),
    [
        ("clock_error", {"e": 0.02}, lambda t: 1.02 * t),
        ("clock_drift", {"e": 0.1}, lambda t: t * (1 + 0.1 * t)),
        ("dropped_frame", {"lost": 2.0, "frame": 30.0}, lambda t: t + np.where(t > 29.5 / FPS, 2 / FPS, 0)),
    ],
)
def test_frames_are_taken_when_the_law_says(name, values, law):
    view, film = clip_of(**{name: values}).view, np.arange(60) / FPS
    np.testing.assert_allclose(view.times(film), np.tile(law(film), (2, 1)), rtol=0, atol=1e-12)
    plain = PLAIN.view.motion
    inside = law(film) < plain.t1
    np.testing.assert_allclose(view.at(film)[:, inside], plain.at(law(film)[inside]), rtol=0, atol=1e-11)


def test_a_rolling_shutter_takes_each_ball_in_its_own_row():
    view, film = clip_of(rolling_shutter={"line": 2e-5}).view, np.arange(60) / FPS
    times = view.times(film)
    for ball in (0, 1):
        rows = view.camera.project(view.motion.at(times[ball])[ball][:, :3])[:, 1]
        np.testing.assert_allclose(times[ball], film + 2e-5 * rows, rtol=0, atol=1e-12)
    assert np.abs(times[0] - times[1]).max() > 1e-4


def test_the_shutter_stays_open_longer():
    clip = clip_of(exposure_blur={"longer": 1e-3})
    spans = clip.view.spans(60)
    np.testing.assert_allclose(spans, np.arange(60)[:, None] / FPS + [0, 1.5e-3], rtol=0, atol=1e-15)
    assert clip_of(exposure_blur={"longer": -1e-3}).camera.exposure == 0.0


@pytest.mark.parametrize("effects", [{}, {"rolling_shutter": {"line": 2e-5}}, {"clock_drift": {"e": 0.1}}])
def test_means_are_split_at_every_kink(effects):
    """Also where a bent clock moves the kink to another film time: against ten thousand instants."""
    clip = clip_of(**effects)
    view = clip.view
    for film in (view.breaks()[:, None] + [-1.3e-3, 0.7e-3]).tolist():
        instants = film[0] + (np.arange(10000) + 0.5) / 10000 * (film[1] - film[0])
        mean = view.mean(np.array([film]), lambda s: s[..., :2])[:, 0]
        np.testing.assert_allclose(mean, view.at(instants)[..., :2].mean(axis=1), rtol=0, atol=2e-11)


def test_a_hit_on_the_last_wall_is_a_break_of_its_ball_alone():
    """The number of a wall is no number of a ball: a ball alone that hits wall 3."""
    walls = [{"start": [-x, y], "end": [x, y]} for x, y in ((0.05, -0.02), (0.06, -0.03), (0.07, -0.04))]
    walls.append({"start": [0.02, -0.02], "end": [0.02, 0.02]})
    scene = Scene.build(launches=[{"position": [0.0, 0.0], "velocity": [0.3, 0.0]}], walls=walls)
    view = scene.draw().view
    (hit,) = (event for event in view.motion.events if event.kind == "wall")
    assert hit.j == 3
    np.testing.assert_array_equal(view.breaks(), [event.t for event in view.motion.events])


@pytest.mark.parametrize("name", ["glint_parallax", "pixel_locking"])
def test_a_trackers_defect_is_refused_in_one_line(name):
    values = {"share": 1.0} if name == "glint_parallax" else {"amplitude": 0.05}
    with pytest.raises(ValueError, match=rf"^x: effects\.{name}: a defect of trackers, expected none in a scene$"):
        clip_of(**{name: values})
    clip_of(**{name: dict.fromkeys(values, 0.0)})  # absent


def test_those_defects_act_on_what_is_measured():
    model = PLAIN.model.replace({"glint_parallax.share": 0.5, "pixel_locking.amplitude": 0.1})
    px = np.array([[10.25, 20.5], [3.0, 4.75]])
    seen = px + 0.5 * np.array([0.4, -0.2])  # half of the way to the glint; then drawn to the middles
    expected = seen - 0.1 * np.sin(2 * np.pi * seen)
    np.testing.assert_allclose(
        model.laws("measure", px, {"glint": lambda x: x + np.array([0.4, -0.2])}), expected, rtol=1e-14
    )
