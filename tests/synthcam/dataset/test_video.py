"""Films read back by OpenCV, which did not write them, against the frames beside them."""

import json

import cv2
import numpy as np
import pytest
import tifffile
from synthcam_stub import SCENE, make

from synthcam.dataset.export import export
from synthcam.dataset.files import verify
from synthcam.dataset.video import VideoWriter
from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError

HOW = {"gamma": 1.0, "chroma": 420, "crf": 23, "q": 3}


def read(path, raw=False):
    """Frames, rate and times, s."""
    reader = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_CONVERT_RGB, int(not raw)])
    frames, times = [], []
    while (got := reader.read())[0]:
        frames.append(got[1])
        times.append(reader.get(cv2.CAP_PROP_POS_MSEC) / 1e3)
    return np.array(frames), reader.get(cv2.CAP_PROP_FPS), np.array(times)


def smooth(frames, colour, top=255):
    """Gradients that move: what a codec keeps well."""
    x, y = np.meshgrid(np.linspace(0, 1, 64), np.linspace(0, 1, 48))
    for k in range(frames):
        grey = top * (0.1 + 0.4 * x + 0.4 * y * np.sin(0.1 * k) ** 2)
        shown = np.stack([grey, grey[:, ::-1], 0.8 * grey], -1) if colour else grey
        yield shown.astype(np.uint8 if top < 256 else np.uint16)


def written(folder, codec, frames, fps=250.0, bits=8, **how):
    film = VideoWriter(folder, HOW | {"codec": codec} | how, fps, (64, 48), bits)
    for frame in frames:
        film.write(frame)
    film.close()
    return film.path


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize(("codec", "most"), [("h264", 8), ("mjpeg", 8), ("ffv1", 0)])
def test_what_was_filmed_is_read(tmp_path, codec, most, colour):
    path = written(tmp_path, codec, smooth(30, colour), crf=5, q=1, chroma=444)
    frames, fps, times = read(path)
    true = np.array(list(smooth(30, colour))).astype(int)
    seen = frames[..., ::-1] if colour else frames[..., 0]
    assert np.abs(seen - true).max() <= most
    assert np.abs(seen - true).mean(axis=(0, 1, 2)).max() <= most / 6
    assert fps == 250
    np.testing.assert_allclose(np.diff(times), 0.004, atol=1e-9)


@pytest.mark.parametrize("codec", ["h264", "mjpeg", "ffv1"])
@pytest.mark.parametrize("fps", [30.0, 30000 / 1001, 12.5, 1000.0, 10_000.0])
def test_rates_are_exact_and_no_frame_is_lost(tmp_path, codec, fps):
    if codec == "ffv1" and fps > 1000:
        with pytest.raises(InputError, match="expected at most 1000 frames a second for ffv1, found 10000"):
            check_scene({"video": {"codec": codec}, "timing": {"fps": fps, "exposure": 1e-5}}, "s.yaml")
        return
    frames, found, times = read(written(tmp_path, codec, smooth(41, False), fps))
    assert len(frames) == 41
    assert found == pytest.approx(fps, rel=1e-9)
    np.testing.assert_allclose(times, np.arange(41) / fps, atol=1e-6 / fps + 1e-9)


def test_gamma_is_a_power_of_full_scale(tmp_path):
    path = written(tmp_path, "ffv1", smooth(3, False), gamma=2.2)
    back = 255 * (read(path)[0][..., 0] / 255.0) ** 2.2
    true = np.array(list(smooth(3, False)), float)
    assert np.abs(back - true).max() < 0.5 * 2.2  # rounding, and the slope of the curve where it is steepest
    assert read(path)[0][0, 10, 10, 0] > 1.3 * true[0, 10, 10]


@pytest.mark.parametrize("colour", [False, True])
def test_ffv1_keeps_the_sensors_bits(tmp_path, colour):
    path = written(tmp_path, "ffv1", smooth(5, colour, 4095), bits=12)
    true = np.array(list(smooth(5, colour, 4095)))
    if colour:
        import av  # OpenCV gives 8 bits of this

        with av.open(str(path)) as film:
            seen = np.array([f.to_ndarray(format="rgb48le") for f in film.decode(video=0)])
    else:
        seen = read(path, raw=True)[0].reshape(true.shape)
    np.testing.assert_array_equal(seen, true)


