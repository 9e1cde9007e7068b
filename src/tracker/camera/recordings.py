"""Opens recordings (a dataset, a clip, a stack, pictures, a video, an array), and digests their films.

Frames are read one at a time when they are needed, so that memory does not grow with the length of a clip. The tracker
opens only two files of a dataset's clip: the film (``frames.tif``, or an encoded ``frames.mp4``) and ``camera.json``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from synthcam_shared.arrays import Flags
from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import DARK
from tracker.camera.fields import separate_or_note
from tracker.camera.film_in_memory import ARRAYS, read_array_file
from tracker.camera.film_options import DEFAULT_OPTIONS, BallExample, FilmOptions, parse_frames, read_search_area
from tracker.camera.frame_times import find_frame_stride, rates_agree
from tracker.camera.frames import GREY, Frame, Frames, check_two_frames, linearise_counts
from tracker.camera.readers.labelled_array import HDF5, is_zarr, read_labelled_array
from tracker.camera.readers.picture_folder import PICTURES, TIFF, is_hidden_file, list_pictures, read_picture_folder
from tracker.camera.readers.tiff_stack import read_tiff_stack
from tracker.notes import COLOUR_TO_GREY, MADE_LINEAR, NO_CAMERA_FILE, Note, NoteKind, make_notes

VIDEOS = tuple(
    ".avi .mkv .mp4 .mov .m4v .mpg .mpeg .webm .qt .mts .m2ts .m2t .ts .vob .dv .3gp .3g2 .wmv .asf .flv .f4v .gif "
    ".mxf .y4m .ogv .ogg .divx .insv .lrv .mjpeg .mjpg .h264 .264 .h265 .hevc .265 .ivf .nut".split()
)


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording: its number, camera and frames, of which channel; ``notes`` say what was converted or assumed."""

    number: int
    camera: Camera
    frames: Frames
    notes: tuple[Note, ...] = ()
    channel: str = GREY
    area: Flags | None = None  # (h, w): the pixels among which balls are searched; None: all
    balls: tuple[BallExample, ...] = ()  # that the user points at
    progress: Progress | None = None  # takes the frames searched for balls, and the frames in all
    helpers: HelperProcesses | None = None  # processes that may search some of the frames

    def watch_frames(self) -> Iterator[Frame]:
        """The frames; `progress` hears of each once it is done."""
        for done, frame in enumerate(self.frames, 1):
            yield frame
            if self.progress is not None:
                self.progress(done, len(self.frames))

    def select_channel(self, name: str) -> Recording:
        """The same recording in one colour of a film; "grey" is what it is, and "dark" is made of grey."""
        if name == GREY:
            return self
        notes = tuple(note for note in self.notes if name == DARK or note.kind is not NoteKind.GREY)
        return replace(self, frames=self.frames.select_channel(name), notes=notes, channel=name)


@dataclass(frozen=True)
class RecordingSource:
    """Where clips come from. Cheap to send to another process: files are opened by `open_clip`."""

    path: Path
    clips: tuple[tuple[int, Path], ...]
    camera: Path | None = None
    dataset: bool = False
    channel: str | None = None  # of films in colour; None: not chosen, clips are opened in grey
    options: FilmOptions = DEFAULT_OPTIONS

    def __len__(self) -> int:
        return len(self.clips)

    def open_clip(self, index: int, contents: Any = None) -> Recording:
        """Opens clip ``index`` (its index in the source, not its number).

        contents: `Frames.contents` of the clip, if it was opened before.
        """
        location = self.clips[index][1]
        chosen = self.camera or _camera_beside(location)
        if self.camera is None and self.dataset and not chosen.is_file():
            raise InputError(f"{chosen}: no such file, expected the clip's camera.json")
        number, frames = self.open_film(index, contents)
        camera = Camera.read(chosen) if self.camera or chosen.is_file() else None
        names = f"{location}", f"{chosen}"
        return make_recording(number, frames, camera, names, self.options).select_channel(self.channel or GREY)

    def open_film(self, index: int, contents: Any = None) -> tuple[int, Frames]:
        """Number and frames of clip ``index``, whatever its camera."""
        number, location = self.clips[index]
        return number, open_frames(location, self.options, contents)

    def camera_files(self) -> list[Path]:
        """The camera file of each clip, where there is one."""
        if self.camera is not None:
            return [self.camera]
        return [file for _, location in self.clips if (file := _camera_beside(location)).is_file()]


@dataclass(frozen=True)
class HelperProcesses:
    """How other processes open the film of a clip, and how many there may be. Cheap to send to them."""

    source: RecordingSource
    index: int  # of the clip in the source
    workers: int  # processes, of which this one is one; 0: one a core, where so many are quicker
    contents: Any = None  # of the frames

    def open_frames(self) -> Frames:
        """Open the film again."""
        return self.source.open_clip(self.index, self.contents).frames


def _camera_beside(location: Path) -> Path:
    return (location.parent if location.is_file() or is_zarr(location) else location) / "camera.json"


