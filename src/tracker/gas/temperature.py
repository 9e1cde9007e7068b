"""Granular temperature against time, and the shape of the distribution of velocities.

The temperature is the variance of one component of the velocities about their mean, in m^2/s^2 (per unit mass).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array
from tracker.gas.free_paths import FreePath, sum_sides
from tracker.gas.velocities import HalfVelocities

HALVES = ("even_x", "even_y", "odd_x", "odd_y")
BY_FRICTION = ("friction_x", "friction_y")
MIN_BALLS = 3  # in a frame, for a temperature about the mean velocity
HOTTER = 0.3  # how much hotter balls without a velocity may be; fast ones are hit more often
MIN_SIGNIFICANCE = 5.0  # of a temperature in its errors, for the shape of the distribution in that frame


def tabulate_velocities(paths: Sequence[FreePath]) -> pd.DataFrame:
    """Tabulate the velocities for the temperature: frame, ball, both halves, errors (m/s), and gains (1/s^2).

    unknown: balls that are in view in this frame and whose velocity is not known.
    """
    parts = [path.velocities.take(slice(None, -2)) for path in paths]
    every = HalfVelocities.join(parts)
    table = pd.DataFrame(
        {
            "frame": np.concatenate([path.frame for path in paths]),
            "ball": np.repeat([path.ball for path in paths], [len(path.frame) for path in paths]),
            **dict(zip(HALVES, [*every.even.T, *every.odd.T], strict=True)),
            "gain_even": every.gain_even,
            "gain_odd": every.gain_odd,
            "gain_common": every.gain_common,
            "unsure": np.concatenate([path.unsure[:-2] for path in paths]),
            **dict(zip(BY_FRICTION, _join_by_friction(paths).T, strict=True)),
            "smoothed": np.concatenate(
                [np.zeros(len(p.frame)) if p.smoothed is None else p.smoothed[:-2] for p in paths]
            ),
        }
    )
    table["unknown"] = table.groupby("frame")["even_x"].transform(lambda column: column.isna().sum())
    return table[every.known].reset_index(drop=True)


def _join_by_friction(paths: Sequence[FreePath]) -> Array:
    none = np.zeros((1, 2))
    parts = [np.tile(none, (len(p.frame), 1)) if p.by_friction is None else p.by_friction[:-2] for p in paths]
    return np.concatenate(parts)


def measure_noise(table: pd.DataFrame) -> float:
    """Measure the noise that adds to the temperature: of a coordinate, m, from the differences of both halves."""
    table = table[table["gain_common"] == 0]
    size = np.sqrt(table["gain_even"] + table["gain_odd"])
    every = np.concatenate([(table[f"even_{k}"] - table[f"odd_{k}"]) / size for k in "xy"])
    return float(np.median(np.abs(every)) / 0.67449) if len(every) else float("nan")


def measure_temperatures(
    table: pd.DataFrame, noise: float, paths: Sequence[FreePath] = (), hidden: pd.Series | None = None
) -> pd.DataFrame:
    """Measure the temperature and the mean velocity of each frame with three balls or more.

    temperature is the sum of (even - mean even) . (odd - mean odd) over the balls, over 2 (n - 1). temperature_std is
    its error. It contains the noise, balls whose velocity is not known, and slides after contacts that are too short
    to be seen. All slides share the error of the friction; what else they err by is as likely along the velocity as
    across it. Straight lines between contacts are all too slow. It also contains the sides of frames at contacts, and
    contacts that hide next to others. temperature_sampling is its further error as the temperature of an infinite
    system with such balls.

    noise: of a coordinate, m. paths: those of the table, for the sides. hidden: balls with a velocity from beyond a
    contact that hides, by frame.
    """
    group = table.groupby("frame")
    product, variance = _products(table, noise)
    variance = variance + 2 * np.maximum(product, 0) * table["unsure"] ** 2
    velocities = table[["even_x", "even_y"]].to_numpy() + table[["odd_x", "odd_y"]].to_numpy()
    by_friction = (velocities * table[list(BY_FRICTION)].to_numpy()).sum(axis=1)
    smoothed = 2 * np.sqrt(np.maximum(product, 0)) * table["smoothed"]
    rows = {"frame": table["frame"], "product": product, "variance": variance}
    rows |= {"by_friction": by_friction, "smoothed": smoothed}
    sums = pd.DataFrame(rows).groupby("frame")
    at_contacts = sum_sides(paths).groupby("frame")["variance"].sum().reindex(group.size().index, fill_value=0.0)
    if hidden is not None:
        at_contacts += hidden.reindex(at_contacts.index, fill_value=0.0) * sums["product"].var().fillna(0.0)
    mean, balls, unknown = group[list(HALVES)].mean(), group.size(), group["unknown"].first()
    spread = sums["product"].std() / 2
    temperature = sums["product"].sum() / (2 * (balls - 1))
    missing = np.hypot(spread * np.sqrt(unknown), HOTTER * temperature * unknown) / (balls + unknown)
    variances = sums["variance"].sum() + at_contacts
    noisy = np.sqrt(variances + sums["by_friction"].sum() ** 2 + sums["smoothed"].sum() ** 2) / (2 * (balls - 1))
    result = pd.DataFrame(
        {
            "balls": balls,
            "unknown": unknown,
            "temperature": temperature,
            "temperature_std": np.hypot(noisy, missing),
            "temperature_sampling": spread / np.sqrt(balls),
            "drift_x": (mean["even_x"] + mean["odd_x"]) / 2,
            "drift_y": (mean["even_y"] + mean["odd_y"]) / 2,
        }
    )
    return result[result["balls"] >= MIN_BALLS].reset_index()


def _products(table: pd.DataFrame, noise: float) -> tuple[Array, Array]:
    """Squares of the velocities about the mean of their frame, and their variances."""
    group = table.groupby("frame")
    about = {name: (table[name] - group[name].transform("mean")).to_numpy() for name in HALVES}
    even, odd = (np.column_stack([about[f"{half}_x"], about[f"{half}_y"]]) for half in ("even", "odd"))
    gains = (table[name].to_numpy() for name in ("gain_even", "gain_odd", "gain_common"))
    return HalfVelocities(even, odd, *gains).square(noise)


def _significant(table: pd.DataFrame, temperatures: pd.DataFrame) -> pd.DataFrame:
    """The velocities of frames whose temperature is well above its error, with the columns of both tables."""
    known = temperatures["temperature"] > MIN_SIGNIFICANCE * temperatures["temperature_std"]
    return table.merge(temperatures[known], on="frame")


def _jackknife(sums: Array, counts: Array) -> Array:
    """Standard error of a ratio of sums over balls, which leaves out one ball at a time; (balls, ...) and (balls,)."""
    k = len(counts)
    without = ((sums.sum(axis=0) - sums).T / (counts.sum() - counts)).T
    return np.asarray(np.sqrt((k - 1) / k * ((without - without.mean(axis=0)) ** 2).sum(axis=0)))


def measure_sonine(table: pd.DataFrame, temperatures: pd.DataFrame, noise: float) -> tuple[float, float]:
    """Measure the shape of the velocities' distribution: a2 = <v^4> / (2 <v^2>^2) - 1, 0 of a Maxwellian, and error.

    Each frame is divided by its own temperature. A Maxwellian of n balls about their mean then has <v^4> less by
    (n - 1) / n, which is corrected.
    """
    table = _significant(table, temperatures)
    if table["ball"].nunique() < MIN_BALLS:
        return float("nan"), float("nan")
    product, variance = _products(table, noise)
    n, temperature = table["balls"].to_numpy(), table["temperature"].to_numpy()
    # v^2 of a ball about the mean of n is (n - 1) / n of that about the true mean
    fourth = (product**2 - variance) / (8 * temperature**2) * (n / (n - 1)) ** 2 * n / (n - 1)
    sums = pd.DataFrame({"ball": table["ball"], "sum": fourth, "count": 1.0}).groupby("ball").sum()
    totals, counts = sums["sum"].to_numpy(), sums["count"].to_numpy()
    return float(totals.sum() / counts.sum() - 1), float(_jackknife(totals, counts))


def measure_distribution(table: pd.DataFrame, temperatures: pd.DataFrame, bins: int) -> pd.DataFrame:
    """Density of the components of velocities over sqrt(temperature); the error is the jackknife's over balls."""
    table, edges = _significant(table, temperatures), np.linspace(-4.0, 4.0, bins + 1)
    middle, width = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
    balls = np.unique(table["ball"])
    if len(balls) < MIN_BALLS:
        return pd.DataFrame({"c": middle, "density": np.nan, "density_std": np.nan})
    share = (table["gain_odd"] / (table["gain_even"] + table["gain_odd"])).to_numpy()
    counts, numbers = np.zeros((len(balls), bins)), np.zeros(len(balls))
    for k in "xy":
        v = share * table[f"even_{k}"] + (1 - share) * table[f"odd_{k}"] - table[f"drift_{k}"]
        c = (v / np.sqrt(table["temperature"])).to_numpy()
        for row, ball in enumerate(balls):
            own = c[(table["ball"] == ball).to_numpy()]
            counts[row] += np.histogram(own, edges)[0]
            numbers[row] += len(own)
    density = counts.sum(axis=0) / numbers.sum() / width
    return pd.DataFrame({"c": middle, "density": density, "density_std": _jackknife(counts, numbers) / width})
