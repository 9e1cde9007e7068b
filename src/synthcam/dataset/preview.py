"""Preview a scene as a picture or an animation, marked as made by synthcam, and measure how fast frames are made."""

import itertools
import os
import struct
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray
from skimage.exposure import adjust_gamma, rescale_intensity

from synthcam.camera.sensor import Counts
from synthcam.dataset.labelled_frames import encode_png
from synthcam.dataset.video import check_video
from synthcam.scene.clip import Clip
from synthcam.scene.outlines import find_boxes
from synthcam.scene.scene import check_scene
from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_replaceable, check_writable, write_atomically

MARK = b"made by synthcam"
ANIMATION_FPS = 20  # GIF counts in hundredths of a second


def check_picture_output(path: Path, command: str) -> None:
    """Raise InputError if a picture cannot be written, or a file without the mark of synthcam stands there."""
    check_replaceable(path, MARK, command)
    check_writable(path)


def mark_picture(data: bytes, suffix: str) -> bytes:
    """Add the mark to a PNG, GIF or MP4 as a comment that viewers ignore."""
    if suffix == ".png":  # a text chunk after the header, which ends at byte 33
        chunk = b"tEXtComment\0" + MARK
        return data[:33] + struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:]
    if suffix == ".gif":  # a comment extension before the trailer
        return data[:-1] + b"\x21\xfe" + bytes([len(MARK)]) + MARK + b"\0" + data[-1:]
    return data + struct.pack(">I", 8 + len(MARK)) + b"free" + MARK


def find_telling_frame(clip: Clip) -> int:
    """Find the frame that a preview shows: the last before the first contact, or the middle one without a contact."""
    hit = clip.view.motion.first("contact")
    if hit is None:
        return clip.frames // 2
    return min(max(int((hit.t - clip.camera.exposure) * clip.camera.fps), 0), clip.frames - 1)


def write_preview(clip: Clip, path: Path, frame: int | None, magnify: int) -> None:
    """Preview one frame of a clip as a PNG.

    frame: its number; None: as `find_telling_frame` says. magnify: above 0, the balls that hit first are shown
    below the frame, at most so many times larger, with dark parts brightened.
    """
    check_picture_output(path, "synthcam preview")
    if frame is not None and not 0 <= frame < clip.frames:
        raise InputError(f"--frame {frame}: expected 0 to {clip.frames - 1}; the clip has {clip.frames} frames")
    k = find_telling_frame(clip) if frame is None else frame
    counts = next(itertools.islice(clip.pictures(max(k, 1)), min(k, 1), None))
    picture = _eight_bits(counts, clip)
    if magnify:
        picture = _with_inset(picture, _list_outlines(clip, k), magnify, clip)
    with as_input_error(path):
        write_atomically(path, mark_picture(encode_png(picture), ".png"))


