"""Check the unit of positions that say none: the distance of two balls that touch is a diameter in the right one."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.detection.contact_distance import contact_distances
from tracker.detection.link import Tracks
from tracker.tables.table import LENGTH_UNITS

CommonFrames: TypeAlias = tuple[Any, Any, Any, Any]
MAX_CLIPS = 20  # whose contacts are looked at
MAX_APPROACHES = 100  # of two balls that are looked at: the nearest, because a contact is one


@dataclass(frozen=True)
class NearestDistance:
    """How near two balls come, in the unit of a table, compared with a diameter."""

    distance: float  # at their contacts, or the least distance where no contact was found
    least: float  # the least distance, as far as the frames resolve it
    is_contact: bool  # `distance` is that of contacts
    tolerance: tuple[float, float]  # between which the logarithm of `distance` over a diameter lies in the right unit
    tolerance_px: tuple[float, float]  # the same for px, whose scale may be wrong
    max_deviation: float  # by which this logarithm deviates from 0 in a unit that is likely


@dataclass(frozen=True)
class UnitEvidence:
    """Lengths in a table without a unit, and what they say for px and for the likeliest other unit."""

    nearest: NearestDistance
    spread: float  # the largest extent of a clip, in the unit of the table
    is_beyond_picture: bool  # most positions lie beyond twice the picture, if they are px
    unit: str  # the unit other than px in which the nearest distance is most like a diameter
    fits: bool  # a diameter explains the nearest distance in `unit`
    fits_px: bool  # the same in px
    is_likely: bool  # `unit` explains it roughly
    is_likelier_than_px: bool  # `unit` explains it well while px does not


def check_unit(clips: Sequence[Tracks], camera: Camera, where: str) -> list[str]:
    """Notes about positions that are hardly px; raises InputError for those that no two balls can have.

    A contact gives the distance of two balls that touch. Without one there is a bound: two balls are never nearer than
    a diameter. Hardly any track lies outside the picture, in any unit. If px and another unit explain the tracks
    equally well, the note names both.
    """
    pairs = [(tracks, pair) for tracks in clips if (pair := find_common_frames(tracks)) is not None]
    if not pairs or not camera.metric or not camera.knows_diameter:
        return []
    return _judge_unit(_measure_unit(pairs, camera), camera, where)


def _measure_unit(pairs: Sequence[tuple[Tracks, CommonFrames]], camera: Camera) -> UnitEvidence:
    """Measure how near balls come and how far tracks extend, and compare both with a diameter and the picture."""
    both = [np.concatenate((one, two)) for _, (_, one, two, _) in pairs]
    usual = float(np.median([np.ptp(np.percentile(xy, (2, 98), axis=0), axis=0).max() for xy in both]))
    far = float(np.median([np.median(np.abs(xy).max(axis=1)) for xy in both])) / max(camera.size)
    nearest = _measure_nearest(pairs, camera)
    distance = max(nearest.distance, 1e-300)
    units = ("m", "cm", "mm", "um")  # that positions are usually in, where they are not px
    off = {u: math.log(distance * LENGTH_UNITS[u][0] / camera.ball_diameter) for u in units}
    off_px = math.log(distance / camera.diameter_px)
    # tracks that are larger than the picture in a unit are not in it
    inside = [u for u in units if usual * LENGTH_UNITS[u][0] / camera.scale < 1.3 * max(camera.size)]
    unit = min(inside or units, key=lambda name: abs(off[name]))
    fits = unit in inside and nearest.tolerance[0] < off[unit] < nearest.tolerance[1]
    is_likely = unit in inside and (fits if nearest.is_contact else abs(off[unit]) < nearest.max_deviation)
    return UnitEvidence(
        nearest=nearest,
        spread=max(float(np.ptp(xy, axis=0).max()) for xy in both),
        is_beyond_picture=far > 2,
        unit=unit,
        fits=fits,
        fits_px=nearest.tolerance_px[0] < off_px < nearest.tolerance_px[1],
        is_likely=is_likely,
        is_likelier_than_px=is_likely and abs(off[unit]) < 0.1 < abs(off_px),
    )


def _measure_nearest(pairs: Sequence[tuple[Tracks, CommonFrames]], camera: Camera) -> NearestDistance:
    """Measure how near two balls come: at their contacts, or else at their closest approach."""
    approaches = sorted(_closest_approach(*pair) for _, pair in pairs)
    least, step = approaches[(len(pairs) - 1) // 4]
    if touches := [touch for clip in pairs[:: -(-len(pairs) // MAX_CLIPS)] for touch in _touch(*clip)]:
        distances, errors = np.array(touches).T
        median = float(np.median(distances))
        scatter = 1.4826 * float(np.median(np.abs(distances - median)))
        error = math.hypot(float(np.median(errors)), scatter / median) / math.sqrt(len(touches))
        # lasting contacts bring centres of rubber a few per cent nearer; a scale has errors that no file states
        off = 0.04 + 3 * math.hypot(error, camera.ball_diameter_std / camera.ball_diameter)
        wide = max(off, 0.1)
        return NearestDistance(median, least, True, (-off, off), (-wide, wide), off)
    # the least distance is a diameter, as far as the frames resolve it
    unresolved = min(math.log(least / (least - step)), 0.7) if step < least else 0.7
    bounds = (-0.1, max(0.1, unresolved))
    return NearestDistance(least, least, False, bounds, bounds, 0.25)


def _judge_unit(evidence: UnitEvidence, camera: Camera, where: str) -> list[str]:
    """Judge whether positions are px: no message if they may be, a note if not, InputError if they cannot be."""
    nearest, unit = evidence.nearest, evidence.unit
    touching = camera.diameter_px
    # no two balls come nearer than this, whatever the errors of a scale
    too_near = nearest.distance < 0.6 * touching
    verb = "touch at" if nearest.is_contact else "come as near as"
    message = f"the balls {verb} {nearest.distance:.3g}; expected px, and {touching:.3g} of them, a diameter"
    refusal = f"{where}: x, y: positions look like {unit}: {message}; `tracker measure --unit {unit}` reads them"
    if evidence.is_likely and (too_near or evidence.is_beyond_picture):
        raise InputError(refusal)
    if evidence.is_beyond_picture:
        side = max(camera.size)
        raise InputError(
            f"{where}: x, y: most positions lie beyond twice the picture of {side} px; --unit says the unit"
        )
    if too_near and evidence.spread < 3 * touching:
        raise InputError(
            f"{where}: x, y: all balls lie within {evidence.spread:.3g} px and come as near as"
            f" {nearest.distance:.2g} px, expected {touching:.3g} px, a diameter; --unit says the unit, --decimal the"
            " decimal mark; or check ball_diameter"
        )
    if nearest.least == 0:  # the same ball, or lost positions, twice
        return []
    if evidence.fits and too_near:
        raise InputError(refusal)
    return _note_unit(evidence, camera, message, too_near)


def _note_unit(evidence: UnitEvidence, camera: Camera, message: str, too_near: bool) -> list[str]:
    """Note which unit, scale or diameter would explain positions that px explain badly."""
    nearest, unit = evidence.nearest, evidence.unit
    touching, diameter = camera.diameter_px, camera.ball_diameter
    true_scale = diameter / nearest.distance
    if (evidence.fits and not evidence.fits_px) or evidence.is_likelier_than_px:
        return [
            f"{message}. Either positions are in {unit}, and `tracker measure --unit {unit}` reads them; or they are "
            f"in px, and scale is about {true_scale:.3g} m/px rather than {camera.scale:.3g}"
        ]
    if evidence.fits and nearest.is_contact and abs(math.log(LENGTH_UNITS[unit][0] / camera.scale)) > 0.005:
        return [
            f"the balls touch at {nearest.distance:.3g}, which is a diameter both in px ({touching:.3g}) and in {unit} "
            f"({diameter / LENGTH_UNITS[unit][0]:.3g}); --unit px or --unit {unit} says which it is"
        ]
    if too_near and nearest.is_contact:
        return [
            f"{message}; no unit explains that. Either scale is about {true_scale:.3g} m/px rather than "
            f"{camera.scale:.3g}, or ball_diameter {nearest.distance * camera.scale:.3g} m rather than {diameter:.3g}"
        ]
    if too_near:
        return [f"{message}; check scale and ball_diameter, or say the unit of x and y by --unit"]
    return []


def _touch(tracks: Tracks, pair: CommonFrames) -> list[tuple[float, float]]:
    """Find the contacts of two balls: their distances, with relative errors from the scatter of their positions."""
    step_px = 2.0  # lengths are scaled so that the faster ball moves as far in a frame, as `contact_distances` expects
    least_std = 0.02  # of a position, for tables without noise
    particles, one, two, frame = pair
    steps = np.concatenate([np.hypot(*np.diff(xy, axis=0).T) / np.diff(frame) for xy in (one, two)])
    fast = float(np.percentile(steps, 95)) if len(steps) else 0.0
    if not fast > 0:
        return []
    factor = step_px / fast
    bends = np.concatenate([np.diff(factor * xy, 3, axis=0) for xy in (one, two)])
    std = max(1.4826 * float(np.median(np.abs(bends))) / math.sqrt(20.0), least_std) if len(bends) else least_std
    taken = tracks.take(np.isin(tracks.particle, particles))
    cov = np.broadcast_to(std**2 * np.eye(2), taken.cov.shape)
    scaled = replace(taken, x=factor * taken.x, y=factor * taken.y, cov=cov, fixed=np.zeros_like(taken.cov))
    # two balls whose numbers are exchanged seem to pass through each other
    least = 0.4 * factor * float(np.hypot(*(one - two).T).min())
    found = [contact for contact in contact_distances(scaled, MAX_APPROACHES) if contact.distance > least]
    return [(contact.distance / factor, contact.std / contact.distance) for contact in found]


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


def find_common_frames(tracks: Tracks) -> CommonFrames | None:
    """The numbers of the two balls seen most often, their positions (k, 2) in the frames of both, and these frames."""
    particles, counts = np.unique(tracks.particle, return_counts=True)
    if len(particles) < 2:
        return None
    often = particles[np.argsort(-counts, kind="stable")[:2]]
    first, second = (np.flatnonzero(tracks.particle == p) for p in often)
    frame, one, two = np.intersect1d(tracks.frame[first], tracks.frame[second], return_indices=True)
    return (often, tracks.xy[first[one]], tracks.xy[second[two]], frame) if len(frame) else None
