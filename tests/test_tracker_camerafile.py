"""camera.json beyond the plain camera: what is used is right, what is not is said, what is nonsense is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tracker.estimate import measure
from tracker.geometry import Camera, InputError
from tracker_film import CAMERA
from tracker_noisy import NOISE, dataset, noisy, scalars_of, truth_of


def camera(**sections):
    return Camera.from_dict({**CAMERA, **{k: CAMERA.get(k, {}) | v for k, v in sections.items()}}, "camera.json")


def test_what_does_not_matter_is_not_mentioned():
    plain = camera()
    other = camera(
        lens={"vignetting": 0.3},
        lamp={"facing": "centre", "flicker": {"depth": 0.2, "frequency": 100, "phase": 0}},
        surface={"steel": "iron", "plate_gloss": 0.1, "plate_texture": 0.1, "plate_shadow": True},
        sensor={"hot_pixels": 1e-4, "hot_dark": 1e6},
        shutter={"kind": "global"},
    )
    assert other.to_dict() == plain.to_dict()
    assert other.unmodelled == ()


@pytest.mark.parametrize(
    ("section", "keys"),
    [
        ("psf", {"defocus_px": 2.0}),
        ("psf", {"f_number": 8.0, "pixel_pitch": 5e-6, "wavelength": 5.5e-7}),
        ("surface", {"roughness": 0.02}),
        ("surface", {"scratches": 0.3, "scratch_slope": 0.1}),
    ],
)
def test_what_widens_a_glint_has_its_width_measured(section, keys):
    known = camera(**{section: keys})
    assert known.psf_sigma is None
    assert "psf.sigma_px" in known.assumed
    assert known.unmodelled == (
        f"{section}.{next(iter(keys))}: glints are taken as Gaussian, as wide as they are seen",
    )
    assert camera(**{section: dict.fromkeys(keys, 0)}).psf_sigma == 1.0


def spread(points):
    """Standard deviation, m, of a lamp's points along an axis, the mean of both axes."""
    return math.sqrt(points.var(axis=0).mean())


def test_rings_and_bars_are_as_wide_as_their_light():
    rng = np.random.default_rng(0)
    square = rng.uniform(-1, 1, (400_000, 2))
    reach = np.hypot(*square.T)
    lamps = {
        "disc": ({"radius": 0.03}, 0.03 * square[reach < 1]),
        "ring": ({"radius": 0.03, "inner": 0.02}, 0.03 * square[(reach < 1) & (reach > 2 / 3)]),
        "bar": ({"length": 0.1, "width": 0.02, "angle": 0.4}, square * [0.05, 0.01]),
    }
    for shape, (keys, points) in lamps.items():
        lamp = camera(lamp={"shape": shape, **keys}).lamp
        assert lamp.radius / 2 == pytest.approx(spread(points), rel=0.005)
    assert "lamp.shape bar" in camera(lamp={"shape": "bar", "length": 0.1, "width": 0.02}).unmodelled[0]


def test_a_second_lamp_is_said_to_be_left_out():
    second = {"position": [-0.1, 0, 0.4], "radius": 0.01, "radiance": 1.0}
    assert "lamp.second" in camera(lamp={"second": second}).unmodelled[0]


@pytest.mark.parametrize(
    ("section", "keys", "said"),
    [
        ("shutter", {"kind": "sideways"}, "shutter.kind"),
        ("shutter", {"kind": "rolling"}, "shutter.line_time"),
        ("shutter", {"kind": "rolling", "line_time": -1e-5}, "shutter.line_time"),
        ("lamp", {"shape": "star"}, "lamp.shape"),
        ("lamp", {"shape": "ring", "inner": -1}, "lamp.inner"),
        ("psf", {"defocus_px": "much"}, "psf.defocus_px"),
        ("surface", {"roughness": math.nan}, "surface.roughness"),
    ],
)
def test_nonsense_is_refused_by_its_key(section, keys, said):
    with pytest.raises(InputError, match=f"camera.json: {said}: expected"):
        camera(**{section: keys})


def test_a_rolling_shutter_is_accounted_for(tmp_path):
    """Each row later than the one above: speeds down and up the picture differ by a per cent if that is left out."""
    settings = {
        "camera": {"shutter": "rolling", "line_time": 8e-6},
        "launch": {"v0": 0.3, "b": 0.1, "heading": {"uniform": [1.0, 2.0]}},
    }
    data = dataset(tmp_path / "data", settings, 4)
    used, left_out = [], []
    for clip in range(4):
        truth, known = truth_of(data, clip)
        assert Camera.from_dict(known.to_dict()).line_time == known.line_time == 8e-6
        true = scalars_of(data).iloc[clip]
        for scores, model in ((used, known), (left_out, replace(known, line_time=0.0))):
            (row,) = measure(noisy(truth, np.random.default_rng(clip), NOISE), model)
            scores.append([(row[q] - true[q]) / row[f"{q}_std"] for q in ("v0", "t_c", "r", "tau1", "v1f")])
    assert np.abs(used).max() < 4
    assert np.abs(left_out).max() > 30
