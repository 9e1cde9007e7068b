"""Films as phones, cameras and programs write them: bits, ranges, cover pictures, containers, oblong pixels."""

from fractions import Fraction

import av
import numpy as np
import pytest
from tracker_film import CAMERA
from tracker_video import encode

from tracker.camera.camera import Camera
from tracker.camera.recordings import make_recording, open_frames, open_source

ROWS, COLUMNS = np.mgrid[:96, :128]
CODES = np.array([np.rint(120 + 80 * np.sin((COLUMNS + 3 * k) / 17) * np.cos(ROWS / 13)) for k in range(20)], np.uint8)
LIMITED = (CODES - 16.0) * 255 / 219


def rms(frames, true):
    film = np.array(list(frames)).astype(float)
    assert film.shape == true.shape
    return float(np.sqrt(np.mean((film - true) ** 2)))


@pytest.mark.parametrize("codec", ["libx264", "libx265"])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("bits", [8, 10])
def test_lossy_film_has_counts_of_255_whatever_its_bits_and_range(tmp_path, codec, full, bits):
    movie = CODES if bits == 8 else CODES.astype("<u2") * 4
    options = {"crf": "12"} | ({"x265-params": "log-level=none"} if codec == "libx265" else {})
    path = encode(
        tmp_path / "film.mp4", movie, codec, "yuv420p" if bits == 8 else "yuv420p10le", options=options, full=full
    )
    frames = open_frames(path)
    assert frames.dtype == np.uint8
    assert rms(frames, CODES.astype(float) if full else LIMITED) < 2


KINDS = {  # codec, pixels, rms error of counts
    "film.mts": ("libx264", "yuv420p", 2),
    "film.m2ts": ("libx264", "yuv420p", 2),
    "FILM.TS": ("mpeg2video", "yuv420p", 4),
    "film.3gp": ("libx264", "yuv420p", 2),
    "film.wmv": ("wmv2", "yuv420p", 4),
    "film.flv": ("flv", "yuv420p", 4),
    "film.gif": ("gif", "gray", 0.6),
    "film.mxf": ("mpeg2video", "yuv420p", 4),
    "film.y4m": ("wrapped_avframe", "gray", 0),
}


@pytest.mark.parametrize("name", KINDS)
def test_films_of_other_containers(tmp_path, name):
    codec, fmt, error = KINDS[name]
    path = tmp_path / name
    options = {"crf": "12", "b": "8000000"} if codec != "gif" else {}
    formats = {"film.mts": "mpegts", "film.m2ts": "mpegts", "FILM.TS": "mpegts"}
    written = tmp_path / f"written{'.ts' if name in formats else path.suffix}"
    encode(written, CODES, codec, fmt, rate=25, options=options).rename(path)
    (source,) = open_source(path).clips
    frames = open_frames(source[1])
    assert rms(frames, CODES.astype(float) if fmt == "gray" else LIMITED) <= error
    assert np.array_equal(frames[3], np.array(list(frames))[3])
    assert frames.faults == ()
    assert frames.fps == pytest.approx(25, rel=1e-3)


@pytest.mark.parametrize("flagged", [False, True])
def test_a_cover_picture_is_no_film(tmp_path, flagged):
    with av.open(str(tmp_path / "film.mp4"), "w") as container:
        cover = container.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 64, 48, "yuvj420p"
        if flagged:
            cover.disposition = 0x400
        stream = container.add_stream("libx264", rate=25, options={"crf": "12"})
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        black = av.VideoFrame.from_ndarray(np.zeros((48, 64), np.uint8), "gray").reformat(format="yuvj420p")
        black.pts = 0
        packets = cover.encode(black) + cover.encode(None)
        for k, picture in enumerate(CODES):
            frame = av.VideoFrame.from_ndarray(picture, "gray")
            grey = np.full((144, 128), 128, np.uint8)
            grey[:96] = picture
            frame = av.VideoFrame.from_ndarray(grey, "yuv420p")
            frame.pts = k
            packets += stream.encode(frame)
        for packet in packets + stream.encode(None):
            container.mux(packet)
    frames = open_frames(tmp_path / "film.mp4")
    assert rms(frames, LIMITED) < 2
    assert frames.faults == ()


