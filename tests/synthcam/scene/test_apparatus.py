"""The settings of camera, lamp, surface and sensor are those of the rendering and of camera.json."""

import numpy as np
import pytest

from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError

SET = {
    "camera": {"defocus_px": 2.0, "f_number": 8, "pixel_pitch": 4e-6, "vignetting": 0.2, "shutter": "rolling"},
    "lamp": {
        "shape": "ring",
        "radius": 0.1,
        "inner": 0.05,
        "facing": "centre",
        "flicker": {"depth": 0.1, "frequency": 120},
        "second": {"position": [-0.1, 0.1, 0.4], "radiance": 0.5},
    },
    "surface": {"steel": "iron", "roughness": 0.01, "plate_shadow": True},
    "sensor": {"bits": 12, "hot_pixels": 0.001},
}


def clip_of(settings):
    return check_scene({"name": "a"} | settings, "a.yaml").draw(0, 0)


def test_the_objects_are_as_set():
    clip = clip_of(SET)
    assert (clip.camera.defocus_px, clip.camera.vignetting, clip.camera.line_time) == (2.0, 0.2, 1e-5)
    assert clip.camera.airy_px == pytest.approx(5.5e-7 * 8 / 4e-6)
    assert (clip.lamp.shape, clip.lamp.inner, clip.lamp.flicker.frequency) == ("ring", 0.05, 120)
    np.testing.assert_array_equal(clip.lamp.towards, np.zeros(3))
    assert clip.lamp.second is not None
    assert clip.lamp.second.radiance == 0.5
    assert clip.surface.steel == (2.95, 2.93)
    assert clip.surface.plate_shadow
    assert clip_of({"surface": {"steel": [1.5, 3.0]}}).surface.steel == (1.5, 3.0)
    plain = clip_of({})
    assert (plain.camera.airy_px, plain.camera.line_time, plain.lamp.towards) == (0, 0, None)


def test_camera_json_holds_what_is_known_and_no_more():
    told, plain = clip_of(SET).camera_json, clip_of({}).camera_json
    assert told["psf"] == {
        "sigma_px": 1.0,
        "defocus_px": 2.0,
        "f_number": 8.0,
        "pixel_pitch": 4e-6,
        "wavelength": 5.5e-7,
    }
    assert told["shutter"] == {"kind": "rolling", "line_time": 1e-5}
    assert told["lens"] == {"vignetting": 0.2}
    assert told["lamp"]["shape"] == "ring"
    assert told["lamp"]["second"]["radiance"] == 0.5
    assert told["surface"] == {"steel": "iron", "roughness": 0.01, "plate_shadow": True}
    assert told["sensor"]["hot_pixels"] == 0.001
    assert "room" not in told["lamp"]
    assert "glint_peak" not in told["sensor"]
    assert not {"shutter", "lens", "surface"} & set(plain)
    assert set(plain["lamp"]) == {"position", "radius"}
    assert "hot_pixels" not in plain["sensor"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lamp": {"shape": "ring"}}, r"lamp\.inner: expected"),
        ({"lamp": {"shape": "bar", "length": 0.1}}, r"lamp\.length, width: expected"),
        ({"camera": {"shutter": "slow"}}, r"camera\.shutter: "),
        ({"lamp": {"flicker": {"depth": 2.0}}}, r"lamp\.flicker\.depth: "),
        ({"surface": {"steel": "gold"}}, r"surface\.steel: "),
    ],
)
def test_what_cannot_be_is_refused_by_name(settings, message):
    with pytest.raises(InputError, match=message):
        clip_of(settings)


def test_any_of_it_may_be_drawn():
    lamp, camera = {"flicker": {"phase": {"uniform": [0, 6]}}}, {"defocus_px": {"uniform": [0, 2]}}
    scene = check_scene({"lamp": lamp, "camera": camera}, "a")
    clips = [scene.draw(k, 0) for k in range(2)]
    assert clips[0].lamp.flicker.phase != clips[1].lamp.flicker.phase
    assert clips[0].camera.defocus_px != clips[1].camera.defocus_px
