"""Write frames as an ordinary camera's video: H.264, Motion-JPEG or FFV1, with gamma and chroma subsampling.

Counts are written as 255 (counts / white)^(1/gamma), rounded, with white = 2^bits - 1. FFV1 keeps the sensor's bits
and, without a gamma, its counts. One thread encodes and no frame depends on a later one: with the same libraries, the
same frames give the same bytes.
"""

import json
import os
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam.scene.apparatus import MAX_AVI_FPS, VideoSettings, find_video_problem
from synthcam_shared.errors import InputError
from synthcam_shared.interruption import raise_if_interrupted
from synthcam_shared.settings import build_settings, parse_yaml

Frames = Iterator[NDArray[Any]]
VIDEO_FILES = {"frames.mp4", "frames.avi", "frames.mov"}


class VideoWriter:
    """A video file that takes frames (h, w) or, in colour, (h, w, 3), one at a time.

    how: codec, gamma, chroma and crf or q, as in a scene's `video`.
    fps: frame rate, 1/s.
    size: width and height, px.
    bits: of the frames.
    name: of the file, whose ending chooses the container; default: what players expect of the codec.
    """

    def __init__(
        self, folder: Path, how: dict[str, Any], fps: float, size: tuple[int, int], bits: int, name: str = ""
    ) -> None:
        codec = how["codec"]
        usual = "frames.mp4" if codec == "h264" else "frames.avi" if fps <= MAX_AVI_FPS else "frames.mov"
        self.path = folder / (name or usual)
        self._how, self._size, self._bits = how, size, bits
        self._wide = bits > 8 and codec == "ffv1"
        white = 2**bits - 1
        levels = (np.arange(white + 1) / white) ** (1 / how["gamma"]) * (white if self._wide else 255)
        self._curve = np.rint(levels).astype(np.uint16 if self._wide else np.uint8)
        self._rate = Fraction(fps).limit_denominator(100_000)  # 30000/1001 is then exact
        self._file = av.open(str(self.path), "w", options={"fflags": "+bitexact"})
        self._stream: Any = None
        self._taken = self._written = 0

    def tee(self, frames: Frames) -> Frames:
        """Write the frames and pass them on."""
        for frame in frames:
            raise_if_interrupted()
            self.write(frame)
            yield frame

    def write(self, frame: NDArray[Any]) -> None:
        colour = frame.ndim == 3
        if self._stream is None:
            self._stream = self._begin(colour)
        kind = ("rgb48le" if colour else "gray16le") if self._wide else ("rgb24" if colour else "gray")
        shown = np.ascontiguousarray(self._curve[frame])
        picture = av.VideoFrame.from_ndarray(shown, format=kind)
        picture.pts, picture.time_base = self._taken, 1 / self._rate
        self._taken += 1
        self._write_packets(self._stream.encode(picture))

    def close(self) -> None:
        """Write the remaining frames. Raises OSError if a frame is missing."""
        if self._stream is not None:
            self._write_packets(self._stream.encode())
        self._file.close()
        if self._written != self._taken:
            raise OSError(f"{self.path}: {self._written} frames encoded, expected {self._taken}")

    def _begin(self, colour: bool) -> Any:
        codec = self._how["codec"]
        encoder_of_codec = {"h264": "libx264", "mjpeg": "mjpeg", "ffv1": "ffv1"}
        stream: Any = self._file.add_stream(encoder_of_codec[codec], rate=self._rate)
        stream.width, stream.height = self._size
        stream.codec_context.time_base = 1 / self._rate
        stream.thread_count = 1
        stream.options = {"flags": "+bitexact"}
        if codec == "ffv1":
            wide, plain = ("gbrp16le", "bgr0") if colour else ("gray16le", "gray")
            stream.pix_fmt = wide if self._wide else plain
        elif codec == "mjpeg":
            stream.pix_fmt = f"yuvj{self._how['chroma']}p"
            stream.options |= {"qmin": str(self._how["q"]), "qmax": str(self._how["q"])}
        else:
            stream.pix_fmt = f"yuv{self._how['chroma']}p"
            stream.options |= {"crf": str(self._how["crf"]), "bf": "0"}
        return stream

    def _write_packets(self, packets: list[Any]) -> None:
        for packet in packets:
            self._written += 1
            self._file.mux(packet)


def parse_encoding(text: str, where: str) -> dict[str, str]:
    """Parse the keys of a scene's `video` from text such as h264:crf=23,gamma=2.2; their values stay text."""
    codec, _, rest = text.partition(":")
    how = {"codec": codec}
    for part in filter(None, rest.split(",")):
        key, equals, value = part.partition("=")
        if not (equals and key and value) or key in how:
            raise InputError(f"{where} {text}: expected CODEC:key=value,..., as in h264:crf=23,gamma=2.2")
        how[key] = value
    return how


def write_videos(clips: Iterator[RecordedClip], folder: Path, text: str) -> None:
    """Write clips/NNNNNN as an ordinary camera's video, with camera.json that has `video`.

    text: as of `parse_encoding`.
    """
    given = {key: parse_yaml(value) for key, value in parse_encoding(text, "--format").items()}
    how = build_settings(given, VideoSettings, f"--format {text}").model_dump(exclude_none=True)
    for clip in clips:
        frames = clip.pictures()
        size = (int(clip.camera_json["size"][0]), int(clip.camera_json["size"][1]))
        if problem := find_video_problem(how, size, clip.camera_json["fps"]):
            raise InputError(f"{clip.stack}: {problem}")
        own = folder / "clips" / f"{clip.number:06d}"
        own.mkdir(parents=True)
        about = json.dumps(clip.camera_json | {"video": how}, indent=1) + "\n"
        (own / "camera.json").write_text(about, encoding="utf-8")
        film = VideoWriter(own, how, float(clip.camera_json["fps"]), size, clip.bits)
        for frame in frames:
            film.write(frame)
        film.close()


def check_video(path: Path, frames: int) -> None:
    """Raise OSError if the video of an ordinary camera is cut short. OpenCV does not report a full disk."""
    film, count = cv2.VideoCapture(os.fspath(path), cv2.CAP_FFMPEG), 0
    while film.grab():
        count += 1
    film.release()
    if count != frames:
        raise OSError(f"a video of {count} frames, expected {frames}; is the disk full?")
