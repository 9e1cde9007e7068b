"""A film of many balls as a granular gas: its temperature, order, contacts and energy, beside hard discs.

The kinetic theory of hard discs in a plane gives rates and free paths for comparison. Enskog's rates hold for a
homogeneous gas with a Maxwellian distribution and no correlation of velocities. The pair correlation at contact is that
of Henderson (1975), Mol. Phys. 30, 971; it holds up to an area fraction of about 0.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from synthcam_shared.arrays import Array, Ints
from synthcam_shared.errors import InputError
from tracker.gas.contact_groups import count_hidden_rows
from tracker.gas.energy import SINKS, measure_losses
from tracker.gas.free_paths import FreePath, PathCuts, cut_free_paths, extrapolate_to_contact
from tracker.gas.loss_on_air import balance_on_air
from tracker.gas.pair_correlation import pair_correlation
from tracker.gas.rolling_loss import measure_rolling_loss
from tracker.gas.sliding_friction import measure_sliding_friction
from tracker.gas.temperature import (
    MIN_BALLS,
    measure_distribution,
    measure_noise,
    measure_sonine,
    measure_temperatures,
    tabulate_velocities,
)
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import measure_path_noise as measure_scatter_of_paths

Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True)
class GasSettings:
    """How velocities and distributions are estimated."""

    window_rows: int = 10  # of a velocity: 5 in each half, for a parabola and an error
    margin_frames: float = 1.0  # positions nearer to a contact do not count, or fewer if its time is known better
    max_gap_frames: int = 10  # a ball that was not seen for longer may have hit something
    pair_reach_diameters: float = 6.0  # largest distance of the pair correlation
    pair_bins: int = 60
    velocity_bins: int = 32


@dataclass(frozen=True)
class GasCamera:
    """The numbers of a camera file on which the observables depend, and their standard errors, which are relative."""

    diameter: float  # of a ball, m
    fps: float
    on_air: bool = False  # whether the bodies glide, and do not slide after a contact
    scale_error: float = 0.0  # of lengths
    fps_error: float = 0.0
    diameter_error: float = 0.0


@dataclass(frozen=True, eq=False)
class GasObservables:
    """Observables of one recording, as `tracker.Gas` describes them."""

    time: pd.DataFrame
    pairs: pd.DataFrame
    velocities: pd.DataFrame
    values: dict[str, float]
    area: Rectangle
    name: str = ""
    diameter: float = 0.0
    notes: tuple[str, ...] = ()


def measure_gas(
    balls: Sequence[BallTrack],
    contacts: pd.DataFrame,
    camera: GasCamera,
    *,
    area: Rectangle | None = None,
    settings: GasSettings | None = None,
) -> GasObservables:
    """Measure the observables of a gas from the tracks of its balls, in metres, and their contacts.

    contacts: columns t_s, particle1, particle2 (-1 at a wall), energy_lost, energy_lost_std (m^2/s^2, NaN if unknown)
    and misfit, as `Result.contacts` has them; t_s_std if it is known.
    camera: its errors count in all errors.
    area: left, bottom, right and top of the rectangle that the centres can reach, m; without it, the one that they
    reached.

    Raises InputError if no frame has three balls with a velocity.
    """
    used = settings or GasSettings()
    contacts = sort_contacts(contacts)
    paths = find_free_paths(balls, contacts, camera, used)[0]
    table = tabulate_velocities(paths) if paths else pd.DataFrame({"frame": []})
    variances = [np.trace(ball.cov - ball.fixed, axis1=1, axis2=2) / 2 for ball in balls]
    claimed = float(np.sqrt(np.median(np.concatenate(variances))))
    noise = measure_noise(table) if len(table) else np.nan
    noise = noise if np.isfinite(noise) else claimed  # all free paths are short
    seen = np.unique(table["frame"].to_numpy(dtype=np.int64))
    hidden = pd.Series(count_hidden_rows(contacts, seen, 1 / camera.fps), index=seen)
    time = measure_temperatures(table, noise, paths, hidden) if len(table) else table
    if not len(time):
        raise InputError(f"a gas has {MIN_BALLS} balls or more in view; no frame here has so many with a velocity")
    time.insert(1, "t_s", _find_frame_times(balls, time["frame"].to_numpy()))
    time = time.join(measure_losses(paths, contacts, time["frame"].to_numpy(), noise, 1 / camera.fps))
    positions, frames = np.concatenate([b.position for b in balls]), np.concatenate([b.frame for b in balls])
    left, bottom, right, top = area or map(float, (*positions.min(axis=0), *positions.max(axis=0)))
    sides = right - left, top - bottom
    order = np.argsort(frames, kind="stable")
    by_frame = np.split(positions[order], np.unique(frames[order], return_index=True)[1][1:])
    a2, a2_std = measure_sonine(table, time, noise)
    values = {"position_noise": noise, "noise_ratio": noise / claimed, "sonine_a2": a2, "sonine_a2_std": a2_std}
    values |= (law := measure_rolling_loss(balls, paths, noise))
    values |= measure_sliding_friction(balls, () if camera.on_air else paths, noise, law)
    time = balance_on_air(time, table, law) if camera.on_air else time
    values |= _measure_rates(balls, contacts) | _predict_rates(time, sides, camera)
    # the relative errors of lengths and of the frame rate in whatever depends on them
    of_energy = 2 * np.hypot(camera.scale_error, camera.fps_error)
    energies = ("temperature", "energy", *SINKS.values())
    time = time.assign(**{f"{k}_std": np.hypot(time[f"{k}_std"], of_energy * time[k]) for k in energies})
    errors = {"free_path": camera.scale_error, "contact_rate": camera.fps_error, "rolling_drag": camera.fps_error}
    errors |= dict.fromkeys(("rolling_loss", "mu_k"), float(np.hypot(camera.scale_error, 2 * camera.fps_error)))
    values |= {f"{k}_std": float(np.hypot(values[f"{k}_std"], error * values[k])) for k, error in errors.items()}
    return GasObservables(
        time=time,
        pairs=pair_correlation(by_frame, sides, used.pair_reach_diameters * camera.diameter, used.pair_bins),
        velocities=measure_distribution(table, time, used.velocity_bins),
        values=values,
        area=(left, bottom, right, top),
        diameter=camera.diameter,
    )


def _find_frame_times(balls: Sequence[BallTrack], frames: Ints) -> Array:
    """The middle of the exposure of each frame, s; of a rolling shutter, the mean over the balls in view."""
    every = pd.DataFrame({name: np.concatenate([getattr(b, name) for b in balls]) for name in ("frame", "time")})
    return every.groupby("frame")["time"].mean()[frames].to_numpy()


def sort_contacts(contacts: pd.DataFrame) -> pd.DataFrame:
    """Sort contacts by time, with the types of their columns, even where there are none."""
    kinds = dict.fromkeys(("t_s", "energy_lost", "energy_lost_std"), float) | {"particle1": int, "particle2": int}
    kinds |= {"misfit": bool}
    return contacts.astype(kinds).sort_values("t_s", kind="stable").reset_index(drop=True)


def find_free_paths(
    balls: Sequence[BallTrack], contacts: pd.DataFrame, camera: GasCamera, settings: GasSettings
) -> tuple[list[FreePath], float]:
    """Cut tracks into free paths with velocities at sorted contacts; also returns the noise of a coordinate, m."""
    margins = np.full(len(contacts), np.inf)  # half an exposure, and twice the error of the time of a contact
    if "t_s_std" in contacts:
        margins = max(ball.exposure for ball in balls) / 2 + 2 * contacts["t_s_std"].to_numpy(dtype=np.float64)
    least_noise = 1e-9  # m; tracks of a simulation may have none
    noise = max(measure_scatter_of_paths([(ball.frame, ball.position) for ball in balls]), least_noise)
    cuts = PathCuts(
        window_rows=settings.window_rows,
        margins_s=np.fmin(margins, settings.margin_frames / camera.fps),
        max_gap_s=(settings.max_gap_frames + 0.5) / camera.fps,
        noise=noise,
        slides=not camera.on_air,
    )
    return cut_free_paths(balls, contacts, cuts), noise


def _measure_rates(balls: Sequence[BallTrack], contacts: pd.DataFrame) -> dict[str, float]:
    """Contacts of two balls, their rate, and the free path."""
    found = int((contacts["particle2"] >= 0).sum())
    ball_time = float(sum(ball.time[-1] - ball.time[0] for ball in balls))
    way = float(sum(_measure_way(ball, contacts) for ball in balls))
    relative = 1 / np.sqrt(found) if found else np.nan
    return {
        "contacts": found,
        "contacts_std": float(np.sqrt(found)),
        "contact_rate": 2 * found / ball_time,
        "contact_rate_std": float(2 * found / ball_time * relative),
        "free_path": way / (2 * found) if found else np.nan,
        "free_path_std": float(way / (2 * found) * relative) if found else np.nan,
    }


def _predict_rates(time: pd.DataFrame, sides: tuple[float, float], camera: GasCamera) -> dict[str, float]:
    """Area fraction, and contacts and free path of Enskog's hard discs at the measured temperature and density.

    Their errors are those of the camera file and of the temperature, by one standard error of each. The errors of the
    temperature count as the same in all frames, because those of slides are.
    """
    seen = (time["balls"] + time["unknown"]).to_numpy()

    def predict(length: float, rate: float, body: float, hotter: float) -> Array:
        d = camera.diameter * body
        temperature = np.maximum(time["temperature"], 0.0) + hotter * time["temperature_std"].fillna(0.0)
        density = seen / ((sides[0] * length + d) * (sides[1] * length + d))
        each = contact_rate(temperature.to_numpy() * (length * rate) ** 2, density, d) / (camera.fps * rate)
        return np.array([density.mean() * np.pi * d**2 / 4, (seen * each).sum() / 2, mean_free_path(density.mean(), d)])

    best = np.array([1.0, 1.0, 1.0, 0.0])
    expected = predict(*best)
    errors = np.diag([camera.scale_error, camera.fps_error, camera.diameter_error, 1.0])
    std = np.sqrt(sum((predict(*(best + error)) - expected) ** 2 for error in errors))
    names = ("area_fraction", "contacts_theory", "free_path_theory")
    errors_of = {f"{name}_std": float(value) for name, value in zip(names, std, strict=True)}
    return {name: float(value) for name, value in zip(names, expected, strict=True)} | errors_of


def _measure_way(ball: BallTrack, contacts: pd.DataFrame) -> float:
    """The way of a ball, m, as straight lines from contact to contact."""
    own = (contacts["particle1"] == ball.particle) | (contacts["particle2"] == ball.particle)
    at = contacts["t_s"][own].to_numpy(dtype=np.float64)
    inside = np.sort(at[(at > ball.time[0]) & (at < ball.time[-1])])
    corners = [ball.position[0]]
    for instant in inside:
        sides = [extrapolate_to_contact(ball, inside, float(instant), later) for later in (False, True)]
        corners.append(np.mean([place for place, sure in sides if sure] or [sides[0][0]], axis=0))
    return float(np.hypot(*np.diff([*corners, ball.position[-1]], axis=0).T).sum())


def contact_pair_correlation(area_fraction: ArrayLike) -> Array:
    """Pair correlation of hard discs at contact: (1 - 7 phi / 16) / (1 - phi)^2."""
    phi = np.asarray(area_fraction, dtype=np.float64)
    return np.asarray((1 - 7 * phi / 16) / (1 - phi) ** 2)


def contact_rate(temperature: ArrayLike, density: ArrayLike, diameter: float) -> Array:
    """Contacts of one disc per second: 2 n d g sqrt(pi T).

    temperature: m^2/s^2, variance of one component of the velocity.
    density: discs per m^2.
    diameter: m.
    """
    n = np.asarray(density, dtype=np.float64)
    g = contact_pair_correlation(n * np.pi * diameter**2 / 4)
    return np.asarray(2 * n * diameter * g * np.sqrt(np.pi * np.asarray(temperature, dtype=np.float64)))


def mean_free_path(density: ArrayLike, diameter: float) -> Array:
    """Mean free path of discs between two contacts, m, by kinetic theory: 1 / (2 sqrt(2) n d g)."""
    n = np.asarray(density, dtype=np.float64)
    return np.asarray(1 / (2 * np.sqrt(2) * n * diameter * contact_pair_correlation(n * np.pi * diameter**2 / 4)))
