"""The chip against exact distributions: Poisson and normal, folded here, and EMVA's photon transfer."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from synthcam.camera import sensor as module
from synthcam.camera.exposure import Picture
from synthcam.camera.sensor import Sensor, SensorChip

SIZE = (320, 200)
EVEN = {"prnu": 0.0, "dsnu": 0.0}


def flat(level, boxes=()):
    plate = np.full(SIZE[::-1], level, np.float32)
    return Picture(plate, boxes, tuple(plate[box] for box in boxes))


def shares(mean, sensor):
    """Probability of every count for that mean number of electrons."""
    n = np.arange(stats.poisson.ppf(1e-15, mean), stats.poisson.ppf(1 - 1e-15, mean) + 1)
    charge, weight = np.minimum(n, sensor.full_well), stats.poisson.pmf(n, mean)
    edges = (np.arange(2**sensor.bits - 1) + 0.5 - sensor.black_level) * sensor.gain
    below = stats.norm.cdf((edges[:, None] - charge) / max(sensor.read_noise, 1e-9)) @ weight
    return np.diff(np.r_[0, below, 1])


def misfit(counts, share):
    """p of chi squared, rare counts pooled."""
    seen = np.bincount(counts.ravel(), minlength=len(share)).astype(float)
    want = share * counts.size
    common = want > 10
    seen, want = np.r_[seen[common], seen[~common].sum()], np.r_[want[common], want[~common].sum()]
    keep = want > 1
    return stats.chi2.sf(((seen - want)[keep] ** 2 / want[keep]).sum(), keep.sum() - 1)


CASES = {
    "contract": (Sensor(**EVEN), 0.001),
    "bright plate": (Sensor(**EVEN), 0.02),
    "no read noise": (Sensor(gain=1, read_noise=0, black_level=0, glint_peak=4000, **EVEN), 0.001),
    "little read noise": (Sensor(gain=0.5, read_noise=0.4, black_level=4, glint_peak=8000, **EVEN), 0.001),
    "12 bits": (Sensor(bits=12, gain=2, read_noise=5, black_level=64, **EVEN), 0.1),
    "dark current": (Sensor(dark=1e5, **EVEN), 0.0),
    "full wells": (Sensor(full_well=150, gain=4, read_noise=6, **EVEN), 0.2),
    "clipped below": (Sensor(black_level=0, **EVEN), 0.001),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("path", ["plate", "boxes", "pixels"])
def test_counts_have_the_exact_distribution(name, path):
    sensor, level = CASES[name]
    chip = SensorChip(sensor, SIZE, 5e-4, root_seed=1)
    everything = ((slice(None), slice(None)),) if path != "plate" else ()
    picture = flat(level, everything)
    if path == "pixels":
        picture = replace(picture, changed=np.arange(0, picture.plate.size, 2))
    counts = np.stack([chip.expose(picture, 0, k) for k in range(12)])
    mean = np.float32(level) * sensor.glint_peak * sensor.gain + sensor.dark * 5e-4
    assert misfit(counts, shares(mean, sensor)) > 1e-4
    # Controls: noise 2 % too large, or the mean off by 2 % of its spread, would be seen.
    if sensor.read_noise > 1 and name != "full wells":
        spread = np.hypot(sensor.read_noise, np.sqrt(mean))
        louder = Sensor(**vars(sensor) | {"read_noise": sensor.read_noise * 1.03})
        assert misfit(counts, shares(mean, louder)) < 1e-4
        assert misfit(counts, shares(mean + 0.02 * spread, sensor)) < 1e-4


def test_a_normal_in_place_of_poisson_would_be_seen():
    sensor, level = CASES["little read noise"]
    mean = level * sensor.glint_peak * sensor.gain
    rng = np.random.default_rng(2)
    electrons = rng.normal(mean, np.hypot(np.sqrt(mean), sensor.read_noise), (12, *SIZE))
    assert misfit(module.digitise(electrons / sensor.gain + sensor.black_level, 8), shares(mean, sensor)) < 1e-9


@pytest.mark.parametrize("read_noise", [0.0, 0.5, 20.0])
def test_tables_follow_the_exact_quantiles_into_the_tails(read_noise):
    mean = 7.3
    body, tails = module.tabulate_noise(mean, read_noise)

    def below(x):
        n = np.arange(0, 90)
        return stats.norm.cdf((x[:, None] - n) / read_noise) @ stats.poisson.pmf(n, mean)

    cells = np.array([0, 1, 20, 30000, 65000, 65535])
    fine = np.array([3, 100, 30000, 65000])
    if read_noise:
        np.testing.assert_allclose(below(body[cells]) * 65536, cells + 0.5, rtol=0.02, atol=0.02)
        np.testing.assert_allclose(below(tails[0][fine]) * 65536**2, fine + 0.5, rtol=0.02)
        # The last cell counts from the top, so that the far tail keeps its digits.
        np.testing.assert_allclose((1 - below(tails[1][fine[1:]])) * 65536**2, fine[1:] + 0.5, rtol=0.02)
    else:
        np.testing.assert_array_equal(body[cells], stats.poisson.ppf((cells + 0.5) / 65536, mean))
        np.testing.assert_array_equal(tails[0][fine], stats.poisson.ppf((fine + 0.5) / 65536**2, mean))
        np.testing.assert_array_equal(tails[1][fine], stats.poisson.isf((fine + 0.5) / 65536**2, mean))


def test_the_far_tail_is_drawn():
    """16 random bits alone would end at 4.2 sigma."""
    sensor = Sensor(bits=16, gain=0.01, read_noise=20, black_level=30000, full_well=1e9, **EVEN)
    chip = SensorChip(sensor, (1000, 1000), 5e-4, root_seed=3)
    plate = np.zeros((1000, 1000), np.float32)
    picture = Picture(plate, (), ())
    far = sum(int((np.abs(chip.expose(picture, 0, k).astype(float) - 30000) > 4.5 * 2000).sum()) for k in range(8))
    expected = 8e6 * 2 * stats.norm.sf(4.5)
    assert abs(far - expected) < 5 * np.sqrt(expected)


def test_photon_transfer_gives_the_gain_back():
    """EMVA 1288: the variance of counts against their mean is a line of slope 1/gain; offset read^2/gain^2 + 1/12."""
    sensor = Sensor(bits=12, gain=4.0, read_noise=10, black_level=50, full_well=1e5, glint_peak=3000)
    chip = SensorChip(sensor, SIZE, 5e-4, root_seed=4)
    means, variances = [], []
    for k, level in enumerate([0.0, 0.1, 0.25, 0.5, 0.9]):
        pair = [chip.expose(np.full(SIZE[::-1], level), k, frame).astype(float) for frame in range(2)]
        means.append(np.mean(pair) - 50)
        variances.append(np.var(pair[1] - pair[0]) / 2)  # a difference drops the fixed pattern
    slope, offset = np.polyfit(means, variances, 1)
    assert 1 / slope == pytest.approx(sensor.gain, rel=0.01)
    assert offset == pytest.approx((sensor.read_noise / sensor.gain) ** 2 + 1 / 12, rel=0.1)


def test_the_fixed_pattern_is_that_of_the_camera():
    sensor = Sensor(bits=12, gain=1, prnu=0.02, dsnu=30, read_noise=5, black_level=500, glint_peak=2000, full_well=1e5)
    chip = SensorChip(sensor, SIZE, 5e-4, root_seed=5)

    def mean_image(chip, level, clip):
        return np.mean([chip.expose(flat(level), clip, k) for k in range(40)], axis=0)

    dark = mean_image(chip, 0.0, 0)
    assert dark.std() == pytest.approx(30, rel=0.03)
    lit = np.mean([chip.expose(np.full(SIZE[::-1], 1.0), 1, k) for k in range(40)], axis=0)
    assert (lit - dark).std() / (lit - dark).mean() == pytest.approx(0.02, rel=0.05)
    assert np.corrcoef(dark.ravel(), mean_image(chip, 0.0, 7).ravel())[0, 1] > 0.99
    other = SensorChip(sensor, SIZE, 5e-4, root_seed=6)
    assert abs(np.corrcoef(dark.ravel(), mean_image(other, 0.0, 0).ravel())[0, 1]) < 0.02


def test_an_uneven_plate_is_drawn_with_each_pixels_own_noise():
    sensor = Sensor(bits=12, gain=1, read_noise=2, black_level=20, glint_peak=1000, full_well=1e5, **EVEN)
    chip = SensorChip(sensor, SIZE, 5e-4, root_seed=8)
    plate = np.tile(np.linspace(0.075, 0.1, SIZE[0], dtype=np.float32), (SIZE[1], 1))
    counts = np.stack([chip.expose(Picture(plate, (), ()), 0, k) for k in range(30)]).astype(float)
    for column in (0, 100, 319):
        mean = float(plate[0, column]) * 1000
        here = counts[:, :, column]
        assert here.mean() - 20 == pytest.approx(mean, abs=5 * np.sqrt((mean + 4) / here.size))
        assert here.var() == pytest.approx(mean + 4 + 1 / 12, rel=5 * np.sqrt(2 / here.size))


def test_noise_does_not_depend_on_the_order_of_frames():
    chip = SensorChip(Sensor(), SIZE, 5e-4, root_seed=9)
    asked = (3, 4, 3, 90, 40, 41, 2)
    for frame, counts in zip(asked, [chip.expose(flat(0.001), 1, k) for k in asked], strict=True):
        alone = SensorChip(Sensor(), SIZE, 5e-4, root_seed=9).expose(flat(0.001), 1, frame)
        np.testing.assert_array_equal(counts, alone)


def test_noise_depends_on_seed_clip_and_frame_alone():
    chip = SensorChip(Sensor(), SIZE, 5e-4, root_seed=9)
    box = ((slice(20, 60), slice(30, 90)),)
    first = chip.expose(flat(0.001, box), 3, 4)
    chip.expose(flat(0.5), 1, 1)
    np.testing.assert_array_equal(first, chip.expose(flat(0.001, box), 3, 4))
    np.testing.assert_array_equal(first, SensorChip(Sensor(), SIZE, 5e-4, root_seed=9).expose(flat(0.001, box), 3, 4))
    others = [chip.expose(flat(0.001, box), 4, 3), chip.expose(flat(0.001, box), 3, 5)]
    others += [SensorChip(Sensor(**EVEN), SIZE, 5e-4, root_seed=10).expose(flat(0.001, box), 3, 4)]
    for other in others:
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.1
    zero = SensorChip(Sensor(), SIZE, 5e-4, root_seed=0)
    assert (zero.expose(flat(0.001), 0, 0) != chip.expose(flat(0.001), 0, 0)).any()


def test_saturation_and_types():
    chip = SensorChip(Sensor(), SIZE, 5e-4, root_seed=11)
    assert (chip.expose(np.full(SIZE[::-1], 5.0), 0, 0) == 255).all()
    full = SensorChip(Sensor(bits=10, full_well=6000, read_noise=0, dsnu=0), SIZE, 5e-4, root_seed=11)
    assert (full.expose(np.full(SIZE[::-1], 5.0), 0, 0) == 308).all()  # 6000 e- / 20 + 8
    for bits, kind, top in ((6, np.uint8, 63), (8, np.uint8, 255), (10, np.uint16, 1023), (16, np.uint16, 65535)):
        chip = SensorChip(Sensor(bits=bits, gain=1, read_noise=1, black_level=2 * top), SIZE, 5e-4, root_seed=12)
        counts = chip.expose(flat(0.001), 0, 0)
        assert counts.dtype == kind
        assert (counts == top).all()


def test_hot_pixels_leak_their_share():
    hot = {"hot_pixels": 0.02, "hot_dark": 1e6}
    sensor = Sensor(bits=16, gain=1, read_noise=2, black_level=100, full_well=1e6, **hot, **EVEN)
    chip = SensorChip(sensor, SIZE, 5e-4, root_seed=13)
    mean = np.mean([chip.expose(flat(0.001), 0, k) for k in range(20)], axis=0) - 100
    usual = np.median(mean)
    leaking = mean > usual + 5
    assert leaking.mean() == pytest.approx(0.02, rel=0.1)
    assert (mean[leaking] - usual).mean() == pytest.approx(500, rel=0.1)  # 1e6 e-/s for half a millisecond
    again = np.mean([chip.expose(flat(0.001), 7, k) for k in range(20)], axis=0) - 100
    np.testing.assert_array_equal(leaking, again > usual + 5)
    boxed = chip.expose(flat(0.001, ((slice(0, 90), slice(0, 320)),)), 0, 0).astype(float) - 100
    assert boxed[leaking].mean() == pytest.approx(mean[leaking].mean(), rel=0.05)
    cool = chip.expose(flat(0.5), 0, 0).astype(float)
    assert cool[leaking].mean() - cool[~leaking].mean() == pytest.approx(500, rel=0.1)


def test_plates_in_changing_light_keep_their_tables(monkeypatch):
    monkeypatch.setattr(module, "MAX_TABLES", 4)
    chip = SensorChip(Sensor(), SIZE, 5e-4, root_seed=14)
    plates = [np.full(SIZE[::-1], level, np.float32) for level in (0.02, 0.03)]
    first = [chip.expose(Picture(p, (), ()), 0, k) for k, p in enumerate(plates)]
    kept = list(chip._backgrounds)
    again = [chip.expose(Picture(p.copy(), (), ()), 0, k) for k, p in enumerate(plates)]
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert chip._backgrounds == kept
    for level in np.linspace(0.02, 0.05, 8):
        chip.expose(flat(level), 1, 0)
    assert 1 < sum(len(b.groups) for b in chip._backgrounds) <= 4


@pytest.mark.parametrize("bits", [8, 12])
def test_frames_exposed_together_are_those_exposed_alone(bits):
    """Plates in changing light, one too bright for tables, hot pixels, balls in boxes and in lists of pixels."""
    sensor = Sensor(bits=bits, hot_pixels=0.002, hot_dark=2e6)
    chip, other = (SensorChip(sensor, SIZE, 5e-4, root_seed=21) for _ in range(2))
    box, listed = (slice(20, 60), slice(30, 90)), np.arange(500, 900, 3)
    pictures = [flat(0.001, (box,)), flat(0.001), flat(0.02, (box,)), flat(3.0, (box,)), flat(0.001, (box,))]
    pictures += [replace(flat(0.001, (box,)), changed=listed)]
    frames = [0, 1, 4, 5, 6, 9]
    together = chip.expose_film(pictures, 2, frames)
    assert len({counts.tobytes() for counts in together}) == len(frames)
    for counts, picture, frame in zip(together, pictures, frames, strict=True):
        np.testing.assert_array_equal(counts, other.expose(picture, 2, frame))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("full", [0, 1, 63, 64, 65, 900])
def test_saturated_pixels_are_found_however_many_there_are(kind, full):
    counts, top = np.zeros((30, 40), kind), np.iinfo(kind).max
    counts.flat[np.random.default_rng(full).permutation(1200)[:full]] = top
    np.testing.assert_array_equal(module._find_saturated(counts), np.flatnonzero(counts == top))


def test_without_read_noise_a_black_part_of_the_plate_shows_its_offset():
    sensor = Sensor(read_noise=0.0)
    chip, plate = SensorChip(sensor, SIZE, 5e-4, root_seed=16), np.zeros(SIZE[::-1], np.float32)
    plate[:, 100:] = np.linspace(0, 0.1, SIZE[0] - 100)
    counts = chip.expose(Picture(plate, (), ()), 0, 0)
    np.testing.assert_array_equal(counts[:, :100], np.rint(8 + chip.offset[:, :100] / 20))


@pytest.mark.parametrize(("bits", "black"), [(8, 8.0), (8, 0.0), (8, 252.0), (10, 8.0), (10, 1021.0)])
def test_each_random_number_selects_its_cell_and_the_outer_ones_a_second_number(bits, black):
    """Without light: the table's counts, looked up one after the other, also among many zeros or full counts."""
    size, gain, read = (257, 131), 20.0 / (1 + 3 * (bits > 8)), 20.0
    sensor = Sensor(bits=bits, gain=gain, black_level=black, prnu=0.0, read_noise=read)
    chip, plate = SensorChip(sensor, size, 5e-4, root_seed=15), np.zeros(size[::-1], np.float32)
    middle, outer = (np.float32(table / gain) for table in module.tabulate_noise(0.0, read))
    level = np.float32(chip.offset / gain + black).ravel()
    second_numbers = 0
    for frame in range(12):
        rng = module._generator(15, (4, 1, frame))
        cells = rng.bit_generator.random_raw(-(-level.size // 4)).view("<u2")[: level.size]
        noise, rare = middle[cells], np.flatnonzero((cells == 0) | (cells == 65535))
        noise[rare] = outer[(cells[rare] > 0).astype(int), rng.integers(0, 65536, len(rare))]
        wanted = np.clip(np.rint(noise + level), 0, 2**bits - 1).reshape(plate.shape)
        np.testing.assert_array_equal(chip.expose(Picture(plate, (), ()), 4, frame), wanted)
        second_numbers += len(rare)
    assert second_numbers > 4
