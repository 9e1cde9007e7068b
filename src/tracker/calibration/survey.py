"""The size of the balls in one clip: by glints on a dark plate, or by the outlines of discs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from synthcam_shared.jobs import use_one_thread
from tracker.calibration.ball_outline import measure_outline
from tracker.camera.camera import Camera
from tracker.camera.frames import GREY
from tracker.camera.recordings import Recording, RecordingSource, make_recording
from tracker.detection.choose import DISCS
from tracker.detection.contact_distance import ContactDistance, contact_distances
from tracker.detection.detect import detect, find_detected_point, make_view
from tracker.detection.detector import OutlineRadius
from tracker.detection.link import link_into_tracks


@dataclass(frozen=True)
class BallSighting:
    """One clip's part: balls found in all frames together, and how large they are seen."""

    index: int
    camera: Camera  # completed from the clip, as far as its detector does
    balls: int
    contact_distances: list[ContactDistance]
    outline: OutlineRadius | None
    encoded: bool  # with loss


def survey_sizes(source: RecordingSource, known: dict[str, Any], name: str, sized: bool, index: int) -> BallSighting:
    """Survey the size of the balls in clip ``index`` of a source, found by the detector ``name``.

    known: keys of camera.json; sized: whether the scale among them is more than a guess.
    """
    use_one_thread()
    number, frames = source.open_film(index)
    clip = make_recording(number, frames, Camera.from_dict(known), options=source.options)
    clip = clip.select_channel(source.channel or GREY)
    return _survey_discs(clip, index, sized) if name == DISCS else _survey_glints(clip, name, index)


def without_scale(clip: Recording) -> Recording:
    """Return the recording for a survey of sizes, in which nothing ties pixels to metres."""
    bare = Camera.unknown(clip.camera.size, clip.camera.sensor.bits)
    return replace(clip, camera=replace(bare, sensor=clip.camera.sensor))


def _survey_glints(clip: Recording, name: str, index: int) -> BallSighting:
    view = make_view(clip)
    glints = detect(clip, view, name).glints
    tracks = link_into_tracks(glints, view.camera)
    encoded = view.camera.sensor.codec_noise > 0
    seen = None if encoded else measure_outline(clip.frames, view.plate, glints, view.sigma)
    if seen is not None:
        # 1/m, scatter of 1/height of the lamp less that of the camera: distances of glints differ from those of balls
        seen = replace(seen, std=math.hypot(seen.std, 2.5 * clip.camera.ball_diameter / 4 * seen.radius))
    return BallSighting(index, view.camera, len(tracks), contact_distances(tracks), seen, encoded)


def _survey_discs(clip: Recording, index: int, sized: bool) -> BallSighting:
    looked_at = clip if sized else without_scale(clip)
    view = make_view(looked_at, DISCS)
    found = detect(looked_at, view, DISCS)
    lossy = clip.frames.lossy
    takes = view.takes.spans if view.takes else ()
    tracks = link_into_tracks(found.glints, view.camera, find_detected_point(DISCS, view.camera), takes)
    # px, of a contact in lossy video: read from ten drawn films of discs at H.264, crf 28
    contacts = [replace(c, std=math.hypot(c.std, 0.3 * lossy)) for c in contact_distances(tracks)]
    outline = found.outline_radius
    if outline is not None:
        # 2 % of the radius: a ball is darker at its limb, and encoders move edges
        outline = replace(outline, std=math.hypot(outline.std, 0.02 * outline.radius))
    return BallSighting(index, clip.camera, len(tracks), contacts, outline, lossy)
