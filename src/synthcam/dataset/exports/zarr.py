"""Zarr v3: a group for each scene with frames (clip, frame, y, x), truth (clip, particle, frame) and scalars (clip).

Needs the extra `synthcam[zarr]`. Clips of one scene must have the same size and length.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam_shared.errors import InputError

STATES = ("rest", "roll", "slide", "fly")  # by the number that stands for each
CLIPS_PER_CHUNK_OF_TRUTH = 256


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    try:
        import zarr
    except ImportError:
        raise InputError("--format zarr: Zarr is not installed; type: pip install 'synthcam[zarr]'") from None
    root = zarr.open_group(folder, mode="w", zarr_format=3)
    open_scene: _Scene | None = None
    for clip in clips:
        if open_scene is None or clip.scene != open_scene.first.scene:
            if open_scene:
                open_scene.close()
            open_scene = _Scene(root, clip)
        open_scene.add(clip)
    if open_scene:
        open_scene.close()


class _Scene:
    """The arrays of one scene, filled clip by clip; truth and scalars are written a chunk at a time."""

    def __init__(self, root: Any, first: RecordedClip) -> None:
        name = re.sub(r"[^\w.-]", "_", first.scene)
        if not name.strip(".") or name.startswith("__") or name == "zarr.json":  # names that Zarr reserves
            name = f"scene{name}"
        if name in root:
            raise InputError(f"clip {first.number}: a second scene of the name {first.scene}; expected different names")
        self.group, self.first, self.count, self.cameras = root.create_group(name), first, 0, list[dict[str, Any]]()
        self.waiting: list[dict[str, Any]] = []
        if first.video:
            shape = next(first.pictures()).shape
            dtype = np.uint8 if first.bits == 8 else np.uint16
            frames = max(1, 4_000_000 // int(np.prod(shape) * dtype().itemsize))  # 4 MB a chunk
            chunks = (1, min(frames, first.frames), *shape)
            axes = ("clip", "frame", "y", "x", "channel")[: 2 + len(shape)]
            about: dict[str, Any] = {"shape": (first.of, first.frames, *shape), "dtype": dtype, "chunks": chunks}
            self.group.create_array("frames", dimension_names=axes, attributes={}, **about)
        for key, value in _truth(first).items():
            axes = ("clip", "particle", "frame") if value.ndim else ("clip",)
            extra = {"states": list(STATES)} if key == "truth/state" else {}
            chunks = (CLIPS_PER_CHUNK_OF_TRUTH, *value.shape)
            about = {"shape": (first.of, *value.shape), "dtype": value.dtype, "chunks": chunks}
            self.group.create_array(key, dimension_names=axes, attributes=extra, **about)

    def add(self, clip: RecordedClip) -> None:
        same = [(c.camera_json["size"], c.camera_json["fps"], c.bits, c.frames) for c in (clip, self.first)]
        if same[0] != same[1]:
            raise InputError(f"clip {clip.number}: another size, rate or length than clip {self.first.number}")
        if clip.camera_json not in self.cameras:
            self.cameras.append(clip.camera_json)
        if self.first.video:
            self.group["frames"][self.count + len(self.waiting)] = np.stack(list(clip.pictures()))
        self.waiting.append(_truth(clip) | {"camera": np.int64(self.cameras.index(clip.camera_json))})
        if len(self.waiting) == CLIPS_PER_CHUNK_OF_TRUTH:
            self._flush()

    def _flush(self) -> None:
        end = self.count + len(self.waiting)
        for key in self.waiting[0] if self.waiting else ():
            self.group[key][self.count : end] = np.stack([w[key] for w in self.waiting])
        self.count, self.waiting = end, []

    def close(self) -> None:
        self._flush()
        self.group.attrs["cameras"] = self.cameras


def _truth(clip: RecordedClip) -> dict[str, NDArray[Any]]:
    """Arrange the clip's truth as arrays: (particle, frame), and () for one number per clip."""
    balls = int(clip.tracks["particle"].max()) + 1
    out: dict[str, NDArray[Any]] = {"clip": np.asarray(clip.number), "camera": np.asarray(0)}
    ordered = clip.tracks.sort_values(["particle", "frame"])
    for column in ordered.columns.drop(["frame", "particle"]):
        values = ordered[column].to_numpy()
        if column == "state":
            values = np.array([STATES.index(v) for v in values], np.uint8)
        out[f"truth/{column}"] = values.reshape(balls, clip.frames)
    numbers = {k: v for k, v in clip.truth.items() if isinstance(v, float)}
    return out | {f"scalars/{k}": np.asarray(v) for k, v in numbers.items()}
