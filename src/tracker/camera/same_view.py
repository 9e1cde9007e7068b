"""Whether two camera files see the same balls at the same pixels."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from tracker.camera.camera import Camera

PLACING = ("K", "dist", "R", "t", "size", "fps", "exposure", "line_time", "ball_diameter", "lamp")
ALIKE = 1e-6  # relative: numbers of two camera files that differ by less are the same


def first_difference(camera: Camera, other: Camera, besides: Collection[str] = ()) -> str:
    """The first key of camera.json by which two cameras see the same balls at other pixels; empty where there is none.

    In what is measured anew of each clip (the exposure as seen, the glints' width) they may differ, and in `besides`.
    """
    for key in (k for k in PLACING if k not in besides):
        one, two = (getattr(c, key) for c in (camera, other))
        if key == "lamp":
            one, two = (lamp.position if lamp else () for lamp in (one, two))
        if np.shape(one) != np.shape(two) or not np.allclose(one, two, ALIKE, ALIKE**2, equal_nan=True):
            return key
    return ""