def write_animation(clip: Clip, path: Path) -> float:
    """Preview a clip as an animation, .gif or .mp4, cropped to the paths of the balls and magnified.

    Dark parts are brightened as in `write_preview`, and noise is removed. A strip below the picture shows the speed and
    the time. Returns how many times slower than the motion the animation plays.
    """
    slower = clip.camera.fps / ANIMATION_FPS
    positions = clip.view.at(np.arange(clip.frames) / clip.camera.fps)[:, :, :3]
    rows, columns = _crop_to_paths(clip, positions)
    size = max(rows.stop - rows.start, columns.stop - columns.start)
    zoom = max(1, -(-640 // size))  # to 640 px or a little more
    noise = float(np.hypot(clip.sensor.read_noise, clip.sensor.dsnu) / clip.sensor.gain) + 0.5  # of the plate, counts
    floor = _black(clip) + noise / 2 ** (clip.sensor.bits - 8)

    def render_frames() -> Iterator[NDArray[np.uint8]]:
        for k, counts in enumerate(clip.pictures()):
            patch = _eight_bits(counts, clip)[rows, columns]
            if not clip.finish:  # moving noise hides what a film is to show, and fills its file
                smooth = cv2.GaussianBlur(patch.astype(np.float32), (0, 0), 0.8)
                patch = _brighten(np.where(smooth > floor, np.rint(smooth), 0).astype(np.uint8), _black(clip))
            large = _enlarge(patch, zoom)
            strip, font = np.full((24, *large.shape[1:]), 40, np.uint8), min(0.5, large.shape[1] / 480)
            text = f"{slower:.3g} x slower   {1e3 * k / clip.camera.fps:.0f} ms"
            cv2.putText(strip, text, (6, 17), cv2.FONT_HERSHEY_SIMPLEX, font, (230, 230, 230), 1, cv2.LINE_AA)
            yield np.vstack([large, strip])

    with _write_aside(path) as aside:
        if aside.suffix == ".gif":
            # In memory first: on a full disk, imageio tries again when it is deleted, and prints a traceback.
            pace = 1000 / ANIMATION_FPS
            aside.write_bytes(iio.imwrite("<bytes>", list(render_frames()), extension=".gif", duration=pace, loop=0))
        else:
            _write_mp4(aside, render_frames())
            check_video(aside, clip.frames)
    return slower


@contextmanager
def _write_aside(path: Path) -> Iterator[Path]:
    """Give the path of a file to be written, which is then marked and becomes `path`."""
    check_picture_output(path, "synthcam preview")
    with as_input_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}-") as folder:
            aside = Path(folder) / f"film{path.suffix.lower()}"
            yield aside
            aside.write_bytes(mark_picture(aside.read_bytes(), aside.suffix))
            aside.replace(path)


def write_motion_map(clip: Clip, path: Path) -> None:
    """Preview the motion of a clip from above: paths, walls and events as .png, or moving bodies as .gif or .mp4."""
    motion = clip.solve()
    with _write_aside(path) as aside:
        if aside.suffix == ".png":
            from matplotlib.figure import Figure  # here alone: slow to load

            figure = Figure(layout="constrained")
            motion.plot(figure.subplots())
            figure.savefig(aside, dpi=100)
        else:
            motion.animate(aside, ANIMATION_FPS, clip.camera.fps / ANIMATION_FPS)


def _write_mp4(path: Path, frames: Iterator[NDArray[np.uint8]]) -> None:
    first = next(frames)
    size = (first.shape[1], first.shape[0])
    colour = first.ndim == 3
    writer = cv2.VideoWriter(os.fspath(path), cv2.VideoWriter.fourcc(*"mp4v"), ANIMATION_FPS, size, colour)
    if not writer.isOpened():
        raise OSError(f"{path.suffix}: this OpenCV cannot write MPEG-4")
    for frame in itertools.chain([first], frames):
        writer.write(frame[..., ::-1] if colour else frame)
    writer.release()


def _crop_to_paths(clip: Clip, positions: Array) -> tuple[slice, slice]:
    """Rows and columns around the paths (N, T, 3) of the balls; even numbers of both, for MPEG."""
    px = clip.camera.project(positions.reshape(-1, 3))
    width, height = clip.camera.size
    inside = px[((px >= 0) & (px < [width, height])).all(axis=1)]
    if not len(inside):
        return slice(0, height), slice(0, width)
    margin = 2 * float(clip.model.ball.diameter * clip.camera.K[0, 0] / abs(clip.camera.t[2]))
    low = np.clip(np.floor(inside.min(axis=0) - margin), 0, None).astype(int)
    high = np.clip(np.ceil(inside.max(axis=0) + margin), None, [width, height]).astype(int)
    high -= (high - low) % 2
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _brighten(picture: NDArray[np.uint8], black: float) -> NDArray[np.uint8]:
    """Black subtracted, gamma 1/3 to show what is dark."""
    stretched = rescale_intensity(picture.astype(np.float64), in_range=(black, 255.0), out_range=(0.0, 1.0))
    return np.asarray(255 * adjust_gamma(stretched, 1 / 3)).astype(np.uint8)


def _eight_bits(counts: Counts, clip: Clip) -> NDArray[np.uint8]:
    """Convert counts for a screen: with its gamma under room light, else linearly."""
    bits = clip.sensor.bits
    if clip.finish is None:
        return (counts >> (bits - 8)).astype(np.uint8) if bits > 8 else counts.astype(np.uint8)
    above = np.maximum(counts - clip.sensor.black_level, 0) / (2**bits - 1 - clip.sensor.black_level)
    return np.asarray(255 * adjust_gamma(above, 1 / 2.2)).astype(np.uint8)


def show_on_screen(counts: Counts, clip: Clip) -> NDArray[np.uint8]:
    """A frame of a clip for a screen: dark parts of mirror balls on a black plate are brightened."""
    picture = _eight_bits(counts, clip)
    return picture if clip.finish else _brighten(picture, _black(clip))


def _black(clip: Clip) -> float:
    return float(clip.sensor.black_level / 2 ** (clip.sensor.bits - 8))


def _enlarge(picture: NDArray[np.uint8], times: int) -> NDArray[np.uint8]:
    return picture.repeat(times, axis=0).repeat(times, axis=1)


def _list_outlines(clip: Clip, k: int) -> Array:
    """Boxes (n, 4) of the outlines, px, of the bodies in frame k: the two that hit first, then all others."""
    centres, hit = clip.view.at(np.array([k / clip.camera.fps]))[:, 0, :3], clip.view.motion.first("contact")
    boxes = find_boxes(clip.camera, centres, clip.launch.bodies.radius, clip.heights)
    order = sorted(range(len(boxes)), key=lambda body: hit is None or body not in (hit.i, hit.j))
    return np.array([boxes[body] for body in order if (boxes[body, 2:] - boxes[body, :2] > 0.5).all()]).reshape(-1, 4)


def _with_inset(picture: NDArray[np.uint8], outlines: Array, magnify: int, clip: Clip) -> NDArray[np.uint8]:
    """Add a strip below the frame: a magnified part, on a black plate brightened.

    outlines: as of `_list_outlines`. The part has the first two bodies with their surroundings where they are near each
    other, or else the first, whole. There is no strip if a body has no room in it at twice its size.
    """
    height, width = picture.shape[:2]
    room = np.array([width, max(width // 2, 1)])

    def find_part(bodies: Array) -> tuple[int, Array]:
        """Find how many times larger bodies fit into the strip with half a body around them, and their middle."""
        low, high = bodies[:, :2].min(axis=0), bodies[:, 2:].max(axis=0)
        around = 0.5 * (bodies[:, 2:] - bodies[:, :2]).max()
        return int(min(magnify, *(room // (high - low + 2 * around)))), (low + high) / 2

    times, middle = find_part(outlines[:1]) if len(outlines) else (magnify, np.array([width, height]) / 2)
    if len(outlines) > 1:
        of_both = find_part(outlines[:2])
        times, middle = of_both if 2 * of_both[0] >= times else (times, middle)
    if times < min(magnify, 2):
        return picture
    across, down = (min(n, size) for n, size in zip((-(-room // times)).tolist(), (width, height), strict=True))
    left = int(np.clip(round(middle[0] + 0.5 - across / 2), 0, width - across))
    top = int(np.clip(round(middle[1] + 0.5 - down / 2), 0, height - down))
    part = picture[top : top + down, left : left + across]
    large = _enlarge(part if clip.finish else _brighten(part, _black(clip)), times)[: room[1], :width]
    return np.vstack([picture, np.full((4, *picture.shape[1:]), 90, np.uint8), large])


def measure_speed(frames: int = 40) -> float:
    """Measure the frames per second of one process: two balls, 640 x 480 px, rendered and exposed, after a warm-up."""
    settings = {"launch": {"b": 0.2, "v0": 0.3}, "timing": {"frames": frames, "contact_frame": 0.5 * frames}}
    clip = check_scene(settings, "doctor").draw(0, 0)
    for _ in range(2):
        started = time.perf_counter()
        for _ in clip.pictures():
            pass
        seconds = time.perf_counter() - started
    return frames / seconds
