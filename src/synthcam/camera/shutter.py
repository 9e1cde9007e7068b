"""Compose the picture of a rolling shutter, which exposes each row a line time after the row above.

A row sees what a global shutter sees that opens at the row's time. Such pictures are made at steps of the balls' motion
and interpolated between. Positions stay exact; the variance of a spot grows by at most step^2/4.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.exposure import Array, Picture, merge_boxes
from synthcam.camera.pinhole import PinholeCamera

Float32 = NDArray[np.float32]
Gather = Callable[[Array], list[Picture]]


def roll_shutter(
    camera: PinholeCamera,
    seen: Callable[[Array], tuple[Array, Array]],
    span: Array,
    cuts: Array,
    gather: Gather,
    plate: Float32,
) -> Picture:
    """Compose one frame.

    Parameters
    ----------
    camera : PinholeCamera
    seen : callable
        Times (T,), s -> pixels (T, N, 2) and half widths (T, N) px of the balls.
    span : ndarray of shape (2,)
        Exposure of the top row, s.
    cuts : ndarray
        Times at which velocities jump, s.
    gather : callable
        Exposures (F, 2), s -> pictures of a global shutter.
    plate : ndarray of shape (h, w)
        The frame without balls.
    """
    image, boxes = plate.copy(), []
    rows, delay = np.arange(camera.size[1]), camera.line_time
    for rows_from, rows_to, steps in _strips(camera, seen, span, cuts):
        anchors = np.linspace(rows_from, rows_to - 1, steps + 1)
        pictures = gather(span + anchors[:, None] * delay)
        position = (rows[rows_from:rows_to] - anchors[0]) / max(anchors[-1] - anchors[0], 1) * steps
        for k, (before, after) in enumerate(pairwise(pictures)):
            own = np.arange(rows_from, rows_to)[(np.minimum(position.astype(int), steps - 1)) == k]
            if len(own):
                part, share = slice(own[0], own[-1] + 1), (position[own - rows_from] - k)[:, None].astype(np.float32)
                for picture, weight in ((before, 1 - share), (after, share)):
                    image[part] += weight * (picture.image[part] - picture.plate[part])
        for picture in pictures:
            for at_rows, columns in picture.boxes:
                top, bottom = max(at_rows.start, rows_from), min(at_rows.stop, rows_to)
                if top < bottom:
                    boxes.append((top, bottom, columns.start, columns.stop))
    disjoint = merge_boxes(boxes)
    return Picture(plate, disjoint, tuple(image[box] for box in disjoint))


def _strips(
    camera: PinholeCamera, seen: Callable[[Array], tuple[Array, Array]], span: Array, cuts: Array, step_px: float = 0.1
) -> list[tuple[int, int, int]]:
    """Rows (first, beyond) in which balls may show while those rows are exposed, and the number of steps over them."""
    height, delay = camera.size[1], camera.line_time
    probes = np.linspace(span[0], span[1] + height * delay, 33)
    inside = cuts[(cuts > probes[0]) & (cuts < probes[-1])]
    times = np.unique(np.concatenate([probes, inside]))
    pixels, half = seen(times)
    strips: list[list[float]] = []
    for ball in range(half.shape[1]):
        y, reach = pixels[:, ball, 1], half[:, ball]
        # Row r is exposed from r delay on: the ball shows there only if it is in that row at that time.
        first, last = (times - span[1]) / delay, (times - span[0]) / delay
        slack = reach + np.abs(np.diff(y, prepend=y[0])) + (times[1] - times[0]) / delay
        there = (y + slack > first) & (y - slack < last)
        if there.any():
            low, high = (y - reach)[there].min() - 1, (y + reach)[there].max() + 2
            speed = np.linalg.norm(np.diff(pixels[:, ball], axis=0), axis=1) / np.diff(times)
            strips.append([max(low, 0), min(high, height), float(speed.max())])
    merged: list[list[float]] = []
    for low, high, speed in sorted(s for s in strips if s[0] < s[1]):
        if merged and low <= merged[-1][1]:
            merged[-1] = [merged[-1][0], max(high, merged[-1][1]), max(speed, merged[-1][2])]
        else:
            merged.append([low, high, speed])
    out = []
    for low, high, speed in merged:
        top, bottom = int(low), int(np.ceil(high))
        out.append((top, bottom, max(1, int(np.ceil(speed * delay * (bottom - top) / step_px)))))
    return out
