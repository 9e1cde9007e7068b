"""A camera file from a film alone: scale, width and noise come back within the errors it claims, and gaps are named."""

import json
import re
from dataclasses import replace

import av
import numpy as np
import pytest
import tifffile
import tracker_discs
from scipy.ndimage import gaussian_filter
from tracker_film import collision, disc, expose, film, spot, write_clip
from tracker_video import encode

from synthcam_shared.errors import InputError
from tracker.calibration import calibrate as calibration
from tracker.calibration.ball_outline import measure_outline
from tracker.calibration.calibrate import average_contact_distances, calibrate, keys_from_options, summarise_calibration
from tracker.camera.camera import Camera
from tracker.detection import contact_distance
from tracker.detection.candidates import EmptyPlate
from tracker.detection.contact_distance import contact_distances
from tracker.detection.glints import Glints
from tracker.detection.link import Tracks

DIAMETER = 2.38e-3


def stack(folder, frames):
    tifffile.imwrite(folder / "film.tif", frames, imagej=True)
    return folder / "film.tif"


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """One film of a hit, 14.875 px a diameter, with glints 1.2 px wide; the contact is in view."""
    folder = tmp_path_factory.mktemp("film")
    frames = film(np.random.default_rng(0), collision(60, contact=25.3, speed=2.5), sigma=1.2, profile=0.0)
    return calibrate(stack(folder, frames), keys_from_options(DIAMETER, 250.0, 5e-4))


def test_scale_from_the_contact_is_within_its_error(told):
    assert told.scale_from == "contact"
    true = DIAMETER / 14.875
    assert told.scale_std / true < 0.004
    assert abs(told.camera.scale - true) < 3 * told.scale_std


def measured(rng, noise, slow=0.0, lasting=np.inf):
    """Tracks of a hit with that much noise, px; then the struck ball slows by ``slow`` px a frame^2, for a time."""
    n, contact = 30, 13 + rng.random()
    paths = collision(n, contact, speed=2.5, angle=6.28 * rng.random(), offset=0.5 - rng.random())
    after = np.maximum(np.arange(n) - contact, 0.0)[:, None]
    way = paths[-1, 0] - paths[0, 0]
    fast = np.minimum(after, lasting)
    paths[:, 0] -= slow * (fast * after - 0.5 * fast**2) * way / np.hypot(*way)
    positions = paths.transpose(1, 0, 2).reshape(-1, 2) + noise * rng.standard_normal((2 * n, 2))
    nothing = np.full(2 * n, np.nan)
    return Tracks(
        np.tile(np.arange(n), 2), np.repeat([0, 1], n), positions[:, 0], positions[:, 1],
        np.tile(noise**2 * np.eye(2), (2 * n, 1, 1)), np.ones(2 * n), np.full(2 * n, ""), nothing, nothing,
    )  # fmt: skip


@pytest.mark.parametrize("slow", [0.0, 0.05])
def test_error_of_the_contact_is_honest(slow):
    rng = np.random.default_rng(5)
    found = [contact_distances(measured(rng, 0.03, slow)) for _ in range(60)]
    z = np.array([(t.distance - 14.875) / t.std for each in found for t in each])
    assert len(z) == 60
    assert abs(z.mean()) < 4 / np.sqrt(60)
    assert 0.75 < z.std() < 1.3
    assert max(t.std for each in found for t in each) < 0.15


