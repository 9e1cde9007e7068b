"""What one clip shows of the size of its balls: by glints on a dark plate, or by the outlines of discs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from tracker.calibration.ball_outline import Outline, measure_outline
from tracker.calibration.contact_distance import ContactDistance, contact_distances
from tracker.camera.camera import Camera
from tracker.camera.frames import Clip, Source, recorded
from tracker.detection.choose import DISCS
from tracker.detection.detect import detect, detector, point_of, searched, view_of
from tracker.detection.link import link
from tracker.parallel import alone

DISC_SYSTEMATIC = 0.02  # of the radius: a ball is darker at its limb, and encoders move edges
HEIGHTS = 2.5  # 1/m, scatter of 1/height of lamp less that of the camera: glints' distances differ from the balls'
ENCODED_PX = 0.3  # of a contact's distance in lossy video: read from ten drawn films of discs at H.264, crf 28


@dataclass(frozen=True)
class BallSighting:
    """One clip's part: balls found in all frames together, and how large they are seen.

    Attributes
    ----------
    index : int
    camera : Camera
        Completed from the clip, as far as its detector does.
    balls : int
    contact_distances : list of ContactDistance
    outline : Outline or None
    encoded : bool
        Video encoded with loss.
    """

    index: int
    camera: Camera
    balls: int
    contact_distances: list[ContactDistance]
    outline: Outline | None
    encoded: bool


def survey(source: Source, known: dict[str, Any], name: str, sized: bool, index: int) -> BallSighting:
    """Clip ``index`` of a source, searched by the detector ``name``.

    known: keys of camera.json; sized: whether the scale among them is more than a guess.
    """
    alone()
    number, frames = source.film(index)
    clip = recorded(number, frames, Camera.from_dict(known), ("", "")).in_channel(source.channel)
    return _discs(clip, index, sized) if name == DISCS else _glints(clip, name, index)


def without_scale(clip: Clip) -> Clip:
    """The same recording, in which nothing ties pixels to metres."""
    bare = Camera.unknown(clip.camera.size, clip.camera.sensor.bits)
    return replace(clip, camera=replace(bare, sensor=clip.camera.sensor))


def _glints(clip: Clip, name: str, index: int) -> BallSighting:
    view = view_of(clip)
    glints = detect(clip, view, name)
    tracks = link(glints, view.camera)
    encoded = view.camera.sensor.codec_noise > 0
    seen = None if encoded else measure_outline(clip.frames, view.plate, glints, view.sigma)
    if seen is not None:
        seen = replace(seen, std=math.hypot(seen.std, HEIGHTS * clip.camera.ball_diameter / 4 * seen.radius))
    return BallSighting(index, view.camera, len(tracks), contact_distances(tracks), seen, encoded)


def _discs(clip: Clip, index: int, sized: bool) -> BallSighting:
    looked_at = clip if sized else without_scale(clip)
    view = view_of(looked_at, DISCS)
    finder: Any = detector(DISCS)(view)
    lossy = clip.frames.lossy
    tracks = link(
        searched(looked_at, finder, DISCS),
        view.camera,
        point_of(DISCS, view.camera),
        view.takes.spans if view.takes else (),
    )
    contacts = [replace(c, std=math.hypot(c.std, ENCODED_PX * lossy)) for c in contact_distances(tracks)]
    return BallSighting(index, clip.camera, len(tracks), contacts, _outline(finder), lossy)


def _outline(finder: Any) -> Outline | None:
    radius, std = finder.seen_radius()
    return Outline(radius, math.hypot(std, DISC_SYSTEMATIC * radius)) if radius > 0 else None
