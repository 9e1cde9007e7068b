"""MOTChallenge: seqinfo.ini, gt/gt.txt and img1/ for each clip; boxes round the balls.

Milan et al. 2016, arXiv:1603.00831: frames, ids and pixels count from 1, the picture's corner being (1, 1). The
flag says whether the ball is whole in view (0: not to be scored), the class is the scored one, 1.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from synthcam.dataset.labelled_frames import encode_png
from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam_shared.track_formats import MOT_CORNER_PX, make_mot_line


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for clip in clips:
        own = folder / f"clip-{clip.number:06d}"
        (own / "gt").mkdir(parents=True)
        (own / "seqinfo.ini").write_text(_info(clip), encoding="ascii")
        (own / "gt" / "gt.txt").write_text("".join(_boxes(clip)), encoding="ascii")
        if clip.video:
            (own / "img1").mkdir()
            for k, frame in enumerate(clip.pictures(), 1):
                (own / "img1" / f"{k:06d}.png").write_bytes(encode_png(frame))


def _info(clip: RecordedClip) -> str:
    width, height = clip.camera_json["size"]
    name, rate = f"clip-{clip.number:06d}", f"{clip.camera_json['fps']:g}"
    entries = {"name": name, "imDir": "img1", "frameRate": rate, "seqLength": f"{clip.frames}"}
    entries |= {"imWidth": width, "imHeight": height, "imExt": ".png"}
    return "[Sequence]\n" + "".join(f"{key}={value}\n" for key, value in entries.items())


def _boxes(clip: RecordedClip) -> Iterator[str]:
    side, size = clip.diameter_px, np.array(clip.camera_json["size"], float)
    tracks = clip.tracks.sort_values(["frame", "particle"])
    positions = tracks[["x_mean_px", "y_mean_px"]].to_numpy(float)
    corners = positions - side / 2 + MOT_CORNER_PX
    seen = np.clip(np.minimum(corners + side, size + 1) - np.maximum(corners, 1), 0, None).prod(axis=1) / side**2
    names = tracks[["frame", "particle", "visible"]].to_numpy(int)
    for (frame, ball, whole), (x, y), share in zip(names, positions, seen, strict=True):
        if share > 0:
            yield make_mot_line(frame, ball, x, y, side, f"{whole},1,{share:.4f}")
