"""Films for people: the right frames, slowed down, cropped to the balls."""

import gc
import resource

import cv2
import imageio.v3 as iio
import numpy as np
import pytest
from synthcam_stub import film, plan

from synthcam.dataset import preview
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene, check_scene
from synthcam_shared.errors import InputError


@pytest.fixture
def clip(monkeypatch):
    monkeypatch.setattr(Clip, "pictures", film)
    return plan().clip(1)


def brightest(picture):
    return np.unravel_index(np.argmax(cv2.GaussianBlur(picture, (0, 0), 6)), picture.shape)


def frames_of(path):
    if path.suffix == ".gif":
        return [f if f.ndim == 2 else f[..., 0] for f in iio.imread(path, index=None)]
    reader, frames = cv2.VideoCapture(str(path)), []
    while (got := reader.read())[0]:
        frames.append(got[1][..., 0])
    return frames


@pytest.mark.parametrize("name", ["f.gif", "f.mp4", "F.GIF"])
def test_a_film(clip, tmp_path, name):
    path = tmp_path / name
    assert preview.write_animation(clip, path) == pytest.approx(250 / 20)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    frames = frames_of(path.rename(tmp_path / name.lower()))
    assert len(frames) == clip.frames
    assert all(f.shape == frames[0].shape for f in frames)
    assert 400 < max(frames[0].shape) < 1000


