"""What ranges the tracks cover, and the axes over them that a law may be left free in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C, B
from discrepancy.free_laws.axis import Axis
from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.kinematics import contact_velocity
from synthcam.model import Model

CURVE, TURN, MAP, FIELD = 20, 9, 12, 8  # coefficients: of a curve, of one of angles, a side of a map, and of a field
EACH = 120  # clips: of more, no number of each is fitted
SLIPS = 1e-5  # m/s: a ball whose contact is slower rolls
SAMPLES = 300  # instants at which the base fit's motion is looked at for the ranges that it covers
OBLIQUE = 0.1  # of the impact parameter: a law of it is looked at up to there at least


@dataclass(frozen=True)
class CoveredRanges:
    """The motion of a fit, sampled and flattened over clips and instants; of both balls or of one.

    Attributes
    ----------
    launches : (clips, p) array
        Columns as in `discrepancy.data.launch`.
    clips : sequence of Measured
    slips : (m,) array
        Contact speeds while sliding, m/s.
    slip_places : (m, 2) array
        Places there, m.
    places, velocities, speeds : (p, 2), (p, 2) and (p,) arrays
        Of moving balls, m and m/s.
    roll_speeds, roll_places : (q,) and (q, 2) arrays
        While rolling, m/s and m.
    """

    launches: Array
    clips: Sequence[MeasuredCollision]
    slips: Array
    slip_places: Array
    places: Array
    velocities: Array
    speeds: Array
    roll_speeds: Array
    roll_places: Array


def compute_ranges(model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> dict[str, CoveredRanges]:
    """What the motion of a fit covers, by ball: "" for both together, "a" and "b".

    Parameters
    ----------
    model : Model
    launches : (clips, p) array
        Columns as in `discrepancy.data.launch`.
    clips : sequence of Measured

    Returns
    -------
    dict of str to CoveredRanges
    """
    first, last = min(c.frame.min() / c.fps for c in clips), max((c.frame.max() + 1) / c.fps for c in clips)
    times = np.linspace(min(first, launches[:, T_C].min()), last, SAMPLES)
    a_strikes = np.array([c.striker == "a" for c in clips])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        states = np.nan_to_num(solve_collisions(model, launches, times[0], times[-1], a_strikes).at(times))
    slip = np.hypot(*np.moveaxis(contact_velocity(states, model.ball.radius), -1, 0))
    place, velocity = states[..., :2], states[..., 3:5]

    def covered(slip: Array, velocity: Array, place: Array) -> CoveredRanges:
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        slides, moves = slip > SLIPS, speed > SLIPS
        rolls = moves & ~slides
        own = slip[slides], place[slides], place[moves], velocity[moves], speed[moves], speed[rolls], place[rolls]
        return CoveredRanges(launches, clips, *own)

    is_a = np.stack([~a_strikes, a_strikes])
    mine = {"": np.ones_like(is_a), "a": is_a, "b": ~is_a}
    return {ball: covered(slip[own], velocity[own], place[own]) for ball, own in mine.items()}


def over_speed(name: str, letter: str, values: Array, low: float | None = None) -> tuple[Axis, ...]:
    """The axis of a curve over speeds (n,), m/s, from the least of them or from `low`; none where there are none."""
    if not len(values):
        return ()
    least = float(values.min()) if low is None else low
    return (Axis(name, "m/s", least, float(values.max()), CURVE, letter=letter),)


def over_heading() -> tuple[Axis, ...]:
    """The axis of a curve over all directions, rad."""
    return (Axis("heading", "rad", -np.pi, np.pi, TURN, "circle", "th"),)


def over_obliqueness(launches: Array) -> tuple[Axis, ...]:
    """The axis of a curve over the impact parameters' sizes."""
    most = max(float(np.abs(launches[:, B]).max()), OBLIQUE)
    return (Axis("obliqueness", "1", 0.0, most, CURVE, letter="|b|"),)


def over_clips(count: int) -> tuple[Axis, ...]:
    """The axis of a number for each of so many clips; none of very many."""
    return (Axis("clip", "1", 0.0, count - 1.0, count, "set"),) if count <= EACH else ()


def over_place(values: Array, count: int, unit: str = "m") -> tuple[Axis, ...]:
    """Both axes of a map or field over places (n, 2), with `count` coefficients a side; none where there are none."""
    if not len(values):
        return ()
    ends = zip("xy", values.min(axis=0).tolist(), values.max(axis=0).tolist(), strict=True)
    return tuple(Axis(name, unit, low, high, count) for name, low, high in ends)
