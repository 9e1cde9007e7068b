"""Whatever a camera leaves behind opens alike, a frame at a time; what is damaged is named in one line."""

import json
import os
import shutil
import struct
import subprocess
import sys
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from tracker_film import CAMERA, write_clip

from synthcam_shared.errors import InputError
from tracker.camera.recordings import open_frames, open_source
from tracker.notes import NO_CAMERA_FILE

RNG = np.random.default_rng(0)
MOVIE = RNG.integers(0, 255, (6, 48, 64), dtype=np.uint8)
SMALL = {**CAMERA, "size": [64, 48]}


def held(frames):
    return np.array(list(frames))


def one_line(call, *words):
    with pytest.raises(InputError) as error:
        call()
    text = str(error.value)
    assert "\n" not in text
    for word in words:
        assert word in text, text


@pytest.mark.parametrize(
    "how",
    [
        {"imagej": True},
        {},
        {"compression": "zlib"},
        {"byteorder": ">"},
        {"bigtiff": True, "metadata": None},
        {"rowsperstrip": 7},
    ],
)
@pytest.mark.parametrize("deep", [False, True])
def test_stacks_of_all_kinds(tmp_path, how, deep):
    movie = MOVIE.astype(np.uint16) * 16 if deep else MOVIE
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, movie, photometric=None if "imagej" in how else "minisblack", **how)
    frames = open_frames(path)
    assert np.array_equal(held(frames), movie)
    assert np.array_equal(frames[-1], movie[-1])
    assert len(frames[1:3]) == 2
    assert frames.dtype == movie.dtype
    assert frames.colours is None
    assert frames.faults == ()


def test_pages_written_one_by_one(tmp_path):
    path = tmp_path / "stack.tif"
    with tifffile.TiffWriter(path) as writer:
        for frame in MOVIE:
            writer.write(frame, contiguous=False)
    frames = open_frames(path)
    assert len(frames) == 6
    assert np.array_equal(held(frames), MOVIE)


def test_dataset_opens_frames_and_camera_only(tmp_path):
    for number in (0, 3):
        folder = write_clip(tmp_path / "clips" / f"{number:06d}", MOVIE, SMALL)
        (folder / "truth").write_text("a file where a folder should be: it is not looked at")
    source = open_source(tmp_path)
    assert [source.open_clip(i).number for i in range(len(source))] == [0, 3]
    assert np.array_equal(held(source.open_clip(1).frames), MOVIE)
    assert source.open_clip(0).camera.fps == 250
    single = open_source(tmp_path / "clips" / "000003")
    assert single.open_clip(0).number == 3


def test_pictures_come_in_natural_order(tmp_path):
    for k, frame in enumerate(MOVIE):
        cv2.imwrite(str(tmp_path / f"frame{k + 7}.png"), frame)
    frames = open_frames(tmp_path)
    assert np.array_equal(held(frames), MOVIE)  # frame10 after frame9


@pytest.mark.parametrize("kind", ["stack", "pictures"])
def test_colour_becomes_grey_and_is_said_so(tmp_path, kind):
    colour = np.zeros((3, 20, 30, 3), np.uint8)
    colour[..., 0], colour[..., 1], colour[..., 2] = 200, 100, 50  # red, green, blue
    if kind == "stack":
        path = tmp_path / "stack.tif"
        tifffile.imwrite(path, colour, photometric="rgb")
    else:
        path = tmp_path
        for k in range(3):
            cv2.imwrite(str(path / f"{k}.png"), colour[k, :, :, ::-1])
    frames = open_frames(path)
    assert frames.colours is not None
    assert frames.shape == (3, 20, 30)
    assert (frames[1] == round(0.299 * 200 + 0.587 * 100 + 0.114 * 50)).all()


def test_grey_with_alpha_is_grey(tmp_path):
    grey = RNG.integers(0, 256, (3, 20, 30), np.uint8)
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, np.stack([grey, np.full_like(grey, 255)], axis=-1), extrasamples=["unassalpha"])
    frames = open_frames(path)
    assert frames.colours is None
    assert np.array_equal(held(frames), grey)