def make_recording(
    number: int,
    frames: Frames,
    camera: Camera | None,
    names: tuple[str, str] = ("", ""),
    options: FilmOptions = DEFAULT_OPTIONS,
) -> Recording:
    """Make one recording of frames and camera. names: of both, for the InputError where their sizes differ."""
    bits = 8 * frames.dtype.itemsize
    frames, camera, said = _make_pixels_square(frames, camera)
    height, width = frames.shape[1:]
    notes = [] if frames.colours is None else [COLOUR_TO_GREY]
    given = camera or Camera.unknown((width, height), bits)
    if given.size != (width, height):
        asked = "x".join(map(str, given.size))
        raise InputError(f"{names[0]}: frames are {width}x{height}, expected {asked} by size in {names[1]}")
    frames, timed, timing = _set_times(frames, given, options)
    notes += make_notes(NoteKind.FILM, (*frames.faults, *said), number)
    notes += [NO_CAMERA_FILE] if camera is None else timing
    known = given if camera is None else timed
    if known.sensor.gamma != 1:
        frames, notes = linearise_counts(frames, known.sensor.gamma), [*notes, MADE_LINEAR]
        known = replace(known, sensor=replace(known.sensor, bits=16))
    elif "sensor.bits" in known.assumed:
        known = replace(known, sensor=replace(known.sensor, bits=bits))
    if options.frames:
        frames = frames.cut(*parse_frames(options.frames))
    balls = options.balls()
    for text, ball in zip(options.ball, balls, strict=True):
        if ball.frame not in frames.numbers or not (ball.x < width and ball.y < height):
            raise InputError(
                f"--ball {text}: expected a place in {width}x{height} px and a frame from {frames.numbers[0]} to "
                f"{frames.numbers[-1]}"
            )
    area = read_search_area(options.region, options.mask, (height, width))
    return Recording(number, known, frames, tuple(notes), area=area, balls=balls)


def _make_pixels_square(frames: Frames, camera: Camera | None) -> tuple[Frames, Camera | None, tuple[str, ...]]:
    """Frames as a player shows them where the file says that pixels are not square, the camera of those, and notes.

    The camera file may have the size of the stored or of the shown picture. Its K decides where it has one.
    """
    height, width = frames.shape[1:]
    if abs(frames.aspect - 1) < 1e-3 or round(width * frames.aspect) == width:
        return frames, camera, ()
    shown = frames.stretch_pixels()
    wide, says = shown.shape[2], f"the file says that pixels are {frames.aspect:.4g} times as wide as high"
    note = f"{says}: the picture is stretched from {width} to {wide} px, in which scale and x, y are"
    if camera is None or camera.size == (wide, height) or camera.size != (width, height):
        return shown, camera, (note,)
    matrix = camera.K.copy()
    if (
        camera.metric
        and "K" not in camera.assumed
        and rates_agree(matrix[0, 0], matrix[1, 1], 0.3 * abs(frames.aspect - 1))
    ):
        return frames, camera, (f"{says}, but K of the camera file has them square: K is used",)
    stretch = wide / width
    matrix[0, 2] = (matrix[0, 2] + 0.5) * stretch - 0.5
    matrix[0, :2] *= 1.0 if "K" in camera.assumed else stretch
    return shown, replace(camera, K=matrix, size=(wide, height)), (note,)


def _set_times(frames: Frames, camera: Camera, options: FilmOptions) -> tuple[Frames, Camera, list[Note]]:
    """Frame numbers and times in the camera's clock, the camera with the film's rate, and notes.

    Frames that lie a whole number of frame times apart throughout, such as every second picture, become consecutive.
    """
    frames, said = copy(frames), list[str]()
    if options.times == "even":
        frames.numbers, frames.seconds = np.arange(len(frames)), None
    stride = find_frame_stride(frames.numbers)
    rate = frames.fps
    if options.times == "file":
        if not rate > 0:
            raise InputError("--times file: the film states no times, expected a film that does, or --times auto")
        camera = replace(camera, fps=rate) if camera.metric else camera
    elif frames.fields and not rates_agree(rate, camera.fps):
        camera = replace(camera, fps=2 * camera.fps, exposure=min(camera.exposure, 0.5 / camera.fps))
        said.append(f"fps: {camera.fps:g} fields a second, twice the frames of the camera file")
    if stride > 1:
        frames.numbers = frames.numbers // stride
        is_clock = stride >= 1000 and any(rates_agree(unit / stride, camera.fps, 0.02) for unit in (1e3, 1e6, 1e9))
        if not rates_agree(rate / stride, camera.fps) and not is_clock and camera.metric:
            fps = camera.fps / stride
            said.append(
                f"fps: one frame in {stride} is there, {fps:g} of {camera.fps:g} a second; if fps in the camera file "
                "is that of these frames, --times even"
            )
            camera = replace(camera, fps=fps)
        rate /= stride
    frames.fps = rate
    if camera.metric and rate > 0 and not rates_agree(rate, camera.fps):
        said.append(
            f"fps: {camera.fps:g} in the camera file, {rate:.5g} by the film's own times, a factor of "
            f"{camera.fps / rate:.4g}; the camera file's is used; --times file takes the film's"
        )
    if frames.seconds is not None:
        mean = (len(frames) - 1) / float(frames.seconds[-1]) if len(frames) > 1 else rate
        if camera.metric and not rates_agree(rate, camera.fps, 0.02) and not rates_agree(mean, camera.fps, 0.02):
            frames.seconds = frames.seconds * (rate / camera.fps)
    if not camera.metric:
        frames.seconds = None
    return frames, camera, make_notes(NoteKind.TIMING, said)


