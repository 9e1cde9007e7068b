"""Computes the first-order response of tracks to small changes of a law, by integrals over the motion.

Sliding, with u the contact velocity, q = v - (2/7) u and a change m of friction, p of the push:
    du_along' = p_along - (7/2) N m,   du_across = |u| Int p_across/|u|,   dq' = (5/7) p
Rolling, with a change l of the loss:
    dv_along' + drag dv_along = (5/7) p_along - l,   dv_across = |v| Int (5/7) p_across/|v|
A slide ends later by dT = du_along / |u|'. The ball then rolls with dq less its deceleration times dT.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C, WITH_SPIN
from discrepancy.fitting.predict import map_by_frame_rate
from discrepancy.time_left import report_progress
from synthcam.dynamics.batch import CollisionBatch, solve_collisions
from synthcam.dynamics.kinematics import contact_velocity
from synthcam.model import Model
from synthcam_shared.arrays import Array, Flags, Index, Ints

LawChange = Callable[["ResponseSegment"], Array]  # (k, m, J) of friction and loss, (k, m, 2, J) of the push

TIMES_PER_SEGMENT = 65  # times of a segment


@dataclass(frozen=True)
class ResponseSegment:
    """Position, velocity and contact velocity (k, m, 2) of k balls at m times; directions exist where motion ends."""

    times: Array
    place: Array
    velocity: Array
    contact: Array

    @classmethod
    def of(cls, motion: CollisionBatch, radius: float, begins: Array, ends: Array) -> ResponseSegment:
        times = begins[:, None] + (ends - begins)[:, None] * np.linspace(0, 1, TIMES_PER_SEGMENT)
        inside = np.clip(times, motion.start, motion.end)
        states = motion.at(inside).reshape(len(times), TIMES_PER_SEGMENT, 9)
        return cls(times, states[..., :2], states[..., 3:5], contact_velocity(states, radius))

    def __getitem__(self, rows: slice | Flags | Ints) -> ResponseSegment:
        return ResponseSegment(self.times[rows], self.place[rows], self.velocity[rows], self.contact[rows])

    @property
    def speed(self) -> Array:
        return np.asarray(np.hypot(self.velocity[..., 0], self.velocity[..., 1]))

    @property
    def slip_speed(self) -> Array:
        return np.asarray(np.hypot(self.contact[..., 0], self.contact[..., 1]))

    @property
    def direction(self) -> Array:
        """Direction of the velocity."""
        return np.asarray(self.velocity / np.maximum(self.speed, 1e-12)[..., None])

    @property
    def slip(self) -> Array:
        """Direction of the contact velocity at the start."""
        first = self.contact[:, :1] / np.maximum(self.slip_speed[:, :1], 1e-12)[..., None]
        return np.asarray(np.broadcast_to(first, self.contact.shape))


def compute_responses(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], changes: Mapping[str, LawChange], size: int
) -> list[Array]:
    """Compute the responses of tracks to many changes of laws: (n, 2, size) for each clip, m for a change of one unit.

    changes: for "friction", "rolling" or "push", what `size` changes add to the law on a segment. Responses that
    overflow are zero.
    """
    batch = 32  # clips

    def of(rows: Ints, own: Sequence[MeasuredCollision]) -> list[Array]:
        parts = [slice(k, k + batch) for k in range(0, len(own), batch)]
        found = list[Array]()
        for part in parts:
            report_progress()  # the derivatives by one law of many clips may take minutes
            found += _respond_one_rate(model, launches[rows[part]], own[part], changes, size)
        return found

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        out = map_by_frame_rate(clips, of)
    return [np.nan_to_num(xy, copy=False, nan=0.0, posinf=0.0, neginf=0.0) for xy in out]


def _respond_one_rate(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], changes: Mapping[str, LawChange], size: int
) -> list[Array]:
    fps, exposure = clips[0].fps, clips[0].exposure
    start = min(min(int(c.frame.min()) for c in clips) / fps, float(launches[:, T_C].min()))
    whole = max(int(c.frame.max()) for c in clips)
    ends = tuple(((int(c.frame.max()) if c.is_stretch else whole) + 1) / fps + exposure for c in clips)
    split = _split_motion(model, launches.tobytes(), tuple(c.striker == "a" for c in clips), start, ends)
    every_ball = [k + clip.ball * len(clips) for k, clip in enumerate(clips)]
    seen = np.unique(np.concatenate(every_ball))  # of a stretch only the striker is
    early, slide, roll = (segment[seen] for segment in split)
    contact, over = slide.times[:, 0], roll.times[:, 0]
    parts = -(-len(contact) * TIMES_PER_SEGMENT * 2 * size // 250_000)  # numbers that fit into the processor's cache
    cuts = np.linspace(0, len(contact), min(parts, len(contact)) + 1).astype(int).tolist()
    rows = [slice(a, b) for a, b in itertools.pairwise(cuts)]
    has_past = not all(clip.is_stretch for clip in clips)
    blocks = [_shift_segments(model, early[r] if has_past else None, slide[r], roll[r], changes, size) for r in rows]
    shifts = [np.concatenate(segment) for segment in zip(*blocks, strict=True)]
    out = []
    for clip, own_ball in zip(clips, every_ball, strict=True):
        ball = np.searchsorted(seen, own_ball)
        when = clip.frame / fps + exposure / 2
        which = np.where(when < contact[ball], 0, np.where(when < over[ball], 1, 2))
        xy = np.zeros((len(when), 2, size))
        for part, (segment, shift) in enumerate(zip((early, slide, roll), shifts, strict=True)):
            own = np.flatnonzero(which == part)
            xy[own] = _interpolate(segment.times[ball[own]], shift, ball[own], when[own])
        out.append(xy)
    return out


@lru_cache(maxsize=16)
def _split_motion(
    model: Model, launches: bytes, a_strikes: tuple[bool, ...], start: float, ends: tuple[float, ...]
) -> tuple[ResponseSegment, ResponseSegment, ResponseSegment]:
    """The segments before the contact, sliding and rolling; cached, since many laws are tried on one motion."""
    places = np.frombuffer(launches).reshape(len(a_strikes), -1)
    motion = solve_collisions(model, places, start, max(ends), a_strikes, np.array(ends))
    contact, end = np.tile(places[:, T_C], 2), np.tile(ends, 2)
    spins = places.shape[1] == WITH_SPIN
    before = np.nextafter(contact, -np.inf) if spins else contact  # with the slip before the contact
    over = np.minimum(motion.slide_ends, end)
    spans = (before, np.full(len(contact), start)), (contact, over), (over, end)
    early, slide, roll = (ResponseSegment.of(motion, model.ball.radius, *span) for span in spans)
    return early, slide, roll


def _shift_segments(
    model: Model,
    early: ResponseSegment | None,
    slide: ResponseSegment,
    roll: ResponseSegment,
    changes: Mapping[str, LawChange],
    size: int,
) -> tuple[Array, Array, Array]:
    """Shifts (k, m, 2, J) of some balls in each of their three segments; early: None if nobody sees the first."""
    nothing, came = np.zeros((len(roll.times), 2, size)), np.zeros((len(roll.times), TIMES_PER_SEGMENT, 2, size))
    if early is not None:
        came, slides = (
            _shift_rolling(model, early, changes, size, nothing, nothing),
            early.slip_speed.min(axis=1) > 1e-6,
        )
        if slides.any():
            came[slides] = _shift_sliding(model, early[slides], early[slides], changes, size)[0]
    slid, left = np.zeros((len(roll.times), TIMES_PER_SEGMENT, 2, size)), nothing
    if np.any(slide.times[:, -1] > slide.times[:, 0]):
        slid, left = _shift_sliding(model, slide, roll, changes, size)
    return came, slid, _shift_rolling(model, roll, changes, size, slid[:, -1], left)


def _shift_sliding(
    model: Model, segment: ResponseSegment, after: ResponseSegment, changes: Mapping[str, LawChange], size: int
) -> tuple[Array, Array]:
    """Shifts (k, m, 2, J) in a slide, and the change of the velocity (k, 2, J) at the start of rolling."""
    slip, u = segment.slip, segment.slip_speed
    across = np.stack([-slip[..., 1], slip[..., 0]], axis=-1)
    push = _evaluate_change(changes, "push", segment, (2, size))
    friction = _evaluate_change(changes, "friction", segment, (size,))
    along = (push * slip[..., None]).sum(axis=2) - 3.5 * model.gravity * friction
    aside = (push * across[..., None]).sum(axis=2) / np.maximum(u, 1e-3 * u[:, :1] + 1e-12)[..., None]
    du_along, du_across = _integrate(segment.times, along), u[..., None] * _integrate(segment.times, aside)
    du = du_along[..., None, :] * slip[..., None] + du_across[..., None, :] * across[..., None]
    dq = 5 / 7 * _integrate(segment.times, push)
    shift = _integrate(segment.times, dq + 2 / 7 * du)
    lasts = np.maximum(segment.times[:, -1] - segment.times[:, 0], 1e-12)
    slowing = np.maximum((u[:, 0] - u[:, -1]) / lasts, 1e-12)
    later = np.where((lasts > 1e-9)[:, None], du_along[:, -1] / slowing[:, None], 0.0)
    speed = after.speed[:, 0]
    loss = (model.rolling_drag * speed + model.rolling_decel)[:, None] * after.direction[:, 0]
    return shift, dq[:, -1] + loss[..., None] * later[:, None, :]


def _shift_rolling(
    model: Model, segment: ResponseSegment, changes: Mapping[str, LawChange], size: int, place: Array, velocity: Array
) -> Array:
    """Shifts (k, m, 2, J) while rolling, from initial changes (k, 2, J) of position and velocity; none at rest."""
    way, v = segment.direction, segment.speed
    moves = (v > 1e-7)[..., None]
    across = np.stack([-way[..., 1], way[..., 0]], axis=-1)
    push = 5 / 7 * _evaluate_change(changes, "push", segment, (2, size))
    along = (push * way[..., None]).sum(axis=2) - _evaluate_change(changes, "rolling", segment, (size,))
    aside = (push * across[..., None]).sum(axis=2) / np.maximum(v, 1e-3 * v[:, :1] + 1e-12)[..., None]
    decay = np.exp(-model.rolling_drag * (segment.times - segment.times[:, :1]))[..., None]
    first = (velocity * way[:, 0, :, None]).sum(axis=1)[:, None]
    beside = (velocity * across[:, 0, :, None]).sum(axis=1)[:, None] / np.maximum(v[:, :1], 1e-12)[..., None]
    dv_along = decay * (first + _integrate(segment.times, np.where(moves, along / decay, 0.0)))
    dv_across = v[..., None] * (beside + _integrate(segment.times, np.where(moves, aside, 0.0)))
    dv = dv_along[..., None, :] * way[..., None] + dv_across[..., None, :] * across[..., None]
    return np.asarray(place[:, None] + _integrate(segment.times, np.where(moves[..., None], dv, 0.0)))


def _evaluate_change(
    changes: Mapping[str, LawChange], law: str, segment: ResponseSegment, shape: tuple[int, ...]
) -> Array:
    return changes[law](segment) if law in changes else np.zeros((*segment.times.shape, *shape))


def _integrate(times: Array, values: Array) -> Array:
    """Integrals from the first time by the trapezoidal rule: even times (k, m), values (k, m, ...) -> (k, m, ...)."""
    out = np.empty_like(values)
    out[:, 0] = 0
    sums = out[:, 1:]
    np.add(values[:, 1:], values[:, :-1], out=sums)
    sums *= ((times[:, -1] - times[:, 0]) / (2 * (TIMES_PER_SEGMENT - 1))).reshape(-1, *[1] * (values.ndim - 1))
    np.cumsum(sums, axis=1, out=sums)
    return out


def _interpolate(times: Array, shift: Array, ball: Index, when: Array) -> Array:
    """Shifts (n, 2, J) of balls (n,) at times `when`, by linear interpolation between times (n, m)."""
    span = times[:, -1] - times[:, 0]
    place = np.clip(
        (when - times[:, 0]) / np.where(span != 0, span, 1) * (TIMES_PER_SEGMENT - 1), 0, TIMES_PER_SEGMENT - 1
    )
    low = np.minimum(place.astype(int), TIMES_PER_SEGMENT - 2)
    share = (place - low)[:, None, None]
    return np.asarray(shift[ball, low] * (1 - share) + shift[ball, low + 1] * share)
