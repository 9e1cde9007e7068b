"""Cases of videos: codecs, bits, ranges, curves of HDR, containers, turned pictures, cover pictures, oblong pixels."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from benchmarks.tracker.ordinary.case import Case
from benchmarks.tracker.ordinary.judges import Measured
from benchmarks.tracker.ordinary.sources import film_discs, track

video: Any = importlib.import_module("tracker_video")
QUARTER_TURN = (0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30)  # the matrix of the header of a track in MP4
Writer = Callable[[Path], Path]
OBLONG = "pixels of 4:3 (SAR)"
HDR = {"HLG": "arib-std-b67", "PQ": "smpte2084"}
CONTAINERS = {  # codec, pixels; the name by which FFmpeg writes it, if it is another
    "film.mts": ("libx264", "yuv420p", "written.ts"),
    "film.ts": ("mpeg2video", "yuv420p", ""),
    "film.3gp": ("libx264", "yuv420p", ""),
    "film.mov": ("libx264", "yuv420p", ""),
    "film.wmv": ("wmv2", "yuv420p", ""),
    "film.flv": ("flv", "yuv420p", ""),
    "film.gif": ("gif", "gray", ""),
    "film.mxf": ("mpeg2video", "yuv420p", ""),
    "film.y4m": ("wrapped_avframe", "gray", ""),
    "film.avi": ("mjpeg", "yuvj420p", ""),
    "film.webm": ("libvpx-vp9", "yuv420p", ""),
    "film.mp4": ("mpeg4", "yuv420p", ""),
}


def to_limited(frames: NDArray[Any], bits: int = 8) -> NDArray[Any]:
    """Codes of limited range, black at 16 and white at 235 of 8 bits."""
    codes = np.rint((16 + frames.astype(float) * 219 / 255) * 2 ** (bits - 8))
    stored: NDArray[Any] = codes.astype(np.uint8 if bits == 8 else "<u2")
    return stored


def encode(
    path: Path, codec: str = "libx264", bits: int = 8, full: bool = False, options: Mapping[str, str] | None = None
) -> Path:
    """The film of discs in a lossy codec of good quality, of 8 or 10 bits and of limited or full range."""
    frames = film_discs().frames
    codes = frames.astype("<u2") * 4 if full and bits == 10 else frames if full else to_limited(frames, bits)
    quality = {"crf": "12"} | ({"x265-params": "log-level=none"} if codec == "libx265" else {}) | dict(options or {})
    pixels = "yuv420p" if bits == 8 else "yuv420p10le"
    return Path(video.encode(path, codes, codec, pixels, rate=120, options=quality, full=full))


def encode_container(folder: Path, name: str) -> Path:
    """The film of discs in another container."""
    codec, pixels, written = CONTAINERS[name]
    frames = film_discs().frames
    codes = to_limited(frames) if pixels == "yuv420p" else frames
    rate = 25 if name in ("film.mxf", "film.gif") else 60  # neither MPEG-2 nor GIF has 120 a second
    options = {"crf": "12", "b": "8000000", "qmin": "2", "qmax": "2"}
    options = {"gif": {}, "libvpx-vp9": {"crf": "12", "b": "0"}}.get(codec, options)
    path = video.encode(folder / (written or name), codes, codec, pixels, rate=rate, options=options)
    return Path(path.rename(folder / name))


def encode_hdr(path: Path, curve: str) -> Path:
    """Ten bits with the name of an HDR curve; the codes stay those of the film."""
    tags = f"transfer={HDR[curve]}:colorprim=bt2020:colormatrix=bt2020nc"
    return encode(path, bits=10, options={"x264-params": tags})


def turn(path: Path) -> Path:
    """The film of discs turned by a quarter to the left, with the matrix by which a player turns it back."""
    frames = to_limited(np.rot90(film_discs().frames, 1, (1, 2)))
    data = video.encode(path, np.ascontiguousarray(frames), rate=120, options={"crf": "12"}).read_bytes()
    at = data.index(b"tkhd") + 4 + 40
    matrix = b"".join(value.to_bytes(4, "big", signed=True) for value in QUARTER_TURN)
    path.write_bytes(data[:at] + matrix + data[at + 36 :])
    return path


def mux(path: Path, frames: NDArray[Any], aspect: Fraction | None = None, cover: bool = False) -> Path:
    """Frames in H.264 with oblong pixels, or behind a cover picture that is the first stream."""
    with av.open(str(path), "w") as container:
        packets = list[Any]()
        if cover:
            picture: Any = container.add_stream("mjpeg", rate=1)
            picture.width, picture.height, picture.pix_fmt = 64, 48, "yuvj420p"
            black = av.VideoFrame.from_ndarray(np.zeros((48, 64), np.uint8), "gray").reformat(format="yuvj420p")
            black.pts = 0
        stream: Any = container.add_stream("libx264", rate=120, options={"crf": "12"})
        stream.height, stream.width = frames.shape[1:]
        stream.pix_fmt = "yuv420p"
        if aspect:
            stream.codec_context.sample_aspect_ratio = aspect
        if cover:
            packets = [*picture.encode(black), *picture.encode(None)]
        for k, counts in enumerate(to_limited(frames)):
            grey = np.full((counts.shape[0] * 3 // 2, counts.shape[1]), 128, np.uint8)
            grey[: counts.shape[0]] = counts
            frame = av.VideoFrame.from_ndarray(grey, "yuv420p")
            frame.pts = k
            packets += stream.encode(frame)
        for packet in packets + stream.encode(None):
            container.mux(packet)
    return path


def squeeze(frames: NDArray[Any]) -> NDArray[Any]:
    """Frames of 4:3 pixels: each pair of stored columns is the mean light of its part of three."""
    wide = np.repeat(frames.astype(float), 3, axis=2)
    narrow: NDArray[Any] = np.rint(wide.reshape(*frames.shape[:2], -1, 4).mean(axis=3)).astype(np.uint8)
    return narrow


def list_kinds() -> dict[str, tuple[Writer, Measured]]:
    """How a film of each kind is written, and its right values."""
    discs, truth = film_discs().frames, film_discs().truth
    fine = Measured(truth)
    kinds: dict[str, tuple[Writer, Measured]] = {}
    for name, codec in (("H.264", "libx264"), ("HEVC", "libx265")):
        for bits in (8, 10):
            for full in (False, True):
                kind = f"{name}, {bits} bits, {'full' if full else 'limited'} range"
                kinds[kind] = (name_film("film.mp4", partial(encode, codec=codec, bits=bits, full=full)), fine)
    for curve in HDR:
        says = (f"HDR curve {curve}",)
        kinds[f"{curve}, 10 bits"] = (
            name_film("film.mp4", partial(encode_hdr, curve=curve)),
            Measured(truth, says=says),
        )
    for name in CONTAINERS:
        kinds[f".{name.rpartition('.')[2]}"] = (partial(encode_container, name=name), fine)
    kinds["rotation metadata of a phone"] = (name_film("film.mp4", turn), fine)
    covered = partial(mux, frames=discs, cover=True)
    kinds["a cover picture as first stream"] = (name_film("film.mp4", covered), fine)
    oblong = partial(mux, frames=squeeze(discs), aspect=Fraction(4, 3))
    kinds[OBLONG] = (name_film("film.mp4", oblong), Measured(truth, says=("the picture is stretched",)))
    return kinds


def name_film(name: str, write: Writer) -> Writer:
    """A writer into a folder from one of a file."""
    return lambda folder: write(folder / name)


def list_cases() -> list[Case]:
    """Cases of videos."""
    sizes: dict[str, dict[str, Any]] = {OBLONG: {"size": [180, 180]}}
    return [
        Case("video", kind, track(write, film_discs, **sizes.get(kind, {})), judge)
        for kind, (write, judge) in list_kinds().items()
    ]