def video(path, movie, code, colour=False):
    """Writes a video with OpenCV; above 8 bits the counts stand in the low bits of 16."""
    depth = cv2.CV_8U if movie.dtype == np.uint8 else cv2.CV_16U
    kind = [cv2.VIDEOWRITER_PROP_IS_COLOR, int(colour), cv2.VIDEOWRITER_PROP_DEPTH, depth]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*code), 25.0, (64, 48), kind)
    if not writer.isOpened():
        pytest.skip(f"this OpenCV cannot write {code}")
    for frame in movie:
        writer.write(frame)
    writer.release()
    return path


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_lossless_video_keeps_every_bit(tmp_path, bits, capfd):
    movie = RNG.integers(0, 2**bits, MOVIE.shape).astype(np.uint8 if bits == 8 else np.uint16)
    frames = open_frames(video(tmp_path / "film.mkv", movie, "FFV1"))
    assert frames.dtype == movie.dtype
    assert np.array_equal(held(frames), movie)
    assert np.array_equal(frames[4], movie[4])  # backwards and forwards
    assert frames.colours is None
    assert frames.faults == ()
    assert capfd.readouterr().err == ""  # OpenCV warns of reading what is stored


@pytest.mark.parametrize("code", ["FFV1", "HFYU"])
def test_colour_video_becomes_grey(tmp_path, code):
    colour = np.zeros((3, 48, 64, 3), np.uint8)
    colour[..., 2], colour[..., 1], colour[..., 0] = 200, 100, 50  # red, green, blue
    frames = open_frames(video(tmp_path / "film.avi", colour, code, colour=True))
    assert frames.colours is not None
    assert np.abs(held(frames) - (0.299 * 200 + 0.587 * 100 + 0.114 * 50)).max() < 2


def test_memory_does_not_grow_with_length(tmp_path):
    path = tmp_path / "long.tif"
    with tifffile.TiffWriter(path, bigtiff=True) as writer:
        writer.write(np.zeros((400, 200, 250), np.uint8))
    frames = open_frames(path)
    tracemalloc.start()
    total = sum(int(frame.shape[0]) for frame in frames)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert total == 400 * 200
    assert peak < 10 * 200 * 250 < frames.shape[0] * 200 * 250 / 10


def test_no_camera_file_is_said(tmp_path):
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, MOVIE, imagej=True)
    clip = open_source(path).open_clip(0)
    assert not clip.camera.metric
    assert clip.notes == (NO_CAMERA_FILE,)
    (tmp_path / "camera.json").write_text(json.dumps(SMALL))
    assert open_source(path).open_clip(0).camera.metric  # one beside it is taken
    other = tmp_path / "other.json"
    other.write_text(json.dumps({**SMALL, "fps": 100}))
    assert open_source(path, other).open_clip(0).camera.fps == 100


def test_gamma_makes_counts_linear_in_light(tmp_path):
    """Light of 1/4 and 1/2 of white, stored by a curve of 1/2.2."""
    codes = np.rint(255 * np.array([0.0, 0.25, 0.5, 1.0]) ** (1 / 2.2)).astype(np.uint8)
    write_clip(tmp_path, np.tile(codes[:, None, None], (1, 48, 64)), {**SMALL, "sensor": {"gamma": 2.2}})
    clip = open_source(tmp_path).open_clip(0)
    assert [frame[0, 0] / 65535 for frame in clip.frames] == pytest.approx([0, 0.25, 0.5, 1], abs=0.005)
    assert clip.camera.sensor.bits == 16
    assert "linear in light" in str(clip.notes[-1])


def test_bad_sources(tmp_path):
    one_line(lambda: open_source(tmp_path / "none"), "none", "no such file")
    (tmp_path / "empty").mkdir()
    one_line(lambda: open_source(tmp_path / "empty"), "nothing to track in it", "expected")
    (tmp_path / "set" / "clips").mkdir(parents=True)
    one_line(lambda: open_source(tmp_path / "set"), "no clips")
    (tmp_path / "set" / "clips" / "000000").mkdir()
    one_line(lambda: open_source(tmp_path / "set"), "frames.tif", "no such file")
    (tmp_path / "notes.txt").write_text("hello")
    one_line(lambda: open_source(tmp_path / "notes.txt"), "notes.txt", "expected a TIFF stack")
    (tmp_path / "film.avi").write_bytes(b"no film at all")
    one_line(lambda: open_frames(tmp_path / "film.avi"), "film.avi", "no frame can be decoded")


