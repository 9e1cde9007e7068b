"""Videos of all kinds give the counts that were encoded, in any order of reading; what is wrong with one is said."""

import pickle

import av
import numpy as np
import pytest
from tracker_video import encode

from synthcam_shared.errors import InputError
from tracker.camera.readers import video
from tracker.camera.recordings import open_frames

ROWS, COLUMNS = np.mgrid[:48, :64]
CODES = np.array([np.rint(120 + 80 * np.sin((COLUMNS + 3 * k) / 9) * np.cos(ROWS / 7)) for k in range(40)], np.uint8)
FULL = (CODES - 16.0) * 255 / 219  # what a camera had before the encoder made it 16 to 235
KINDS = {  # by name: codec, pixels, options, counts, and their usual error
    "h264.mp4": ("libx264", "yuv420p", {"crf": "12", "g": "12"}, FULL, 1.5),
    "h264.mov": ("libx264", "yuv422p", {"crf": "12", "bf": "3"}, FULL, 1.5),
    "full.mkv": ("libx264", "yuvj420p", {"crf": "12"}, CODES, 1.5),
    "deep.mkv": ("libx264", "yuv420p10le", {"crf": "12"}, FULL, 1.5),
    "mjpeg.avi": ("mjpeg", "yuvj420p", {}, CODES, 5),
    "vp9.webm": ("libvpx-vp9", "yuv420p", {"crf": "5", "b": "0"}, FULL, 2),
    "mpeg.mpg": ("mpeg2video", "yuv420p", {"b": "4000000"}, FULL, 3),
    "grey.mkv": ("ffv1", "gray", {}, CODES, 0),
    "grey10.mkv": ("ffv1", "gray10le", {}, 4.0 * CODES, 0),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A film of each kind."""
    home = tmp_path_factory.mktemp("films")
    for name, (codec, fmt, options, _, _) in KINDS.items():
        encode(home / name, CODES if fmt[-4:] != "10le" else CODES.astype("<u2") * 4, codec, fmt, options=options)
    return home


@pytest.mark.parametrize("name", KINDS)
def test_counts_are_those_before_the_encoder(folder, name, capfd):
    frames = open_frames(folder / name)
    true, error = KINDS[name][3:]
    film = np.array(list(frames))
    assert film.shape == true.shape
    assert np.sqrt(np.mean((film - true) ** 2)) <= error + 0.3 * (true is FULL)
    assert frames.dtype == (np.uint16 if name == "grey10.mkv" else np.uint8)  # 10 bits of a lossy codec are read as 8
    assert (frames.faults, frames.fps) == ((), 25)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", KINDS)
def test_order_of_reading_changes_nothing_and_steps_back_open_no_file_anew(folder, name, monkeypatch):
    film = np.array(list(open_frames(folder / name)))
    opened = []
    monkeypatch.setattr(av, "open", lambda path, whole=av.open: opened.append(path) or whole(path))
    frames = open_frames(folder / name)
    for k in (30, 31, 5, 4, 39, 13, 12, 0, 38, 20, -1):
        assert np.array_equal(frames[k], film[k])
    assert len(opened) <= (2 if name != "mpeg.mpg" else 8)  # MPEG program streams cannot be searched by time


@pytest.mark.parametrize("name", ["h264.mp4", "deep.mkv", "mpeg.mpg"])
def test_a_known_film_is_opened_again_without_a_pass_over_it(folder, name, monkeypatch):
    """As the processes do that share its frames."""
    known = open_frames(folder / name)
    monkeypatch.setattr(video, "_scan_video", None)
    again = open_frames(folder / name, contents=pickle.loads(pickle.dumps(known.contents)))
    assert (again.shape, again.dtype, again.fps, again.lossy) == (known.shape, known.dtype, known.fps, known.lossy)
    assert all(np.array_equal(again[k], known[k]) for k in (7, 30))


def test_codes_beyond_black_and_white_are_clipped_and_each_code_between_has_its_count(tmp_path):
    codes = np.tile(np.arange(256, dtype=np.uint8).reshape(16, 16), (3, 3, 3))
    frames = open_frames(encode(tmp_path / "film.mkv", codes, "ffv1", "yuv444p"))
    counts = frames[0][:16, :16].ravel()
    assert (counts[:17] == 0).all()
    assert (counts[235:] == 255).all()
    assert (np.diff(counts[16:236].astype(int)) >= 1).all()


def test_a_film_in_colour_is_its_luma_and_said_to_be_converted(tmp_path):
    """Red of BT.709: Y' = 16 + 219 x .2126, Cb 102, Cr 240."""
    red = np.stack([np.full((48, 64), code, np.uint8) for code in (63, 102, 240)])
    frames = open_frames(encode(tmp_path / "film.mkv", [red] * 3, "ffv1", "yuv444p"))
    assert frames.colours is not None
    assert frames.faults == ()
    assert np.abs(frames[1] - 255 * 0.2126).max() < 1


def test_colour_that_comes_in_late_is_seen(tmp_path):
    """A film of a grey wall, into which a red ball comes in frame 5."""
    grey = np.stack([np.full((48, 64), code, np.uint8) for code in (63, 128, 128)])
    red = np.stack([np.full((48, 64), code, np.uint8) for code in (63, 102, 240)])
    known = [open_frames(encode(tmp_path / f"{k}.mkv", [grey] * 5 + [end] * 9, "ffv1", "yuv444p")) for k, end in
             enumerate((grey, red))]  # fmt: skip
    assert [film.colours is not None for film in known] == [False, True]


@pytest.mark.parametrize(("curve", "name"), [("bt709", ""), ("smpte2084", "PQ"), ("arib-std-b67", "HLG")])
def test_a_film_with_a_curve_of_hdr_says_so(tmp_path, curve, name):
    options = {"x264-params": f"transfer={curve}:colorprim=bt2020:colormatrix=bt2020nc"}
    path = encode(tmp_path / "film.mp4", CODES[:4].astype("<u2") * 4, "libx264", "yuv420p10le", options=options)
    faults = [fault for fault in open_frames(path).faults if "HDR" in fault]
    assert [fault.split(":")[0] for fault in faults] == [f"the film has the HDR curve {name}"] * bool(name)


def test_a_truncated_film_gives_what_can_be_decoded(folder, tmp_path, capfd):
    for name in ("mjpeg.avi", "grey.mkv", "full.mkv"):
        whole = (folder / name).read_bytes()
        (tmp_path / name).write_bytes(whole[: len(whole) * 8 // 10])
        frames = open_frames(tmp_path / name)
        film = np.array(list(frames))
        assert 10 < len(film) < 37
        assert np.array_equal(film[:10], np.array(list(open_frames(folder / name)[:10])))
        assert f"{len(film)} of the 40 frames" in frames.faults[0]
    assert capfd.readouterr() == ("", "")


def test_a_damaged_film_is_read_on_and_said(folder, tmp_path, capfd):
    data = bytearray((folder / "grey.mkv").read_bytes())
    at = len(data) // 2
    data[at : at + 400] = bytes(400)
    (tmp_path / "film.mkv").write_bytes(data)
    frames = open_frames(tmp_path / "film.mkv")
    assert len(list(frames)) == len(frames) >= 20
    assert f"{40 - len(frames)} frames are missing by the time stamps" in frames.faults[0]
    assert frames.numbers[-1] == 39
    assert capfd.readouterr() == ("", "")


def test_what_has_no_video_is_one_line(tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"\0" * 3000)
    with pytest.raises(InputError, match=r"film.mp4: no frame can be decoded"):
        open_frames(tmp_path / "film.mp4")
    with av.open(str(tmp_path / "sound.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
    with pytest.raises(InputError, match=r"sound.mkv: no frame can be decoded"):
        open_frames(tmp_path / "sound.mkv")
