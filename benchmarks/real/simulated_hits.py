"""Simulated hits of the design of recorded ones: the same speeds, impact parameters, frames and scatter; known laws.

`read_design` reads a recorded hit and its local estimate. A simulation starts from the motion of the striker, the
instant of the contact, the impact parameter, and the times of all positions. `simulate_hit` lets synthcam solve the
same hit by other laws of the contact, with the scatter that `docs/real_tracks.md` gives for the billiard recordings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.real.recordings import FRAME_S, RecordedHit
from benchmarks.search.real_causes import SLIP_SHARE, BallStart
from benchmarks.tracker.local_estimates import bend
from synthcam.dynamics.kinematics import plate_state, rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.trajectory import Trajectory
from synthcam.model import SOLID_BALL, Bodies, Model, as_model
from synthcam_shared.arrays import Array

GRAVITY = 9.81
SLIDING_FRICTION, SLIDING_FRICTION_SCATTER = 0.2, 0.05  # the scatter is a share, from stretch to stretch
ROLLING_DECEL, ROLLING_DECEL_SCATTER, ROLLING_DRAG = 0.03, 0.04, 0.03  # m/s^2, m/s^2, 1/s
MIN_ROLLING_DECEL = 0.002  # m/s^2
RESTITUTION, RESTITUTION_SCATTER = 0.96, 0.03
NOISE_M, NOISE_BESIDE_CONTACT_M, BESIDE_FRAMES = 3e-4, 1.2e-3, 1.5
WARP_M, WARP_WAVES, WARP_PER_M = 6.5e-4, 8, 6.0  # rms displacement, and how fast it changes over the table
MAX_REST_OF_SLIDE_S = 0.4  # of a striker that slides up to the hit
PUBLISHED_FALL = {"mu": 0.01, "rise": 0.108, "fall": 1 / 1.088}  # Alciatore, TP A.14, on data of Marlow
HOP_BOUNCE = 0.4  # restitution of the plate
MASS_KG = 0.21


@dataclass(frozen=True)
class ContactTruth:
    """The laws of the contacts of simulated hits.

    ball_friction: numbers of the effect of that name. hops: whether the plate holds nothing of the vertical impulse
    back. side_spin: R times the spin of the striker about the vertical over its speed, its rms over hits.
    """

    ball_friction: Mapping[str, float] = field(default_factory=lambda: {"mu": 0.08})
    hops: bool = False
    side_spin: float = 0.0

    def make_model(self, diameter: float, restitution: float) -> Model:
        """Make the model of one hit."""
        effects: dict[str, Any] = {"ball_friction": dict(self.ball_friction)}
        if self.hops:
            effects["hop"] = {"share": 1.0, "bounce": HOP_BOUNCE}
        numbers = {"restitution": min(restitution, 1.0), "spin_transfer": 0.0, "sliding_friction": SLIDING_FRICTION}
        numbers |= {"rolling_drag": ROLLING_DRAG, "rolling_decel": ROLLING_DECEL}
        return as_model({"ball": {"diameter": diameter}, "model": numbers, "effects": effects})


@dataclass(frozen=True)
class HitDesign:
    """The numbers that a simulation takes from a recorded hit; those of a motion are of the striker."""

    hit: RecordedHit
    contact_s: float
    start_s: float
    place: Array  # (2,) m, at the start
    velocity: Array  # (2,) m/s, at the start
    slide: Array  # (2,) direction of the slip at the start
    slide_s: float  # 0 if it rolls
    slides_at_contact: bool
    impact_parameter: float


def read_design(hit: RecordedHit, row: Mapping[str, Any]) -> HitDesign:
    """Read the design of a hit from its tracks and the row of its local estimate."""
    contact = float(row["t_c_local"])
    before = hit.tracks[(hit.tracks["particle"] == 1) & (hit.tracks["t_s"] < contact - 1e-4)].sort_values("t_s")
    time, xy = before["t_s"].to_numpy(float), before[["x", "y"]].to_numpy(float)
    start = BallStart.of(time - time[0], xy)
    pull = float(np.hypot(*start.pull))
    return HitDesign(
        hit=hit,
        contact_s=contact,
        start_s=float(time[0]),
        place=xy[0],
        velocity=start.velocity,
        slide=-start.pull / pull if pull else np.zeros(2),
        slide_s=start.end if pull else 0.0,
        slides_at_contact=pull > 0 and start.end >= time[-1] - time[0] - 1e-9,
        impact_parameter=float(row["b_local"]),
    )


@dataclass(frozen=True)
class SimulatedHit:
    """A simulated hit, and the velocities (2, 2) of target and striker just before and after the contact, m/s."""

    hit: RecordedHit
    before: Array
    after: Array
    normal: Array  # (2,) from the target to the striker

    def find_truth(self) -> dict[str, float]:
        """Find the true values of the quantities of a local estimate."""
        tangent = np.array([-self.normal[1], self.normal[0]])
        (closing, across), (parting, across_after) = (
            (one[0] - one[1]) @ np.stack([self.normal, tangent], axis=1) for one in (self.before, self.after)
        )
        truth = {"v0": float(np.hypot(*self.before[1])), "r": -parting / closing, "s": across_after / across}
        truth["impact_energy"] = float((self.after**2).sum() / (self.before**2).sum())
        return truth | {f"v{k + 1}o{axis}": self.after[k, j] for k in (0, 1) for j, axis in enumerate("xy")}


def simulate_hit(design: HitDesign, truth: ContactTruth, rng: np.random.Generator, waves: Array) -> SimulatedHit:
    """Simulate a hit of a design by other laws; waves (k, 2, 3): the map of the camera, as `draw_waves` draws it."""
    radius = design.hit.camera["ball_diameter"] / 2
    model = truth.make_model(2 * radius, rng.normal(RESTITUTION, RESTITUTION_SCATTER))
    before = _run_up(design, model, radius, truth.side_spin * rng.normal(), rng)
    striker = before.at_one(0, np.array([design.contact_s]))
    target = _place_target(striker, design.impact_parameter, radius)
    just_after = collide(model, target, striker)
    tracks = design.hit.tracks
    time, particle = tracks["t_s"].to_numpy(float), tracks["particle"].to_numpy()
    late = time >= design.contact_s
    xy = np.tile(target[0, :2], (len(time), 1))
    early = ~late & (particle == 1)
    xy[early] = before.at_one(0, time[early])[:, :2]
    for ball, state in enumerate(just_after):
        rows = late & (particle == ball)
        launch = Launch(design.contact_s, state[None], _make_bodies(radius, 1))
        after = solve(_draw_stretch(model, rng), launch, design.contact_s, float(time.max()), finish_slides=False)
        xy[rows] = after.at_one(0, time[rows])[:, :2]
    xy = bend(xy, waves, WARP_M) + _draw_errors(design, rng)
    return SimulatedHit(
        hit=RecordedHit(design.hit.name, tracks.assign(x=xy[:, 0], y=xy[:, 1]), design.hit.camera),
        before=np.concatenate([target, striker])[:, 3:5],
        after=just_after[:, 3:5],
        normal=(striker - target)[0, :2] / (2 * radius),
    )


def draw_hits(designs: Sequence[HitDesign], truth: ContactTruth, draw: int) -> list[SimulatedHit]:
    """Simulate the hits of a set, which share the map of the camera; draw: its number, the seed."""
    waves = draw_waves(np.random.default_rng(draw))
    return [simulate_hit(one, truth, np.random.default_rng([draw, k]), waves) for k, one in enumerate(designs)]


def draw_waves(rng: np.random.Generator) -> Array:
    """Draw the waves of a smooth map of the camera, which all hits of a set share."""
    return np.asarray(rng.normal(0, WARP_PER_M, (WARP_WAVES, 2, 3)))


def _run_up(design: HitDesign, model: Model, radius: float, side_spin: float, rng: np.random.Generator) -> Trajectory:
    """Solve the motion of the striker up to the contact; side_spin: R times the spin over the speed."""
    speed, span = float(np.hypot(*design.velocity)), design.contact_s - design.start_s
    lasts = span + rng.uniform(0, MAX_REST_OF_SLIDE_S) if design.slides_at_contact else design.slide_s
    slip = min(SLIDING_FRICTION * GRAVITY / SLIP_SHARE * lasts, speed) * design.slide
    rolling = design.velocity - SLIP_SHARE * slip
    state = plate_state(design.place, rolling, slip, side_spin * speed / radius, radius)
    launch = Launch(design.start_s, state[None], _make_bodies(radius, 1))
    return solve(_draw_stretch(model, rng), launch, design.start_s, design.contact_s, finish_slides=False)


def _place_target(striker: Array, impact_parameter: float, radius: float) -> Array:
    """The state (1, 9) of a resting ball that a striker (1, 9) touches."""
    heading = striker[0, 3:5] / np.hypot(*striker[0, 3:5])
    left = np.array([-heading[1], heading[0]])
    normal = np.sqrt(1 - impact_parameter**2) * heading - impact_parameter * left
    return rolling_state(striker[:, :2] + 2 * radius * normal, np.zeros((1, 2)), 0.0, radius)


def collide(model: Model, target: Array, striker: Array) -> Array:
    """The states (2, 9) just after a contact of a target and a striker (1, 9), which the plate may have pushed."""
    launch = Launch(0.0, np.concatenate([target, striker]), _make_bodies(model.ball.diameter / 2, 2))
    return solve(model, launch, finish_slides=False).at([0.0])[:, 0]


def _make_bodies(radius: float, count: int) -> Bodies:
    """Solid balls."""
    return Bodies(np.full(count, radius), np.full(count, MASS_KG), np.zeros(count), np.full(count, SOLID_BALL))


def _draw_stretch(model: Model, rng: np.random.Generator) -> Model:
    """The model with the friction and the loss of one stretch of a path."""
    friction = SLIDING_FRICTION * (1 + SLIDING_FRICTION_SCATTER * rng.normal())
    loss = max(rng.normal(ROLLING_DECEL, ROLLING_DECEL_SCATTER), MIN_ROLLING_DECEL)
    return replace(model, sliding_friction=friction, rolling_decel=loss)


def _draw_errors(design: HitDesign, rng: np.random.Generator) -> Array:
    """Draw the errors (n, 2) of all positions; those of the ball at rest are one, as its position was read once."""
    time, particle = design.hit.tracks["t_s"].to_numpy(float), design.hit.tracks["particle"].to_numpy()
    since = time - design.contact_s
    beside = np.abs(since) < BESIDE_FRAMES * FRAME_S
    errors = rng.normal(0, 1, (len(time), 2)) * np.where(beside, NOISE_BESIDE_CONTACT_M, NOISE_M)[:, None]
    errors[(since < 0) & (particle == 0)] = rng.normal(0, NOISE_M, 2)
    return errors