def open_source(
    path: Path | str, camera: Path | str | None = None, options: FilmOptions = DEFAULT_OPTIONS
) -> RecordingSource:
    """Open the recordings behind ``path``; ``camera`` replaces the source's own camera.json. Raises InputError."""
    location, given = Path(path), None if camera is None else Path(camera)
    if given is not None:
        Camera.read(given)
    if not location.is_file() and not location.is_dir():  # a pipe is neither
        raise InputError(f"{location}: no such file or folder, expected a dataset, clip, stack, video or pictures")
    if location.is_file() and location.suffix.lower() not in TIFF + VIDEOS + ARRAYS + HDF5:
        raise InputError(
            f"{location}: expected a TIFF stack, a video, or an array of numpy.save (.npy), HDF5 or NetCDF, not a "
            f"{location.suffix or 'nameless'} file"
        )
    if location.is_dir() and not is_zarr(location):
        if (location / "clips").is_dir():
            return RecordingSource(location, _list_clips(location / "clips"), given, dataset=True, options=options)
        if (film := _film(location)) is not None:
            number = int(location.name) if location.name.isdecimal() else 0
            return RecordingSource(location, ((number, film),), given, options=options)
        if not list_pictures(location):
            raise InputError(
                f"{location}: nothing to track in it, expected clips/, frames.tif or pictures ({' '.join(PICTURES)})"
            )
    return RecordingSource(location, ((0, location),), given, options=options)


def _list_clips(folder: Path) -> tuple[tuple[int, Path], ...]:
    """Numbers and films of a dataset's clips."""
    clips = []
    for each in sorted(folder.iterdir()):
        if each.is_dir() and not is_hidden_file(each) and each.name.isdecimal():
            film = _film(each)
            if film is None:
                raise InputError(
                    f"{each / 'frames.tif'}: no such file, expected the clip's frames; "
                    "tracker measure takes the tracks of a dataset made without video"
                )
            clips.append((int(each.name), film))
    if not clips:
        raise InputError(f"{folder}: no clips, expected folders 000000, 000001, ...")
    return tuple(sorted(clips))


def _film(folder: Path) -> Path | None:
    """A clip's frames: a stack, or the film encoded."""
    films = (folder / f"frames{ending}" for ending in (".tif", *VIDEOS, *ARRAYS, *HDF5))
    return next((film for film in films if film.is_file()), None)


def open_frames(location: Path, options: FilmOptions = DEFAULT_OPTIONS, contents: Any = None) -> Frames:
    """Frames of a stack, a video, a folder of pictures, or an array; contents: of a video that was open before."""
    if is_zarr(location) or location.suffix.lower() in HDF5:
        frames = read_labelled_array(location, options)
    elif location.is_dir():
        frames = read_picture_folder(location, options)
    elif location.suffix.lower() in TIFF:
        frames = read_tiff_stack(location, options)
    elif location.suffix.lower() in ARRAYS:
        frames = read_array_file(location)
    else:
        from tracker.camera.readers.video import read_video  # here alone: FFmpeg's libraries are slow to load

        frames = read_video(location, options, contents)
    check_two_frames(location, frames)
    return frames if frames.fields or location.suffix.lower() in VIDEOS else separate_or_note(frames, options.fields)


def digest_films(source: RecordingSource) -> str:
    """Digest the films and camera files of recordings, by which run.json knows them."""
    mark = hashlib.sha256()
    for part in read_ends(source):
        mark.update(part)
    for file in source.camera_files():
        mark.update(file.read_bytes())
    return mark.hexdigest()


def read_ends(source: RecordingSource) -> Iterator[bytes]:
    """Read numbers, sizes and both ends of the films of recordings, from which their digest is made."""
    for number, location in source.clips:
        yield f"{number}".encode()
        inside = location.rglob("*") if is_zarr(location) else location.iterdir() if location.is_dir() else (location,)
        files = sorted(path for path in inside if path.is_file())
        for file in files:
            size = file.stat().st_size
            yield f"|{size}".encode()
            with file.open("rb") as stream:
                # 64 KiB at either end of a file distinguish recordings
                yield stream.read(1 << 16)
                stream.seek(max(0, size - (1 << 16)))
                yield stream.read(1 << 16)