def test_damaged_stacks(tmp_path):
    path = tmp_path / "stack.tif"
    (tmp_path / "stack.tif").write_bytes(b"")
    one_line(lambda: open_frames(path), "stack.tif", "cannot be read as TIFF")
    for how in ({"imagej": True}, {"compression": "zlib"}):
        tifffile.imwrite(path, MOVIE, **how)
        whole = path.read_bytes()
        open_frames(path)
        path.write_bytes(whole[: int(len(whole) * 0.7)])
        one_line(lambda: held(open_frames(path)), "stack.tif", "truncated")
    tifffile.imwrite(path, MOVIE[:1])
    one_line(lambda: open_frames(path), "one frame only", "at least two")
    tifffile.imwrite(path, np.full((5, 8, 8), np.nan, np.float32))
    one_line(lambda: open_frames(path), "float", "uint8 or uint16")
    tifffile.imwrite(path, MOVIE.astype(np.int32))
    one_line(lambda: open_frames(path), "int32", "uint8 or uint16")


def test_pictures_of_unequal_size(tmp_path):
    cv2.imwrite(str(tmp_path / "1.png"), MOVIE[0])
    cv2.imwrite(str(tmp_path / "2.png"), MOVIE[1, :20])
    one_line(lambda: held(open_frames(tmp_path)), "2.png", "64x20", "64x48")


def test_camera_of_another_size(tmp_path):
    write_clip(tmp_path, MOVIE, CAMERA)
    one_line(lambda: open_source(tmp_path).open_clip(0), "64x48", "200x160", "size", "camera.json")


def bomb(path, side):
    """A small file that unpacks to side x side black pixels."""
    if path.suffix == ".png":

        def chunk(kind, data):
            return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

        packer = zlib.compressobj(9)
        rows = b"".join([*(packer.compress(bytes(side + 1)) for _ in range(side)), packer.flush()])
        head = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))
        return
    packed, entries = zlib.compress(bytes(1 << 20), 9), []
    for tag, value in ((256, side), (257, side), (258, 8), (259, 8), (262, 1), (273, 8), (277, 1), (278, side)):
        entries.append(struct.pack("<HHII", tag, 4 if value > 65535 or tag in (256, 257, 273, 278) else 3, 1, value))
    entries.append(struct.pack("<HHII", 279, 4, 1, len(packed)))
    pages, start = b"", 8 + len(packed)
    for k in range(2):
        size = 2 + 12 * len(entries) + 4
        after = start + size if k == 0 else 0
        pages += struct.pack("<H", len(entries)) + b"".join(entries) + struct.pack("<I", after)
        start += size
    path.write_bytes(b"II*\0" + struct.pack("<I", 8 + len(packed)) + packed + pages)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
def test_pictures_larger_than_the_memory_are_one_line(tmp_path):
    """Three ways to promise more than there is, opened with 100 MB more than at the start."""
    for name, side in (("one", 12_000), ("two", 2_000_000)):
        (tmp_path / name).mkdir()
        if name == "one":
            bomb(tmp_path / "one/0.png", side)
        else:  # the header lies
            data = bytearray((tmp_path / "one/0.png").read_bytes())
            data[16:24] = struct.pack(">II", side, side)
            data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
            (tmp_path / "two/0.png").write_bytes(bytes(data))
        shutil.copy(tmp_path / name / "0.png", tmp_path / name / "1.png")
        bomb(tmp_path / f"{name}.tif", side)
    script = (
        "import resource, sys\nfrom pathlib import Path\n"
        "from tracker.edits import TrackEdits\nfrom tracker.pipeline import _track_clip\n"
        "from tracker.settings import TrackerSettings\n"
        "from synthcam_shared.errors import InputError\n"
        "from tracker.camera.recordings import open_source\n"
        "import tracker.detection.detectors.maximum_likelihood\n"
        "held = next(line for line in open('/proc/self/status') if line.startswith('VmData'))\n"
        "limit = (int(held.split()[1]) << 10) + (100 << 20)\n"
        "resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))\n"
        "for place in sys.argv[1:]:\n"
        "    try:\n"
        "        _track_clip(open_source(place), 0, Path('out'), 'centroid', None, TrackerSettings(), TrackEdits())\n"
        "    except InputError as error:\n"
        "        print(error)\n"
    )
    positions = [tmp_path / name for name in ("one", "two", "one.tif", "two.tif")]
    done = subprocess.run([sys.executable, "-c", script, *map(str, positions)], capture_output=True, text=True)
    said = done.stdout.splitlines()
    assert (done.returncode, len(said)) == (0, 4), done.stderr
    assert all(line.startswith(f"{position}") for line, position in zip(said, positions, strict=True))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_a_pipe_is_refused_before_anything_waits_for_it(tmp_path):
    os.mkfifo(tmp_path / "film.mp4")
    one_line(lambda: open_source(tmp_path / "film.mp4"), "film.mp4: no such file or folder, expected a dataset")
