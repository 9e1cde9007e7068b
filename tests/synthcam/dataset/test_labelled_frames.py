"""Frames without end: they are those of a dataset, whichever worker makes them, in whichever order."""

import itertools

import numpy as np
import pytest
from synthcam_stub import SCENE, film, make

import synthcam
from synthcam.scene.clip import Clip
from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError

SMALL = {"camera": {"size": [64, 48], "scale": 3e-4}, "timing": {"frames": 7, "contact_frame": 3}}
ROLLING = SMALL | {"camera": SMALL["camera"] | {"shutter": "rolling"}, "lamp": {"flicker": {"depth": 0.2}}}
MATTE = SMALL | {"surface": {"ball": "matte"}}


def named(frames):
    return [(frame.clip.number, frame.frame) for frame in frames]


@pytest.fixture
def dots(monkeypatch):
    monkeypatch.setattr(Clip, "pictures", film)
    return check_scene(SCENE, "s.yaml")


def test_a_stream_gives_the_clips_of_a_dataset(dots, tmp_path, monkeypatch):
    dataset = synthcam.open_dataset(make(tmp_path / "d", monkeypatch, clips=2, seed=5))
    clips = list(synthcam.stream(dots, seed=5, stop=2, by="clip"))
    assert [len(frames) for frames in clips] == [20, 20]
    for recorded, frames in zip(dataset, clips, strict=True):
        assert {frame.clip.number for frame in frames} == {recorded.number}
        assert frames[0].clip.camera_json == recorded.camera_json
        np.testing.assert_array_equal([frame.image for frame in frames], np.asarray(recorded.film()))
        radius, (width, height) = recorded.diameter_px / 2, recorded.camera_json["size"]
        reach_x, reach_y = width / 2 + radius, height / 2 + radius
        for k, rows in recorded.tracks.groupby("frame"):
            off = rows[["x_px", "y_px"]] - np.array([width - 1, height - 1]) / 2
            rows = rows[(off.x_px.abs() < reach_x) & (off.y_px.abs() < reach_y)]  # a part is in the picture
            assert frames[k].ids.tolist() == rows.particle.tolist()
            np.testing.assert_array_equal(frames[k].centres, rows[["x_mean_px", "y_mean_px"]])
            assert frames[k].visible.tolist() == rows.visible.tolist()


def test_workers_share_the_clips(dots):
    """Worker i of n takes each n-th clip, and makes what one worker makes."""
    one = list(synthcam.stream(dots, stop=5, every=8))
    assert named(one) == [(clip, frame) for clip in range(5) for frame in (0, 8, 16)]
    parts = [synthcam.stream(dots, start=i, step=2, stop=5, every=8) for i in (0, 1)]
    shared = sorted(itertools.chain(*parts), key=lambda frame: (frame.clip.number, frame.frame))
    assert named(shared) == named(one)
    for a, b in zip(one, shared, strict=True):
        for name in ("image", "ids", "centres", "boxes", "labels"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)
    endless = synthcam.stream(dots, start=12_345, step=4, every=20)
    assert named(itertools.islice(endless, 3)) == [(12_345, 0), (12_349, 0), (12_353, 0)]


@pytest.mark.parametrize("settings", [ROLLING, MATTE], ids=["rolling shutter, flicker", "matte"])
def test_frames_that_are_left_out_change_no_other(settings):
    clip = check_scene(settings, "s").draw(1, 4)
    np.testing.assert_array_equal(list(clip.pictures(3)), clip.film()[::3])
    few = list(synthcam.stream(check_scene(settings, "s"), 4, 1, stop=2, every=3))
    centres = clip.tracks.set_index(["frame", "particle"])[["x_mean_px", "y_mean_px"]]
    assert [frame.frame for frame in few] == [0, 3, 6]
    for frame in few:
        np.testing.assert_array_equal(frame.centres, centres.loc[[(frame.frame, ball) for ball in frame.ids]])


def test_masks_are_the_labels_of_each_ball(dots):
    frame = next(synthcam.stream(dots, seed=2))
    assert frame.masks.shape == (2, 64, 128)
    for mask, centre, box in zip(frame.masks, frame.centres, frame.boxes, strict=True):
        rows, columns = np.nonzero(mask)
        assert np.hypot(columns.mean() - centre[0], rows.mean() - centre[1]) < 0.3
        assert (np.abs([columns.min(), rows.min(), columns.max(), rows.max()] - box) < 1).all()


def test_a_clip_that_cannot_be_made_is_left_out(dots, monkeypatch):
    whole, bad = Clip.pictures, {0, 2}

    def draw(clip, every):
        if clip.number in bad:
            raise ValueError("no\nmotion")
        return whole(clip, every)

    monkeypatch.setattr(Clip, "pictures", draw)
    with pytest.warns(RuntimeWarning, match="clip . is left out: no motion") as told:
        assert named(synthcam.stream(dots, stop=4, every=20)) == [(1, 0), (3, 0)]
    assert [str(each.message)[:6] for each in told] == ["clip 0", "clip 2"]
    bad |= set(range(20))
    with pytest.raises(InputError, match=r"^s\.yaml: 10 clips in a row cannot be made; the last: no motion$"):
        next(synthcam.stream(dots))


@pytest.mark.parametrize("given", [{"step": 0}, {"start": -1}, {"every": 0}, {"seed": -1}, {"by": "ball"}])
def test_a_wrong_argument_is_named(given):
    (name,) = given
    with pytest.raises(InputError, match=f"^{name}: expected"):
        synthcam.stream("oblique", **given)
