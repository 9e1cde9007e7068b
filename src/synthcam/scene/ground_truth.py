"""The ground truth of a clip, as docs/format.md defines it: scalars of the collision, tracks, events."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.occlusion import compute_hidden_shares
from synthcam.camera.pinhole import Lamp, PinholeCamera, project_glint
from synthcam.dynamics.contacts.impact import combine_inertia_factors
from synthcam.dynamics.kinematics import contact_velocity, rolling_velocity
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.orientation import OrientationHistory
from synthcam.dynamics.trajectory import Event, Trajectory
from synthcam.model import Bodies, Model
from synthcam.scene.film_time import FilmedMotion
from synthcam_shared.arrays import Array

if TYPE_CHECKING:
    import pandas as pd

Columns = dict[str, NDArray[Any]]  # of a table, by name

STATE_COLUMNS = "x y z vx vy vz wx wy wz".split()
COLLISION_COLUMNS = (
    "v0 b u2ix u2iy side2i t_c r s mu_k C drag decel tau1 tau2 v1f v2f energy_fraction momentum_fraction final_angle "
    "w1n w1t w2n w2t"
).split()


def make_true_scalars(model: Model, launch: Launch, motion: Trajectory) -> dict[str, float]:
    """Compute the scalars of `truth/clips.parquet`, SI units; NaN without a collision, or with many bodies."""
    row = dict.fromkeys(COLLISION_COLUMNS, np.nan)
    row |= {"mu_k": model.sliding_friction, "drag": model.rolling_drag, "decel": model.rolling_decel}
    hit = motion.first("contact")
    if hit is None or hit.before is None or hit.after is None or len(motion.legs) > 2:
        launched = [*launch.states[:, 3:5].tolist(), *(one.velocity[:2] for one in launch.later)]
        speeds = np.hypot(*np.transpose(launched))
        return row | {"v0": float(speeds.max())}
    side = np.array(hit.n)  # shorter than 1 for unequal balls, which touch off their equators
    n = side / np.hypot(*side)
    t = np.array([-n[1], n[0]])
    before, after = hit.before[:, 3:5], hit.after[:, 3:5]
    approach, parting = before[1] - before[0], after[1] - after[0]
    v0 = float(np.hypot(*approach))
    d = approach / v0
    b = float(d[1] * side[0] - d[0] * side[1])  # z . [d x (x2 - x1)] / (R1 + R2), x2 - x1 = -(R1 + R2) n
    across, radius = float(approach @ t), launch.bodies.radius[hit.j]
    row |= {
        "v0": v0,
        "b": b,
        **dict(zip(("u2ix", "u2iy"), contact_velocity(hit.before[1], radius).tolist(), strict=True)),
        "side2i": float(radius * hit.before[1, 8]),
        "t_c": hit.t,
        "r": float(-(parting @ n) / (approach @ n)),
        "s": float(parting @ t) / across if abs(across) > 1e-12 * v0 else np.nan,
        "C": _spin_transfer(launch.bodies, hit),
        **{f"w{k + 1}{axis}": float(hit.after[k, 6:8] @ e) for k in (0, 1) for axis, e in (("n", n), ("t", t))},
    }
    finals = np.empty((2, 2))
    for k, ball in enumerate((hit.i, hit.j)):
        end = motion.first("slide_end", ball, hit.t)
        row[f"tau{k + 1}"] = end.t - hit.t if end else 0.0
        body = launch.bodies[ball]
        finals[k] = rolling_velocity(hit.after[k], body.radius, body.inertia) if not end else end.after[0, 3:5]  # type: ignore[index]
        row[f"v{k + 1}f"] = float(np.hypot(*finals[k]))
    total = before.sum(axis=0)
    row["energy_fraction"] = float((finals**2).sum() / (before**2).sum())
    row["momentum_fraction"] = float(finals.sum(axis=0) @ total / (total @ total))
    cross = float(finals[0, 0] * finals[1, 1] - finals[0, 1] * finals[1, 0])
    row["final_angle"] = float(abs(np.arctan2(cross, (finals[0] * finals[1]).sum())))
    return row


def _spin_transfer(bodies: Bodies, hit: Event) -> float:
    """Compute C from the striker's change of spin: J = k C |u_t| 2 m, dw = n x J / (k mass R), m reduced."""
    before, after = np.asarray(hit.before), np.asarray(hit.after)
    radius, mass = bodies.radius[[hit.i, hit.j]], bodies.mass[[hit.i, hit.j]]
    n = before[0, :3] - before[1, :3]
    n = n / np.linalg.norm(n)
    approach = before[1, 3:6] - before[0, 3:6]
    u_t = approach - (approach @ n) * n + np.cross((radius[:, None] * before[:, 6:9]).sum(axis=0), n)
    inertia = bodies.inertia[[hit.i, hit.j]]
    impulse = mass[1] * radius[1] / (1 / inertia[1]) * np.linalg.norm(after[1, 6:9] - before[1, 6:9])
    joint = combine_inertia_factors(inertia[0], mass[0], inertia[1], mass[1])
    return float(impulse / (2 * joint * mass[0] * mass[1] / mass.sum() * np.linalg.norm(u_t)))


