"""The reference implementation of EMVA 1288 (the `emva1288` package, an extra) measures the sensor that was set."""

import numpy as np
import pytest

from synthcam.camera.exposure import Picture
from synthcam.camera.sensor import Sensor, SensorChip

pytest.importorskip("emva1288")

SENSOR = Sensor(bits=12, gain=4.0, read_noise=10, black_level=60, dsnu=6, prnu=0.01, full_well=1e5, glint_peak=3000)
SIZE, EXPOSURE, STACK = (400, 300), 5e-4, 60


def stack(chip, level, clip, frames):
    """Compute what the package keeps of frames: their sum, and its integer form of their variance."""
    from emva1288.process.routines import get_int_imgs

    plate = np.full(SIZE[::-1], level, np.float32)
    picture = plate if level else Picture(plate, (), ())  # drawn pixel by pixel, or from tables
    return get_int_imgs([chip.expose(picture, clip, k) for k in range(frames)])


def measured(sensor):
    from emva1288.process.data import Data1288
    from emva1288.process.results import Results1288

    chip = SensorChip(sensor, SIZE, EXPOSURE, root_seed=1)
    temporal, spatial = {}, {}
    for clip, level in enumerate(np.linspace(0, 0.9, 13)):
        pair = stack(chip, level, clip, 2)
        temporal[level * 1e4] = pair | {"sum": pair["sum"].sum(), "pvar": pair["pvar"].sum()}
    for clip, level in ((100, 0.0), (101, 0.5)):
        spatial[level * 1e4] = stack(chip, level, clip, STACK)
    data = {"width": SIZE[0], "height": SIZE[1], "temporal": {EXPOSURE: temporal}, "spatial": {EXPOSURE: spatial}}
    found = Results1288(Data1288(data).data, index_u_ysat=11)
    return {
        "gain": 1 / found.K,
        "read_noise": found.sigma_d,
        "dsnu": found.DSNU1288,
        "prnu": found.PRNU1288 / 100,
        "linear": found.LE_max,
    }


@pytest.fixture(autouse=True)
def asfarray(monkeypatch):
    """The package's release 1.0.2 asks numpy for what numpy 2 has dropped."""
    monkeypatch.setattr(np, "asfarray", lambda a: np.asarray(a, float), raising=False)


def test_the_package_finds_what_was_set():
    found = measured(SENSOR)
    for name in ("gain", "read_noise", "dsnu", "prnu"):
        assert found[name] == pytest.approx(getattr(SENSOR, name), rel=0.02), name
    assert abs(found["linear"]) < 0.2  # %


def test_it_would_see_three_percent_more():
    names = ("gain", "read_noise", "dsnu", "prnu")
    found = measured(Sensor(**vars(SENSOR) | {name: 1.03 * getattr(SENSOR, name) for name in names}))
    for name in names:
        assert found[name] > 1.02 * getattr(SENSOR, name), name