def test_every_hit_of_a_long_film_counts():
    """The same two balls, rolled again: as many contacts, and one at a wrong distance is no part of the mean."""
    rng = np.random.default_rng(8)
    hits = [measured(rng, 0.03) for _ in range(3)]
    columns = {name: np.concatenate([getattr(hit, name) for hit in hits]) for name in Tracks.__dataclass_fields__}
    columns["frame"] = columns["frame"] + np.repeat(30 * np.arange(3), 60)
    found = contact_distances(Tracks(**columns))
    assert [int(contact.instant // 30) for contact in found] == [0, 1, 2]
    each = [(contact.distance, contact.std) for contact in found]
    mean, std = average_contact_distances([*each, *each, (17.0, 0.05)])
    assert abs(mean - 14.875) < 4 * std < 0.3


def test_contacts_of_noise_in_the_first_look_do_not_hide_the_true_one(tmp_path, monkeypatch):
    """The first look takes noise for contacts; with the size that these give, the second finds none."""
    path = stack(
        tmp_path, film(np.random.default_rng(0), collision(24, contact=10.3, speed=2.5), sigma=1.2, profile=0.0)
    )
    whole, sizes = calibration.survey_sizes, []

    def survey(source, known, detector, sized, index):
        sizes.append(DIAMETER / known["scale"])
        found = whole(source, known, detector, sized, index)
        wrong = [contact_distance.ContactDistance(60.0, 0.1, 10.0)] if len(sizes) == 1 else []
        return replace(found, contact_distances=wrong) if len(sizes) < 3 else found

    monkeypatch.setattr(calibration, "survey_sizes", survey)
    found = calibrate(path, keys_from_options(DIAMETER, 250.0, 5e-4))
    assert np.allclose(sizes, [sizes[0], 60.0, sizes[0]])
    assert abs(found.camera.scale - DIAMETER / 14.875) < 3 * found.scale_std


def test_short_tracks_of_noise_cost_no_search_for_contacts(monkeypatch):
    """A dark lossy film has hundreds of them: all pairs of all tracks took minutes."""
    hit, looked_at = measured(np.random.default_rng(8), 0.03), []
    rows = np.concatenate([np.arange(60), *(np.arange(k, k + 7) for k in range(20))])
    columns = {name: getattr(hit, name)[rows] for name in Tracks.__dataclass_fields__}
    columns["particle"] = np.concatenate([hit.particle, np.repeat(np.arange(2, 22), 7)])
    whole = contact_distance._nearest
    monkeypatch.setattr(contact_distance, "_nearest", lambda *given: looked_at.append(given) or whole(*given))
    assert contact_distances(Tracks(**columns)) == contact_distances(hit)
    assert len(looked_at) == 2  # the two balls, with the specks and without


@pytest.mark.gate
def test_an_encoded_film_is_calibrated_by_its_contacts(tmp_path, capfd, monkeypatch):
    """H.264 smooths the plate and breaks up outlines: the scale comes from two hits, in a few passes."""
    rng = np.random.default_rng(6)
    rolls = [collision(30, contact=13.3, speed=2.5, angle=angle, centre=(95, 80)) for angle in (0.4, 2.0)]
    frames = np.concatenate([film(rng, paths) for paths in rolls])
    codes = np.rint(16 + frames * (219 / 255)).astype(np.uint8)
    path = encode(tmp_path / "film.mp4", codes, rate=250, options={"crf": "23"})
    opened = []
    monkeypatch.setattr(av, "open", lambda path, whole=av.open: opened.append(path) or whole(path))
    found = calibrate(path, keys_from_options(DIAMETER, 250.0))
    assert found.scale_from == "contact"
    assert found.scale_std / found.camera.scale < 0.03
    assert abs(found.camera.scale - DIAMETER / 14.875) < 3 * found.scale_std
    assert any("an encoder has changed the outlines" in line for line in found.missing)
    assert len(opened) <= 6
    assert capfd.readouterr() == ("", "")


@pytest.mark.gate
def test_clips_count_alike_in_whatever_order_they_are_looked_at(tmp_path, monkeypatch):
    """Two of three clips say how glints look; the third is looked at with what they say, by one process or two."""
    monkeypatch.setattr("tracker.calibration.calibrate.MAX_ROUGH_CLIPS", 2)
    for k, angle in enumerate((0.4, 2.0, 3.9)):
        home = tmp_path / "films" / "clips" / f"{k:06d}"
        home.mkdir(parents=True)
        paths = collision(12, contact=5.3, speed=2.5, angle=angle, centre=(95, 80))
        tifffile.imwrite(
            home / "frames.tif", film(np.random.default_rng(k), paths, sigma=1.2, profile=0.0), imagej=True
        )
    steps, contacts, mean = list[tuple[int, int]](), list[int](), calibration.average_contact_distances
    monkeypatch.setattr(calibration, "average_contact_distances", lambda each: contacts.append(len(each)) or mean(each))
    films, given = tmp_path / "films", keys_from_options(DIAMETER, 250.0, 5e-4)
    found = calibrate(films, given, progress=lambda *at: steps.append(at))
    assert steps == [(k, 5) for k in range(1, 6)]
    assert contacts[-1] == 3  # one of each clip
    assert abs(found.camera.scale - DIAMETER / 14.875) < 3 * found.scale_std
    assert found.to_dict() == calibrate(films, given, workers=2).to_dict()


def test_balls_that_pass_each_other_do_not_touch():
    time = np.arange(30.0)
    paths = np.stack([np.column_stack([2.0 * time, 0 * time]), np.column_stack([60 - 2.0 * time, 20 + 0 * time])])
    nothing = np.full(60, np.nan)
    tracks = Tracks(
        np.tile(np.arange(30), 2), np.repeat([0, 1], 30), paths[..., 0].ravel(), paths[..., 1].ravel(),
        np.tile(1e-4 * np.eye(2), (60, 1, 1)), np.ones(60), np.full(60, ""), nothing, nothing,
    )  # fmt: skip
    assert contact_distances(tracks) == []


def test_width_and_noise(told):
    assert told.camera.sigma == pytest.approx(1.2, rel=0.04)
    sensor = told.camera.sensor
    assert sensor.read_noise / sensor.gain == pytest.approx(1.0, rel=0.1)
    assert sensor.black_level == pytest.approx(8.5, abs=1)


def test_what_was_not_found_is_said(told):
    text = "\n".join(summarise_calibration(told))
    assert "no outline is bright enough" in text
    assert "lamp" in text
    assert "height" in text
    assert "exposure" not in text
    assert text.count("+-") == 1


def test_the_file_is_a_camera_file_that_assumes_no_more_than_it_must(told, tmp_path):
    told.write(tmp_path / "camera.json")
    camera = Camera.read(tmp_path / "camera.json")
    assert (camera.scale, camera.scale_std) == (told.camera.scale, told.scale_std)
    assert {"lamp", "height"} <= set(camera.assumed)
    assert not {"scale", "psf.sigma_px", "sensor.gain", "sensor.read_noise"} & set(camera.assumed)
    note = json.loads((tmp_path / "camera.json").read_text())["calibration"]
    assert note["scale_std"] == told.scale_std
    told.write(tmp_path / "camera.json")  # its own work may be made anew
    (tmp_path / "mine.json").write_text("{}")
    with pytest.raises(InputError, match="was not made by tracker calibrate"):
        told.write(tmp_path / "mine.json")


def rolling(radius, body):
    """Frames of one ball with a bright profile, blurred as its glint is, and its glints."""
    rng = np.random.default_rng(int(radius))
    frames, n = [], 40
    x, y = 60.0 + 1.63 * np.arange(n), 80.0 + 0.31 * np.arange(n)
    for k in range(n):
        picture = gaussian_filter(body * disc((160, 200), x[k], y[k], radius), 1.0)
        frames.append(expose(rng, picture + 0.5 + 150 * 2 * np.pi * spot((160, 200), x[k] + 0.4, y[k], 1.0)))
    ones = np.ones(n)
    return np.array(frames), Glints(
        np.arange(n), x + 0.4, y, np.tile(np.eye(2), (n, 1, 1)), ones, ones, 0 * np.arange(n)
    )


PLATE = EmptyPlate(np.full((160, 200), 8, np.uint8), 1.04)


@pytest.mark.parametrize("radius", [12.0, 16.0])
def test_outline_of_a_bright_ball(radius):
    """No contact is needed: what a ball mirrors of the room ends at .71 of its radius."""
    frames, glints = rolling(radius, 30.0)
    found = measure_outline(frames, PLATE, glints, 1.0)
    assert found is not None
    assert found.std < 0.05 * radius
    assert abs(found.radius - radius) < 3 * found.std


@pytest.mark.parametrize(("radius", "body"), [(5.0, 30.0), (9.0, 30.0), (12.0, 0.0)])
def test_no_outline_under_the_glint_or_in_the_dark(radius, body):
    frames, glints = rolling(radius, body)
    assert measure_outline(frames, PLATE, glints, 1.0) is None


def test_no_contact_and_no_outline_is_no_scale(tmp_path):
    paths = np.stack([np.column_stack([20 + 3.0 * np.arange(20), np.full(20, 80.3)])], axis=1)
    write_clip(tmp_path / "clip", film(np.random.default_rng(1), paths, profile=0.0))
    result = calibrate(tmp_path / "clip", keys_from_options(DIAMETER, 250.0))
    assert result.scale_from == ""
    with pytest.raises(InputError, match="no two balls are seen to hit"):
        result.write(tmp_path / "camera.json")
    assert not (tmp_path / "camera.json").exists()


def drawn(folder, seed=4, **look):
    """A hit of two discs, 18.6 px a diameter, as a stack of 8 bits."""
    ways = tracker_discs.collision(60)
    return stack(folder, tracker_discs.film(np.random.default_rng(seed), ways, **look).astype(np.uint8))


def test_the_scale_of_discs_is_that_of_their_hit_and_of_their_outlines(tmp_path):
    """Nothing is said of glints, lamps or the sensor."""
    found = calibrate(drawn(tmp_path), keys_from_options(0.0186, 60.0, 1e-3))
    assert found.scale_from == "contact"
    assert abs(found.camera.scale / 1e-3 - 1) < 3 * found.scale_std / 1e-3 < 0.005
    assert abs(found.ways["outline"][0] / 1e-3 - 1) < 0.001  # the half brightness of a blurred disc lies further in
    text = "\n".join(summarise_calibration(found))
    assert not re.search("lamp|glint|sensor", text)
    found.write(tmp_path / "camera.json")
    written = json.loads((tmp_path / "camera.json").read_text())
    assert {"psf", "sensor"}.isdisjoint(written)
    assert Camera.from_dict(written).diameter_px == pytest.approx(18.6, rel=0.005)


@pytest.mark.gate
def test_discs_in_noise_are_seen(tmp_path):
    """25 counts over a plate with 6 of noise a pixel: they were taken for glints, with a scale twice too large."""
    found = calibrate(drawn(tmp_path, ball=95.0, noise=6.0), keys_from_options(0.0186, 60.0, 1e-3))
    assert abs(found.camera.scale / 1e-3 - 1) < 3 * found.scale_std / 1e-3 < 0.08


def test_a_shift_that_lasts_hides_no_bend():
    """Errors of which the greater part is alike in all frames: a slow-down in the window must still be noticed."""
    shaded = []
    for seed in range(40):
        tracks = measured(np.random.default_rng(seed), 0.02, slow=0.3, lasting=3.5)
        own = np.tile(0.12**2 * np.eye(2), (len(tracks), 1, 1))
        words = np.full(len(tracks), "shaded")
        shaded += contact_distances(replace(tracks, cov=tracks.cov + own, fixed=own, flags=words))
    off = np.array([(t.distance - 14.875) / t.std for t in shaded])
    assert len(off) >= 30
    assert np.sqrt(np.mean(off**2)) < 1