def test_a_film_that_a_phone_turned_is_upright(tmp_path):
    """The matrix of the MP4's track header is that of a quarter turn."""
    data = encode(tmp_path / "film.mp4", CODES, options={"crf": "12"}).read_bytes()
    at = data.index(b"tkhd") + 4 + 40
    turn = [0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30]
    matrix = b"".join(value.to_bytes(4, "big", signed=True) for value in turn)
    (tmp_path / "turned.mp4").write_bytes(data[:at] + matrix + data[at + 36 :])
    assert rms(open_frames(tmp_path / "turned.mp4"), np.rot90(LIMITED, -1, (1, 2))) < 2


def oblong(path, aspect):
    """A film whose pixels are `aspect` times as wide as high."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=250, options={"crf": "8"})
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(*aspect)
        for k, picture in enumerate(CODES):
            grey = np.full((144, 128), 128, np.uint8)
            grey[:96] = picture
            frame = av.VideoFrame.from_ndarray(grey, "yuv420p")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


PLAIN = {"fps": 250, "scale": 1.6e-4, "ball_diameter": 2.38e-3}


@pytest.mark.parametrize(("aspect", "width"), [((4, 3), 171), ((8, 9), 114)])
def test_oblong_pixels_are_made_square(tmp_path, aspect, width):
    frames = open_frames(oblong(tmp_path / "film.mp4", aspect))
    for size in (128, width):
        clip = make_recording(0, frames, Camera.from_dict({**PLAIN, "size": [size, 96]}))
        assert clip.frames.shape == (20, 96, width)
        assert clip.camera.size == (width, 96)
        assert "the picture is stretched" in "\n".join(map(str, clip.notes))
        x = (np.arange(width) + 0.5) * 128 / width - 0.5  # where the stored picture shows each column
        true = 120 + 80 * np.sin(x / 17)[None] * np.cos(ROWS[:, :1] / 13) - 16
        assert np.abs(clip.frames[0] - true * 255 / 219)[:, 2:-2].max() < 6
    assert make_recording(0, frames, None).camera.size == (width, 96)


def test_pixels_so_nearly_square_that_no_column_is_added_are_left_alone(tmp_path):
    frames = open_frames(oblong(tmp_path / "film.mp4", (301, 300)))
    assert frames.aspect == pytest.approx(301 / 300)
    clip = make_recording(0, frames, Camera.from_dict({**PLAIN, "size": [128, 96]}))
    assert "stretched" not in "\n".join(map(str, clip.notes))
    assert np.array_equal(clip.frames[3], frames[3])


def test_oblong_pixels_and_the_matrix_of_a_camera(tmp_path):
    """A point of the plate is seen at the same point of the picture, stretched; a square K is believed."""
    frames = open_frames(oblong(tmp_path / "film.mp4", (4, 3)))
    wide = {**CAMERA, "size": [128, 96], "scale": 1.6e-4}
    stored = Camera.from_dict({**wide, "K": [[2338.171875, 0, 60.0], [0, 3117.5625, 50.0], [0, 0, 1]]})
    point = [[0.001, 0.002, stored.radius], [-0.003, 0.001, stored.radius]]
    seen = make_recording(0, frames, stored).camera.project(point)
    at = stored.project(point)
    assert seen[:, 0] == pytest.approx((at[:, 0] + 0.5) * 171 / 128 - 0.5, abs=1e-9)
    assert seen[:, 1] == pytest.approx(at[:, 1])
    square = Camera.from_dict({**wide, "K": [[3117.5625, 0, 60.0], [0, 3117.5625, 50.0], [0, 0, 1]]})
    clip = make_recording(0, frames, square)
    assert clip.frames.shape == (20, 96, 128)
    assert "K is used" in "\n".join(map(str, clip.notes))
