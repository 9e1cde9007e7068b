"""Check the unit of positions that say none: the distance of two balls that touch is a diameter in the right one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeAlias

import numpy as np

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.detection.contact_distance import contact_distances
from tracker.detection.link import Tracks
from tracker.tables.table import LENGTH_UNITS

UNITS = ("m", "cm", "mm", "um")  # that positions are usually in, where they are not px
CommonFrames: TypeAlias = tuple[Any, Any, Any, Any]
MAX_CLIPS = 20  # whose contacts are looked at


@dataclass(frozen=True)
class TouchingDistance:
    """The distance of two balls that touch, in the unit of a table, and its relative error."""

    distance: float
    error: float


def check_unit(clips: Sequence[Tracks], camera: Camera, where: str) -> list[str]:
    """Notes about positions that are hardly px; raises InputError for those that no two balls can have.

    A contact gives the distance of two balls that touch. Without one there is a bound: two balls are never nearer than
    a diameter. Hardly any track lies outside the picture, in any unit. Where px and another unit explain the tracks
    equally well, the note names both.
    """
    pairs = [(tracks, pair) for tracks in clips if (pair := common_frames(tracks)) is not None]
    if not pairs or not camera.metric or not camera.knows_diameter:
        return []
    touching, diameter = camera.diameter_px, camera.ball_diameter
    both = [np.concatenate((one, two)) for _, (_, one, two, _) in pairs]
    spread = max(float(np.ptp(xy, axis=0).max()) for xy in both)
    usual = float(np.median([np.ptp(np.percentile(xy, (2, 98), axis=0), axis=0).max() for xy in both]))
    far = float(np.median([np.median(np.abs(xy).max(axis=1)) for xy in both])) / max(camera.size)
    approaches = sorted(_closest_approach(*pair) for _, pair in pairs)
    least, step = approaches[(len(pairs) - 1) // 4]
    contact = _measure_contact(pairs[:: -(-len(pairs) // MAX_CLIPS)])
    nearest = contact.distance if contact else least
    off = {u: math.log(max(nearest, 1e-300) * LENGTH_UNITS[u][0] / diameter) for u in UNITS}
    # tracks that are larger than the picture in a unit are not in it
    inside = [u for u in UNITS if usual * LENGTH_UNITS[u][0] / camera.scale < 1.3 * max(camera.size)]
    unit = min(inside or UNITS, key=lambda name: abs(off[name]))
    off_px = math.log(max(nearest, 1e-300) / touching)
    if contact:
        # lasting contacts bring centres of rubber a few per cent nearer; a scale has errors that no file states
        tolerance = 0.04 + 3 * math.hypot(contact.error, camera.ball_diameter_std / diameter)
        fits, fit_in_px = abs(off[unit]) < tolerance, abs(off_px) < max(tolerance, 0.1)
        likely = fits
    else:
        # the least distance is a diameter, as far as the frames resolve it
        unresolved = min(math.log(least / (least - step)), 0.7) if step < least else 0.7
        fits, fit_in_px = (-0.1 < ratio < max(0.1, unresolved) for ratio in (off[unit], off_px))
        likely = abs(off[unit]) < 0.25
    fits, likely = fits and unit in inside, likely and unit in inside
    # no two balls come nearer than this, whatever the errors of a scale
    too_near = nearest < 0.6 * touching
    verb = "touch at" if contact else "come as near as"
    message = f"the balls {verb} {nearest:.3g}; expected px, and {touching:.3g} of them, a diameter"
    refusal = f"{where}: x, y: positions look like {unit}: {message}; `tracker measure --unit {unit}` reads them"
    if likely and (too_near or far > 2):
        raise InputError(refusal)
    if far > 2:
        side = max(camera.size)
        raise InputError(
            f"{where}: x, y: most positions lie beyond twice the picture of {side} px; --unit says the unit"
        )
    if too_near and spread < 3 * touching:
        raise InputError(
            f"{where}: x, y: all balls lie within {spread:.3g} px and come as near as {nearest:.2g} px, expected"
            f" {touching:.3g} px, a diameter; --unit says the unit, --decimal the decimal mark; or check ball_diameter"
        )
    if least == 0:  # the same ball, or lost positions, twice
        return []
    if fits and too_near:
        raise InputError(refusal)
    true_scale = diameter / nearest
    if (fits and not fit_in_px) or (likely and abs(off[unit]) < 0.1 < abs(off_px)):
        return [
            f"{message}. Either positions are in {unit}, and `tracker measure --unit {unit}` reads them; or they are "
            f"in px, and scale is about {true_scale:.3g} m/px rather than {camera.scale:.3g}"
        ]
    if fits and contact and abs(math.log(LENGTH_UNITS[unit][0] / camera.scale)) > 0.005:
        return [
            f"the balls touch at {nearest:.3g}, which is a diameter both in px ({touching:.3g}) and in {unit} "
            f"({diameter / LENGTH_UNITS[unit][0]:.3g}); --unit px or --unit {unit} says which it is"
        ]
    if too_near and contact:
        return [
            f"{message}; no unit explains that. Either scale is about {true_scale:.3g} m/px rather than "
            f"{camera.scale:.3g}, or ball_diameter {nearest * camera.scale:.3g} m rather than {diameter:.3g}"
        ]
    if too_near:
        return [f"{message}; check scale and ball_diameter, or say the unit of x and y by --unit"]
    return []


def _measure_contact(pairs: Sequence[tuple[Tracks, CommonFrames]]) -> TouchingDistance | None:
    """Measure the distance of two balls at their contacts, where their velocities change; None without one."""
    found = [touch for tracks, pair in pairs for touch in _touch(tracks, pair)]
    if not found:
        return None
    distances = np.array([touch.distance for touch in found])
    median = float(np.median(distances))
    scatter = 1.4826 * float(np.median(np.abs(distances - median)))
    errors = float(np.median([touch.error for touch in found]))
    return TouchingDistance(median, math.hypot(errors, scatter / median) / math.sqrt(len(found)))


def _touch(
    tracks: Tracks, pair: CommonFrames, *, step_px: float = 2.0, least_std: float = 0.02
) -> list[TouchingDistance]:
    """Find the contacts of two balls, with errors from the scatter of their positions.

    step_px: lengths are scaled so that the faster ball moves as far in a frame, as `contact_distances` expects.
    least_std: the least error of a position, for tables without noise.
    """
    particles, one, two, frame = pair
    steps = np.concatenate([np.hypot(*np.diff(xy, axis=0).T) / np.diff(frame) for xy in (one, two)])
    fast = float(np.percentile(steps, 95)) if len(steps) else 0.0
    if not fast > 0:
        return []
    factor = step_px / fast
    bends = np.concatenate([np.diff(factor * xy, 3, axis=0) for xy in (one, two)])
    std = max(1.4826 * float(np.median(np.abs(bends))) / math.sqrt(20.0), least_std) if len(bends) else least_std
    rows = np.flatnonzero(np.isin(tracks.particle, particles))
    taken = replace(tracks, **{f.name: getattr(tracks, f.name)[rows] for f in fields(tracks)})
    cov = np.broadcast_to(std**2 * np.eye(2), taken.cov.shape)
    scaled = replace(taken, x=factor * taken.x, y=factor * taken.y, cov=cov, fixed=np.zeros_like(taken.cov))
    # two balls whose numbers are exchanged seem to pass through each other
    least = 0.4 * factor * float(np.hypot(*(one - two).T).min())
    found = [contact for contact in contact_distances(scaled) if contact.distance > least]
    return [TouchingDistance(contact.distance / factor, contact.std / contact.distance) for contact in found]


def _closest_approach(particles: Any, one: Any, two: Any, frame: Any) -> tuple[float, float]:
    """The least distance of two balls, and how far they move relative to each other in a frame there, px.

    Between two frames their relative path is straight, unless they exchange sides: then their numbers may be exchanged.
    """
    apart = one - two
    start, step = apart[:-1], np.diff(apart, axis=0)
    step[(np.diff(frame) > 1) | ((apart[1:] * start).sum(axis=1) < 0)] = 0.0
    square = (step**2).sum(axis=1)
    share = np.clip(-(start * step).sum(axis=1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    between = np.hypot(*(start + share[:, None] * step).T)
    distance = np.append(between, np.hypot(*apart[-1]))
    nearest = int(np.argmin(distance))
    steps = np.sqrt(square[max(nearest - 1, 0) : nearest + 2])
    return float(distance[nearest]), float(steps.max(initial=0.0))


def common_frames(tracks: Tracks) -> CommonFrames | None:
    """The numbers of the two balls seen most often, their positions (k, 2) in the frames of both, and these frames."""
    particles, counts = np.unique(tracks.particle, return_counts=True)
    if len(particles) < 2:
        return None
    often = particles[np.argsort(-counts, kind="stable")[:2]]
    first, second = (np.flatnonzero(tracks.particle == p) for p in often)
    frame, one, two = np.intersect1d(tracks.frame[first], tracks.frame[second], return_indices=True)
    return (often, tracks.xy[first[one]], tracks.xy[second[two]], frame) if len(frame) else None
