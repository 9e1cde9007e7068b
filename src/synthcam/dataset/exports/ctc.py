"""Cell Tracking Challenge: for each clip 01/ with frames, and masks and tracks in 01_GT/SEG and 01_GT/TRA; then 02/.

Maška et al. 2023, Nature Methods 20, 1010. A ball that is out of view for a while has a new label afterwards, with the
label before as its parent. Films in colour become grey.
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import tifffile

from synthcam.dataset.labelled_frames import label_recorded
from synthcam.dataset.recorded_dataset import RecordedClip


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for number, clip in enumerate(clips, 1):
        film, tracking, segmentation = (folder / f"{number:02d}{end}" for end in ("", "_GT/TRA", "_GT/SEG"))
        for each in (film, tracking, segmentation):
            each.mkdir(parents=True)
        balls = int(clip.tracks["particle"].max()) + 1
        digits = max(3, len(str(clip.frames - 1)))
        tracks: list[list[int]] = []  # label, first frame, last frame, parent
        newest: dict[int, int] = {}  # label of each ball
        for frame in label_recorded(clip):
            label_of_pixel = np.zeros(balls + 1, np.uint16)
            for ball in (np.unique(frame.labels[frame.labels > 0]) - 1).tolist():
                parent = newest.get(ball, 0)
                if not parent or tracks[parent - 1][2] < frame.frame - 1:
                    newest[ball] = len(tracks) + 1
                    tracks.append([newest[ball], frame.frame, frame.frame, parent])
                tracks[newest[ball] - 1][2] = frame.frame
                label_of_pixel[ball + 1] = newest[ball]
            name, labels = f"{frame.frame:0{digits}d}.tif", label_of_pixel[frame.labels]
            grey = frame.image if frame.image.ndim == 2 else cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
            tifffile.imwrite(film / f"t{name}", grey)
            tifffile.imwrite(tracking / f"man_track{name}", labels, compression="zlib")
            tifffile.imwrite(segmentation / f"man_seg{name}", labels, compression="zlib")
        lines = (" ".join(map(str, track)) + "\n" for track in tracks)
        (tracking / "man_track.txt").write_text("".join(lines), encoding="ascii")
