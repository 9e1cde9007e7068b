"""A film of many balls as a granular gas: its temperature, order, contacts and energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker.gas.energy import measure_losses
from tracker.gas.kinetic_theory import contact_rate, mean_free_path
from tracker.gas.pair_correlation import pair_correlation
from tracker.gas.temperature import (
    MIN_BALLS,
    measure_distribution,
    measure_noise,
    measure_sonine,
    measure_temperatures,
    tabulate_velocities,
)
from tracker.gas.velocities import FreePath, cut_free_paths
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import measure_noise as measure_scatter_of_paths

Floats = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True)
class GasSettings:
    """How velocities and distributions are estimated."""

    window_rows: int = 10  # of a velocity: 5 in each half, for a parabola and an error
    margin_frames: float = 1.0  # positions nearer to a contact than this do not count
    max_gap_frames: int = 10  # a ball that was not seen for longer may have hit something
    pair_reach_diameters: float = 6.0  # largest distance of the pair correlation
    pair_bins: int = 60
    velocity_bins: int = 32


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
    diameter: float,
    fps: float,
    *,
    area: Rectangle | None = None,
    on_air: bool = False,
    scale_error: float = 0.0,
    settings: GasSettings | None = None,
) -> GasObservables:
    """Measure the observables of a gas from the tracks of its balls and their contacts.

    Parameters
    ----------
    balls : sequence of BallTrack
        Tracks in metres.
    contacts : DataFrame
        Columns t_s, particle1, particle2 (-1 at a wall), energy_lost, energy_lost_std (m^2/s^2, NaN if unknown) and
        misfit, as `Result.contacts` has them.
    diameter : float
        Of a ball, m.
    fps : float
        Frames a second.
    area : (left, bottom, right, top), optional
        The rectangle that the centres can reach, m. Without it: the one that they reached.
    on_air : bool
        Whether the bodies glide on air, and do not slide after a contact.
    scale_error : float
        Relative standard error of lengths. It counts in temperature_std and energy_std.
    settings : GasSettings, optional
        How velocities and distributions are estimated.

    Returns
    -------
    GasObservables

    Raises
    ------
    InputError
        No frame has three balls with a velocity.
    """
    used = settings or GasSettings()
    contacts = _sort_contacts(contacts)
    paths = cut_free_paths(
        balls,
        contacts,
        window_rows=used.window_rows,
        margin_s=used.margin_frames / fps,
        max_gap_s=(used.max_gap_frames + 0.5) / fps,
        noise=measure_scatter_of_paths([(ball.frame, ball.position) for ball in balls]),
        slides=not on_air,
    )
    table = tabulate_velocities(paths) if paths else pd.DataFrame({"frame": []})
    claimed = float(np.sqrt(np.median(np.concatenate([_claimed_variance(ball) for ball in balls]))))
    noise = measure_noise(table) if len(table) else np.nan
    noise = noise if np.isfinite(noise) else claimed  # all free paths are short
    time = _measure_time(paths, table, contacts, noise, fps)
    where = area or _find_area(balls)
    sides = where[2] - where[0], where[3] - where[1]
    a2, a2_std = measure_sonine(table, time, noise)
    values = {"position_noise": noise, "noise_ratio": noise / claimed, "sonine_a2": a2, "sonine_a2_std": a2_std}
    return GasObservables(
        time=_add_scale_error(time, scale_error),
        pairs=pair_correlation(_split_by_frame(balls), sides, used.pair_reach_diameters * diameter, used.pair_bins),
        velocities=measure_distribution(table, time, used.velocity_bins),
        values=values | _measure_rates(time, balls, contacts, sides, diameter, fps),
        area=where,
        diameter=diameter,
    )


def _measure_time(
    paths: Sequence[FreePath], table: pd.DataFrame, contacts: pd.DataFrame, noise: float, fps: float
) -> pd.DataFrame:
    """Temperature, mean velocity, energy and losses of each frame; raises InputError if no frame has enough balls."""
    time = measure_temperatures(table, noise) if len(table) else table
    if not len(time):
        raise InputError(f"a gas has {MIN_BALLS} balls or more in view; no frame here has so many with a velocity")
    time.insert(1, "t_s", time["frame"] / fps)
    return time.join(measure_losses(paths, contacts, time["frame"].to_numpy(), noise))


def _add_scale_error(time: pd.DataFrame, scale_error: float) -> pd.DataFrame:
    """The table with the relative error of lengths in what is a square of lengths."""
    return time.assign(
        **{f"{k}_std": np.hypot(time[f"{k}_std"], 2 * scale_error * time[k]) for k in ("temperature", "energy")}
    )


def _sort_contacts(contacts: pd.DataFrame) -> pd.DataFrame:
    """The contacts in the order of time, each column of its own type even where there are none."""
    kinds = dict.fromkeys(("t_s", "energy_lost", "energy_lost_std"), float) | {"particle1": int, "particle2": int}
    return contacts.astype(kinds | {"misfit": bool}).sort_values("t_s", kind="stable").reset_index(drop=True)


def _claimed_variance(ball: BallTrack) -> Floats:
    """Variance of a coordinate (n,), m^2, that the track claims, without the errors that all its positions share."""
    return np.asarray(np.trace(ball.cov - ball.fixed, axis1=1, axis2=2) / 2)


def _measure_rates(
    time: pd.DataFrame,
    balls: Sequence[BallTrack],
    contacts: pd.DataFrame,
    sides: tuple[float, float],
    diameter: float,
    fps: float,
) -> dict[str, float]:
    """Contacts, rate and free path, beside Enskog's for hard discs at the measured temperature and density."""
    found = int((contacts["particle2"] >= 0).sum())
    ball_time = float(sum(ball.time[-1] - ball.time[0] for ball in balls))
    way = float(sum(_measure_way(ball, contacts) for ball in balls))
    seen = (time["balls"] + time["unknown"]).to_numpy()
    density = seen / ((sides[0] + diameter) * (sides[1] + diameter))
    rate = contact_rate(np.maximum(time["temperature"].to_numpy(), 0), density, diameter)
    expected = float((seen * rate).sum() / 2 / fps)
    relative = 1 / np.sqrt(found) if found else np.nan
    return {
        "area_fraction": float(density.mean() * np.pi * diameter**2 / 4),
        "contacts": found,
        "contacts_std": float(np.sqrt(found)),
        "contacts_theory": expected,
        "contact_rate": 2 * found / ball_time,
        "contact_rate_std": float(2 * found / ball_time * relative),
        "free_path": way / (2 * found) if found else np.nan,
        "free_path_std": float(way / (2 * found) * relative) if found else np.nan,
        "free_path_theory": float(mean_free_path(density.mean(), diameter)),
    }