def test_more_loss_is_a_smaller_file(tmp_path):
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 99, (48, 64)).astype(np.uint8) for _ in range(9)]
    for codec, key, values in (("h264", "crf", (18, 28, 40)), ("mjpeg", "q", (1, 5, 20))):
        sizes = [written(tmp_path, codec, frames, **{key: v}).stat().st_size for v in values]
        assert sizes[0] > 1.2 * sizes[1] > 1.4 * sizes[2]


def test_a_dataset_with_films(tmp_path, monkeypatch):
    video = {"codec": "mjpeg", "q": 1, "gamma": 2.2}
    plain = make(tmp_path / "plain", monkeypatch, clips=1)
    data = make(tmp_path / "d", monkeypatch, clips=1, scene=SCENE | {"video": video})
    again = make(tmp_path / "again", monkeypatch, clips=1, scene=SCENE | {"video": video})
    clip = data / "clips/000000"
    assert (clip / "frames.avi").read_bytes() == (again / "clips/000000/frames.avi").read_bytes()
    assert (clip / "frames.tif").read_bytes() == (plain / "clips/000000/frames.tif").read_bytes()
    for name in ("tracks", "events"):
        file = f"clips/000000/truth/{name}.parquet"
        assert (data / file).read_bytes() == (plain / file).read_bytes()
    assert json.loads((clip / "camera.json").read_text())["video"] == video | {"chroma": 420}
    assert not verify(data).problems
    frames = tifffile.imread(clip / "frames.tif")
    back = 255 * (read(clip / "frames.avi")[0][..., 0] / 255.0) ** 2.2
    assert np.abs(back - frames).mean() < 1.5


def test_films_of_a_dataset_that_is_there(tmp_path, monkeypatch):
    data = make(tmp_path / "d", monkeypatch, clips=2, scene=SCENE | {"sensor": {"bits": 12}})
    export(data, "h264:crf=12,gamma=1.8", tmp_path / "out", lambda done, total: None)
    for number in ("000000", "000001"):
        frames, fps, _ = read(tmp_path / "out/clips" / number / "frames.mp4")
        true = tifffile.imread(data / "clips" / number / "frames.tif")
        back = 4095 * (frames[..., 0] / 255.0) ** 1.8
        assert fps == 250
        assert np.abs(back - true).mean() < 0.01 * 4095
        assert np.corrcoef(back.ravel(), true.ravel())[0, 1] > 0.98
        about = json.loads((tmp_path / "out/clips" / number / "camera.json").read_text())
        assert about["video"] == {"codec": "h264", "crf": 12, "gamma": 1.8, "chroma": 420}


@pytest.mark.parametrize(
    ("video", "said"),
    [
        ({"codec": "vhs"}, "video.codec: expected 'h264', 'mjpeg' or 'ffv1'"),
        ({"codec": "mjpeg", "crf": 3}, "mjpeg has no crf"),
        ({"crf": 77}, "video.crf: expected a number of 51 or less"),
        ({"gamma": 0}, "video.gamma: "),
        ({"chroma": 411}, "video.chroma: expected 420, 422 or 444"),
        ({"bitrate": 5}, "video.bitrate: unknown key"),
        (5, "video: "),
    ],
)
def test_settings_that_no_video_has(video, said):
    with pytest.raises(InputError, match=said) as error:
        check_scene({"video": video}, "s.yaml")
    assert "\n" not in str(error.value)


def test_an_odd_picture_is_refused(tmp_path, monkeypatch):
    scene = SCENE | {"camera": {"size": [127, 64], "scale": 3e-4}}
    with pytest.raises(InputError, match="expected even sizes for h264 of chroma 420, found 127 x 64"):
        check_scene(scene | {"video": {"codec": "h264"}}, "s.yaml")
    data = make(tmp_path / "d", monkeypatch, clips=1, scene=scene | {"video": {"chroma": 444}})
    with pytest.raises(InputError, match="expected even sizes"):
        export(data, "h264", tmp_path / "out", lambda done, total: None)
    assert [p.name for p in tmp_path.iterdir()] == ["d"]


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("h264:crf", "expected CODEC:key=value"),
        ("h264:crf=1,crf=2", "expected CODEC:key=value"),
        ("mjpeg:q=0", "q: expected a number of 1 or more"),
        ("mot:q=1", "mot takes no settings"),
    ],
)
def test_wishes_that_no_export_takes(tmp_path, monkeypatch, kind, said):
    data = make(tmp_path / "d", monkeypatch, clips=1)
    with pytest.raises(InputError, match=said):
        export(data, kind, tmp_path / "out", lambda done, total: None)
    assert [p.name for p in tmp_path.iterdir()] == ["d"]
