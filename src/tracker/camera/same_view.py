"""Compares two cameras: the first key by which they see the same balls at other pixels."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from tracker.camera.camera import Camera


def first_difference(camera: Camera, other: Camera, besides: Collection[str] = ()) -> str:
    """The first key of camera.json by which two cameras see the same balls at other pixels; empty if there is none.

    They may differ in what each clip measures again (exposure from the blur, width of the glints), and in `besides`.
    Numbers that agree to a millionth are equal.
    """
    keys = ("K", "dist", "R", "t", "size", "fps", "exposure", "line_time", "ball_diameter", "lamp")
    for key in (k for k in keys if k not in besides):
        one, two = (getattr(c, key) for c in (camera, other))
        if key == "lamp":
            one, two = (lamp.position if lamp else () for lamp in (one, two))
        if np.shape(one) != np.shape(two) or not np.allclose(one, two, 1e-6, 1e-12, equal_nan=True):
            return key
    return ""