def _measure_way(ball: BallTrack, contacts: pd.DataFrame) -> float:
    """The way of a ball, m, as straight lines from contact to contact."""
    own = (contacts["particle1"] == ball.particle) | (contacts["particle2"] == ball.particle)
    at = contacts["t_s"][own].to_numpy(dtype=np.float64)
    inside = at[(at > ball.time[0]) & (at < ball.time[-1])]
    corners = np.concatenate([ball.time[:1], np.sort(inside), ball.time[-1:]])
    xy = np.column_stack([np.interp(corners, ball.time, ball.position[:, k]) for k in (0, 1)])
    return float(np.hypot(*np.diff(xy, axis=0).T).sum())


def _find_area(balls: Sequence[BallTrack]) -> Rectangle:
    """The rectangle that the centres reached, m."""
    every = np.concatenate([ball.position for ball in balls])
    (left, bottom), (right, top) = every.min(axis=0), every.max(axis=0)
    return float(left), float(bottom), float(right), float(top)


def _split_by_frame(balls: Sequence[BallTrack]) -> list[Floats]:
    """Positions of all balls (n, 2) in each frame."""
    frame = np.concatenate([ball.frame for ball in balls])
    position = np.concatenate([ball.position for ball in balls])
    order = np.argsort(frame, kind="stable")
    first = np.unique(frame[order], return_index=True)[1]
    return np.split(position[order], first[1:])
