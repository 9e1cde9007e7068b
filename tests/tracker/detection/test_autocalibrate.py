"""Values that the camera file omits are estimated from the film, with a note."""

import gc
import weakref

import numpy as np
import pytest
from tracker_film import CAMERA, collision, film

from tracker.camera.camera import Camera
from tracker.camera.recordings import Frames, Recording
from tracker.detection import autocalibrate
from tracker.detection.detect import detect, make_view
from tracker.detection.likelihood import glint_fit


def shown(frames, without, **changed):
    data = {k: v for k, v in CAMERA.items() if k not in without} | changed
    camera = Camera.from_dict(data)
    return Recording(0, camera, Frames(len(frames), frames.shape[1:], frames.dtype, lambda k: frames[k]))


@pytest.mark.parametrize("sigma", [0.8, 1.0, 1.5])
def test_width_of_the_glints(sigma):
    frames = film(np.random.default_rng(0), collision(40, contact=18.3, speed=3.0), sigma=sigma)
    view = make_view(shown(frames, {"psf", "lamp"}))
    assert view.sigma == pytest.approx(sigma, rel=0.03)
    assert "psf.sigma_px" in view.camera.assumed


@pytest.mark.parametrize(("gain", "read", "black"), [(20.0, 20.0, 8.0), (5.0, 12.0, 20.0), (70.0, 50.0, 3.0)])
def test_noise_of_the_sensor(gain, read, black):
    """Sensors quieter and noisier than the one from which the estimate starts."""
    paths = collision(40, contact=18.3, speed=3.0)
    frames = film(np.random.default_rng(1), paths, peak=220.0, gain=gain, read=read, black=black)
    view = make_view(shown(frames, {"sensor"}, sensor={"bits": 8}))
    sensor = view.camera.sensor
    assert sensor.black_level == pytest.approx(black + 0.5, abs=1)
    assert sensor.gain == pytest.approx(gain, rel=0.35)
    assert sensor.read_noise / sensor.gain == pytest.approx(read / gain, rel=0.1)
    assert {"sensor.gain", "sensor.read_noise", "sensor.black_level"} <= set(view.camera.assumed)


def test_fits_with_other_settings_take_few_steps(monkeypatch):
    """They start at fitted positions. From the middles of the pixels each took seven steps."""
    done = []

    def counted(whole):
        return lambda *given, **named: done.append(whole) or whole(*given, **named)

    fit, step = autocalibrate.fit_glints, glint_fit._compare
    monkeypatch.setattr(autocalibrate, "fit_glints", counted(fit))
    monkeypatch.setattr(glint_fit, "_compare", counted(step))
    frames = film(np.random.default_rng(0), collision(40, contact=18.3, speed=3.0))
    make_view(shown(frames, {"psf", "lamp", "sensor"}, sensor={"bits": 8}))
    assert 40 < done.count(fit) < 100
    assert done.count(step) < 4 * done.count(fit)


def test_no_windows_of_a_film_are_kept(monkeypatch):
    """They would stay in the memory of a server, or of a batch of films."""
    begin, kept = autocalibrate._start_at_glints, []

    def start(*words):
        windows = begin(*words)
        kept.append(weakref.ref(windows))
        return windows

    monkeypatch.setattr(autocalibrate, "_start_at_glints", start)
    make_view(shown(film(np.random.default_rng(0), collision(40, contact=18.3, speed=3.0)), {"psf", "lamp"}))
    gc.collect()
    assert [reference() for reference in kept] == [None]


def test_twelve_bits_in_sixteen_are_known_by_their_ceiling():
    rng = np.random.default_rng(5)
    frames = np.minimum(film(rng, collision(20, contact=8.3, speed=3.0)).astype(np.uint16) * 20, 4095)
    view = make_view(shown(frames, {"sensor"}))
    assert view.camera.sensor.ceiling == 4095
    assert make_view(shown(frames, {"sensor"}, sensor={"bits": 14})).camera.sensor.bits == 14


def test_what_is_given_is_left_alone():
    frames = film(np.random.default_rng(2), collision(20, contact=8.3, speed=3.0))
    clip = shown(frames, set())
    assert make_view(clip).camera.to_dict() == clip.camera.to_dict()


@pytest.mark.parametrize(
    ("sensor", "sigma", "diameter"),
    [({}, 1.0, 14.875), pytest.param({"gain": 6.0, "read": 9.0, "black": 15.0}, 1.5, 26.0, marks=pytest.mark.gate)],
)
def test_errors_stay_honest_with_estimated_noise_and_width(sensor, sigma, diameter):
    """With no ball_diameter in the file either, which stands for nothing but the size of a search."""
    rng = np.random.default_rng(3)
    paths = collision(60, contact=25.3, speed=2.5, diameter=diameter)
    frames = film(rng, paths, exposure_share=1e-9, sigma=sigma, **sensor)
    clip = shown(frames, {"psf", "lamp", "ball_diameter"}, sensor={"bits": 8}, exposure=0.0)
    found = detect(clip, make_view(clip)).glints
    assert len(found) == 120
    truth = np.array(
        [min(paths[k], key=lambda p: np.hypot(*(p - xy))) for k, xy in zip(found.frame, found.xy, strict=True)]
    )
    z = np.linalg.solve(np.linalg.cholesky(found.cov), (found.xy - truth)[..., None])[..., 0]
    assert 0.8 < z.std() < 1.25


def test_a_clip_that_shows_nothing_gets_defaults():
    rng = np.random.default_rng(4)
    frames = np.clip(8 + rng.normal(0, 1, (12, 160, 200)), 0, 255).astype(np.uint8)
    view = make_view(shown(frames, {"psf", "sensor"}))
    assert view.sigma == pytest.approx(1.0, rel=0.01)


def test_what_an_encoder_leaves_out_is_found_beside_glints_where_the_film_is_encoded():
    """Pixels around a glint are off by 4 counts, those of the plate by one half: no sensor does that."""
    rng = np.random.default_rng(4)
    paths = collision(60, contact=25.3, speed=2.5)
    frames = film(rng, paths, exposure_share=1e-9, gain=200.0, read=80.0).astype(float)
    for k, balls in enumerate(paths):
        for x, y in balls.round().astype(int):
            if 8 <= x < 192 and 8 <= y < 152:
                frames[k, y - 8 : y + 8, x - 8 : x + 8] += 4.0 * rng.standard_normal((16, 16))
    frames = np.clip(frames.round(), 0, 255).astype(np.uint8)
    for lossy in (True, False):
        clip = shown(frames, set())
        clip.frames.lossy = lossy
        sensor = make_view(clip).camera.sensor
        assert sensor.codec_noise == (pytest.approx(4.0, rel=0.15) if lossy else 0.0)
    clip = shown(frames, {"psf", "lamp"}, sensor={"bits": 8}, exposure=0.0)
    clip.frames.lossy = True
    found = detect(clip, make_view(clip)).glints
    truth = np.array(
        [min(paths[k], key=lambda p: np.hypot(*(p - xy))) for k, xy in zip(found.frame, found.xy, strict=True)]
    )
    z = np.linalg.solve(np.linalg.cholesky(found.cov), (found.xy - truth)[..., None])[..., 0]
    assert 0.7 < z.std() < 1.3
    assert np.allclose(found.fixed, found.cov / 2, rtol=0.4)  # of what rests the encoder leaves out much the same