def make_true_tracks(
    bodies: Bodies,
    view: FilmedMotion,
    lamp: Lamp,
    frames: int,
    turning: OrientationHistory | None = None,
    every: int = 1,
    heights: Array | None = None,
) -> pd.DataFrame:
    """Make the true tracks, the table `truth/tracks.parquet`, from the arguments of `list_true_tracks`."""
    import pandas as pd  # here alone: slow to load

    return pd.DataFrame(list_true_tracks(bodies, view, lamp, frames, turning, every, heights))


def list_true_tracks(
    bodies: Bodies,
    view: FilmedMotion,
    lamp: Lamp,
    frames: int,
    turning: OrientationHistory | None = None,
    every: int = 1,
    heights: Array | None = None,
) -> Columns:
    """List the columns of `truth/tracks.parquet`: a row for each ball and frame, at mid-exposure.

    x_mean_px, y_mean_px are means over the exposure. turning: of balls with a pattern. every: of every n-th frame only.
    heights: of discs, m, which mirror nothing: their glint is NaN, and so is what hides them; 0 of balls.
    """
    spans, camera, numbers = view.spans(range(0, frames, every)), view.camera, np.arange(0, frames, every)
    times = view.times(spans.mean(axis=1))
    states = view.at_own_times(times)
    kinds = view.at_own_times(times, view.motion.motion)
    means = view.mean(spans, lambda states: camera.project(states[..., :3]))
    balls, discs = [], np.zeros(len(states), dtype=bool) if heights is None else heights > 0
    hidden = compute_hidden_shares(camera, states[..., :3], np.where(discs, np.nan, bodies.radius))
    for ball in range(len(states)):
        state, radius = states[ball], float(bodies.radius[ball])
        height = 0.0 if heights is None else float(heights[ball])
        px, glint = camera.project(state[:, :3]), project_glint(camera, lamp, state[:, :3], radius)
        glint = np.full_like(px, np.nan) if height else glint
        columns: dict[str, Any] = {"frame": numbers, "t_s": times[ball], "particle": np.full(len(numbers), ball)}
        columns |= {"x_px": px[:, 0], "y_px": px[:, 1], "glint_x_px": glint[:, 0], "glint_y_px": glint[:, 1]}
        columns |= dict(zip(STATE_COLUMNS, state.T, strict=True))
        columns |= {"x_mean_px": means[ball, :, 0], "y_mean_px": means[ball, :, 1]}
        columns |= {"state": kinds[ball], "visible": _is_whole(camera, state[:, :3], radius, height)}
        columns["hidden"] = hidden[ball]
        if turning:
            columns |= dict(zip("qx qy qz qw".split(), turning.at(ball, times[ball]).as_quat().T, strict=True))
        balls.append(columns)
    return {name: np.concatenate([each[name] for each in balls]) for name in balls[0]}


def _is_whole(camera: PinholeCamera, centres: Array, radius: float, height: float) -> Any:
    """Tell whether the whole outline of a ball, or of a disc of that height, lies in the picture: (n,)."""
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = np.stack([radius * np.cos(angles), radius * np.sin(angles), 0 * angles], axis=1)
    rims = np.concatenate([ring + np.array([0, 0, side * height / 2]) for side in ((-1, 1) if height else (0,))])
    px = camera.project(centres[:, None] + rims)
    width, height = camera.size
    inside = (px > -0.5) & (px < np.array([width, height]) - 0.5)
    return inside.all(axis=(1, 2))


def make_true_events(motion: Trajectory, fps: float) -> pd.DataFrame:
    """Make the true events, the table `truth/events.parquet`; impulses in N s."""
    import pandas as pd  # here alone: slow to load

    return pd.DataFrame(list_true_events(motion, fps))