@pytest.mark.parametrize("name", ["map.png", "map.gif"])
def test_a_map_from_above_needs_no_film(name, tmp_path, monkeypatch):
    monkeypatch.delattr(Clip, "pictures")
    clip = plan().clip(1)
    preview.write_motion_map(clip, tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    frames = frames_of(tmp_path / name) if name == "map.gif" else [iio.imread(tmp_path / name)[..., 0]]
    assert len(frames) == (clip.frames + 1 if name == "map.gif" else 1)  # up to the end of the last frame
    assert len(np.unique(frames[0])) > 10


def test_it_plays_at_the_speed_it_states(clip, tmp_path):
    preview.write_animation(clip, tmp_path / "f.gif")
    assert iio.immeta(tmp_path / "f.gif")["duration"] == 50
    preview.write_animation(clip, tmp_path / "f.mp4")
    assert cv2.VideoCapture(str(tmp_path / "f.mp4")).get(cv2.CAP_PROP_FPS) == pytest.approx(20)


def test_the_balls_are_where_the_crop_says(clip, tmp_path):
    """Each frame's brightest position is one of the balls, by the crop's corner and the magnification."""
    preview.write_animation(clip, tmp_path / "f.gif")
    view = clip.view
    positions = view.at(np.arange(clip.frames) / clip.camera.fps)[:, :, :3]
    rows, columns = preview._crop_to_paths(clip, positions)
    frames = frames_of(tmp_path / "f.gif")
    zoom = frames[0].shape[1] / (columns.stop - columns.start)
    assert zoom == round(zoom) > 1
    for k, frame in enumerate(frames):
        y, x = brightest(frame[:-24])  # without the caption
        found = np.array([columns.start + (x - (zoom - 1) / 2) / zoom, rows.start + (y - (zoom - 1) / 2) / zoom])
        balls = clip.camera.project(positions[:, k])
        assert np.hypot(*(balls - found).T).min() < 1.5, k


def test_the_crop_holds_the_balls_and_no_more_than_the_picture(clip):
    view = clip.view
    positions = view.at(np.arange(clip.frames) / clip.camera.fps)[:, :, :3]
    rows, columns = preview._crop_to_paths(clip, positions)
    assert rows.start >= 0 <= columns.start
    assert rows.stop <= 64
    assert columns.stop <= 128
    assert (rows.stop - rows.start) % 2 == (columns.stop - columns.start) % 2 == 0
    px = clip.camera.project(positions.reshape(-1, 3))
    px = px[((px > 0) & (px < [128, 64])).all(axis=1)]
    room = 1.5 * 2.38e-3 / 3e-4  # px round each centre, where the picture has it
    assert (px - [columns.start, rows.start] >= np.minimum(px, room)).all()
    assert ([columns.stop, rows.stop] - px >= np.minimum([128, 64] - px, room) - 1).all()


@pytest.mark.parametrize(
    ("diameter", "apart", "magnify", "times"),
    [
        (0.006, 0.0061, 12, 8),  # 20 px each, side by side: with half a ball around them, 40 px eight times into 333
        (0.006, 0.0061, 3, 3),
        (0.012, 0.1, 12, 4),  # too far apart: one alone
        (0.03, 0.09, 12, 0),  # 100 px: no room at twice its size
    ],
)
def test_the_magnified_bodies_are_whole(monkeypatch, tmp_path, diameter, apart, magnify, times):
    """The magnified part has every pixel of the bodies, and fills the width of the frame."""
    launches = [{"position": [-0.04, 0.01], "velocity": [1.0, 0.0]}, {"position": [-0.04 + apart, 0.01]}]
    away = {"position": [-0.09, -0.04], "velocity": [-1e-3, 0.0]}
    settings = {
        "launches": [away, *launches],
        "ball": {"diameter": diameter},
        "camera": {"size": [667, 400], "scale": 3e-4},
        "timing": {"frames": 40},
    }
    scene = check_scene(settings | {"surface": {"ball": "matte"}}, "scene").draw()
    low, high = np.moveaxis(preview._list_outlines(scene, 0)[:2].reshape(2, 2, 2), 1, 0).round().astype(int)
    shown = np.full((400, 667), 50, np.uint8)
    for (left, top), (right, bottom) in list(zip(low, high, strict=True))[: 2 if apart < 2 * diameter else 1]:
        shown[top:bottom, left:right] = 255
    monkeypatch.setattr(Clip, "pictures", lambda clip, every=1: iter([shown, shown]))
    preview.write_preview(scene, tmp_path / "f.png", 0, magnify)
    picture = iio.imread(tmp_path / "f.png")
    assert picture.shape == (400 + bool(times) * (4 + 333), 667)
    inset = picture[404:]
    bright = picture[:400].max()
    assert (inset == bright).sum() == times**2 * (shown == 255).sum()
    assert not (inset == 0).any()


def test_a_film_that_fails_leaves_nothing(clip, tmp_path, monkeypatch):
    def broken(clip):
        yield from first(film(clip), 3)
        raise OSError("no more")

    monkeypatch.setattr(Clip, "pictures", broken)
    for name in ("f.gif", "f.mp4"):
        with pytest.raises(InputError, match="no more"):
            preview.write_animation(clip, tmp_path / name)
        assert not list(tmp_path.iterdir())


def test_a_gif_on_a_full_disk_leaves_nothing_and_says_no_more(clip, tmp_path):
    """A limit on files stands in for the disk; what imageio tries again as it is collected would be a warning here."""
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, usual[1]))  # what `check_room` wants, and no more
    try:
        with pytest.raises(InputError, match=r"f\.gif: File too large$"):
            preview.write_animation(clip, tmp_path / "f.gif")
        gc.collect()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert not list(tmp_path.iterdir())


def first(frames, count):
    return (frame for frame, _ in zip(frames, range(count), strict=False))


@pytest.mark.parametrize("frames", [40, 41])
def test_the_frame_that_a_preview_shows(frames):
    """The last that ends before the contact; without a contact the middle one."""
    hits = plan().clip(1)
    k, hit = preview.find_telling_frame(hits), hits.view.motion.first("contact")
    ends = (k + np.arange(2)) / hits.camera.fps + hits.camera.exposure
    assert ends[0] <= hit.t < ends[1]
    rolls = Scene.read("single_roller", timing={"frames": frames, "contact_frame": 10}).draw()
    assert rolls.view.motion.first("contact") is None
    assert preview.find_telling_frame(rolls) == 20