def list_true_events(motion: Trajectory, fps: float) -> Columns:
    """List the columns of `truth/events.parquet`; impulses in N s."""
    names = "t_s frame_float kind i j nx ny impulse_n impulse_t".split()
    kinds = {"kind": np.str_, "i": np.int64, "j": np.int64}
    rows = [(e.t, e.t * fps, e.kind, e.i, e.j, *e.n, e.impulse_n, e.impulse_t) for e in motion.events]
    columns = zip(*rows, strict=True) if rows else [()] * len(names)  # an empty table has its types too
    table: Columns = {
        name: np.array(column, kinds.get(name, np.float64)) for name, column in zip(names, columns, strict=True)
    }
    for name in dict.fromkeys(name for e in motion.events for name in e.drawn):
        table[name] = np.array([e.drawn.get(name, np.nan) for e in motion.events])
    return table


SINKS = {
    "lost_in_contacts": ("contact", "contact_end", "together", "apart"),
    "lost_at_walls": ("wall",),
    "lost_in_landings": ("land",),
    "lost_by_sliding": ("slide",),
    "lost_by_rolling": ("roll",),
    "lost_in_air": ("glide", "fly"),
    "given_by_hand": ("launch", "push"),
}


def list_true_energies(bodies: Bodies, motion: Trajectory, times: Array, gravity: float) -> Columns:
    """List the columns of `truth/energy.parquet`: energy at times (m,), s, and by what it went, J.

    The energy is that of translation, spin and height. An event takes what the bodies lose in that instant, a kind of
    motion what they lose along it; `given_by_hand` has the other sign. A contact that lasts takes all that its bodies
    lose meanwhile, and gives back what its spring has stored.
    """
    lost = {name: np.zeros(len(times)) for name in SINKS}
    sink = {kind: name for name, kinds in SINKS.items() for kind in kinds}

    def energy(states: Array, ball: Any) -> Array:
        mass, radius = bodies.mass[ball], bodies.radius[ball]
        spin = bodies.inertia[ball] * radius**2 * (states[..., 6:9] ** 2).sum(axis=-1)
        return np.asarray(mass * ((states[..., 3:6] ** 2).sum(axis=-1) / 2 + spin / 2 + gravity * states[..., 2]))

    pressed = _list_lasting_contacts(motion)
    sticks = any(event.kind == "together" for event in motion.events)
    unseen: dict[float, tuple[str, float]] = {}  # by the time of a hit: what it takes from bodies that stick to its two
    for event in motion.events:
        if event.kind not in sink or any(event.t == begins for begins, _ in pressed.get(event.i, ())):
            continue
        name, jump = sink[event.kind], 0.0
        if event.before is not None and event.after is not None:
            balls = [event.i, event.j][: len(event.before)]
            jump = float((energy(np.asarray(event.before), balls) - energy(np.asarray(event.after), balls)).sum())
            lost[name][times >= event.t] += jump
        first, booked = unseen.get(event.t, (name, 0.0))
        unseen[event.t] = first, booked - jump
    for ball, legs in enumerate(motion.legs):
        for before, leg in itertools.pairwise(legs) if sticks else ():
            if leg.t0 in unseen:
                name, rest = unseen[leg.t0]
                ends = energy(np.array([before.now(leg.t0), leg.now(leg.t0)]), ball)
                unseen[leg.t0] = name, rest + float(ends[0] - ends[1])
        for leg in legs:
            held = any(begins <= leg.t0 < ends for begins, ends in pressed.get(ball, ()))
            name = "lost_in_contacts" if held else sink.get(leg.motion, "")
            later = np.flatnonzero(times > leg.t0)
            if not (name and len(later)):
                continue
            states = leg.at(np.concatenate([[leg.t0], np.minimum(times[later], leg.t1)]))
            lost[name][later] += energy(states[0], ball) - energy(states[1:], ball)
    for t, (name, rest) in unseen.items() if sticks else ():
        lost[name][times >= t] += rest
    lost["given_by_hand"] = 0.0 - lost["given_by_hand"]
    whole = energy(motion.at(times).swapaxes(0, 1), np.arange(len(motion.legs))).sum(axis=1)
    lowest = float((bodies.mass * bodies.radius).sum() * gravity)
    return {"frame": np.arange(len(times)), "t_s": times, "energy": whole - lowest} | lost


def _list_lasting_contacts(motion: Trajectory) -> dict[int, list[tuple[float, float]]]:
    """List when each body is in contacts that last, s; one that the run does not end lasts for ever."""
    begun: dict[frozenset[int], float] = {}
    found: dict[int, list[tuple[float, float]]] = {}
    for event in motion.events:
        pair = frozenset((event.i, event.j))
        if event.kind == "contact":
            begun[pair] = event.t
        if event.kind == "contact_end" or (event.kind == "contact" and event.after is None):
            ends = event.t if event.kind == "contact_end" else math.inf
            for k in pair:
                found.setdefault(k, []).append((begun[pair], ends))
    return found
