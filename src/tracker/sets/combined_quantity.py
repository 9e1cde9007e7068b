"""One quantity over many collisions: its random-effects mean, its slope, and the influence of each collision."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import fdtrc

from synthcam_shared.arrays import Array, Flags
from synthcam_shared.report.numbers import format_with_error
from tracker.measurement.camera_errors import remove_shared
from tracker.measurement.random_effects import GeneralisedQ, RandomEffects, fit_means_without_each, fit_random_effects

WITHOUT_COLLISION = ("drag", "decel")  # that a ball alone shows too


@dataclass(frozen=True, eq=False)
class CombinedQuantity:
    """One quantity of all collisions that give it an error.

    Attributes
    ----------
    name : str
        Its column in estimates.parquet.
    values : DataFrame
        A row for each collision: result, clip, collision, fit, v_n (m/s), value, std, weight; mean_without,
        scatter_without: mean and scatter of the others; influence: change of the mean by this collision in errors of
        the mean; z: distance from the mean of the others in standard errors with the scatter. The last four are NaN
        with fewer than three collisions.
    mean : RandomEffects
        The random-effects mean; coefficient 0.
    slope : RandomEffects or None
        The regression on v_n: coefficient 0 is the value at `speed`, coefficient 1 the slope, s/m.
    speed : float
        Weighted mean of v_n, m/s.
    by_result : dict
        The random-effects mean of each result that has a value.
    difference_p : float
        Probability of differences between results at least as large, if there are none; NaN with one result.
    """

    name: str
    values: pd.DataFrame
    mean: RandomEffects
    slope: RandomEffects | None
    speed: float
    by_result: dict[str, RandomEffects]
    difference_p: float

    def document(self) -> dict[str, Any]:
        """Give the entry of set.json.

        Returns
        -------
        dict
        """
        slope: dict[str, Any] | None = None
        if self.slope is not None:
            whole = _describe(self.slope, 1)
            slope = {"slope": whole.pop("mean"), **whole, "p": self.slope.p_value[1], "at": self.speed}
            slope |= {"value": self.slope.coefficients[0], "value_std": self.slope.std[0]}
            slope |= {"scatter": self.slope.scatter}
        by_result = {name: {**_describe(one), "n": len(one.weights)} for name, one in self.by_result.items()}
        mean, kept = self.mean, "scatter scatter_low scatter_high prediction q dof q_value i2 birge".split()
        spread = {"p" if name == "q_value" else name: getattr(mean, name) for name in kept}
        document = {"n": len(self.values), **_describe(mean), "shared_std": mean.shared_std[0], **spread}
        document |= {"slope": slope, "by_result": by_result, "difference_p": self.difference_p}
        return document | {"collisions": self.values.to_dict("records")}


def combine_quantity(name: str, values: pd.DataFrame, effects: Array) -> CombinedQuantity:
    """Combine the values of a quantity; fewer than four have no slope.

    values: result, clip, collision, fit, v_n, value, std of each collision. effects: (n, 1, k), of the errors of the
    camera file that several share, as `shared_effects` gives them.
    """
    value, std, speed = (values[column].to_numpy(float) for column in ("value", "std", "v_n"))
    own, shared = remove_shared(std, effects), effects[:, 0]
    mean = fit_random_effects(value, own, shared)
    known = np.isfinite(speed)
    middle = float(np.average(speed[known], weights=mean.weights[known])) if known.any() else np.nan
    slope = None
    if known.sum() >= 4 and np.ptp(speed[known]) > 0 and name not in WITHOUT_COLLISION:
        design = np.column_stack([np.ones(known.sum()), speed[known] - middle])
        slope = fit_random_effects(value[known], own[known], shared[known], design)
    several = len(value) >= 3
    without = np.array(fit_means_without_each(value, own, shared)) if several else np.full((3, len(value)), np.nan)
    of = values["result"].to_numpy()
    groups = {str(one): of == one for one in dict.fromkeys(of)}
    by_result = {one: fit_random_effects(value[rows], own[rows], shared[rows]) for one, rows in groups.items()}
    values = values.assign(
        weight=mean.weights,
        mean_without=without[0],
        scatter_without=np.sqrt(without[2]),
        influence=(mean.coefficients[0] - without[0]) / mean.std[0],
        z=(value - without[0]) / np.sqrt(own**2 + without[1] + without[2]),
    )
    return CombinedQuantity(name, values, mean, slope, middle, by_result, _compare(value, own, shared, groups))


def _compare(value: Array, std: Array, shared: Array, groups: Mapping[str, Flags]) -> float:
    """p-value of the differences between groups, by the F test of a regression on them."""
    parts, n = np.column_stack(list(groups.values())).astype(np.float64), len(value)
    k = parts.shape[1]
    if k < 2 or n - k < 1:
        return float("nan")
    problem = GeneralisedQ(value, std**2, shared, parts)
    means, cov, left = problem.fit(problem.find_variance(n - k))
    apart = np.diff(means)
    between = apart @ np.linalg.solve(np.diff(np.diff(cov, axis=0), axis=1), apart) / (k - 1)
    return float(fdtrc(k - 1, n - k, between / max(left / (n - k), 1.0)))


def _describe(fit: RandomEffects, index: int = 0) -> dict[str, Any]:
    values = {"mean": fit.coefficients, "std": fit.std, "low": fit.low, "high": fit.high}
    return {key: float(value[index]) for key, value in values.items()}


def describe_scatter(one: CombinedQuantity, factor: float = 1.0) -> str:
    """Say how much the true values of a combined quantity differ, with the interval of 95 %; factor: to shown units."""
    if not one.mean.dof:
        return "scatter unknown"
    middle, low, high = (f"{factor * v:.2g}" for v in (one.mean.scatter, one.mean.scatter_low, one.mean.scatter_high))
    return f"scatter {middle} ({low} to {high})" if one.mean.scatter_low > 0 else f"scatter {middle} (at most {high})"


def name_collision(row: pd.Series) -> str:
    """Name a collision of a set by its result, clip and number."""
    return f"{row['result']}, clip {row['clip']}, collision {row['collision']}"


def list_warnings(one: CombinedQuantity) -> Iterable[str]:
    """List in sentences what is unusual in the combined values of a quantity."""
    min_influence, outlier_z = 1.0, 4.0  # of one collision: on the mean, in its errors; from the mean of the others
    max_p = 0.01  # of a slope, or of a difference between results
    mean, slope = one.mean, one.slope
    for _, row in one.values[np.abs(one.values["influence"]) > min_influence].iterrows():
        which, whole = name_collision(row), format_with_error(mean.coefficients[0], mean.std[0])
        yield f"{one.name}: {which} decides the mean: {row['mean_without']:.4g} without it, {whole} with it"
    for _, row in one.values[np.abs(one.values["z"]) > outlier_z].iterrows():
        which = name_collision(row)
        far = f"{abs(row['z']):.1f} standard errors from the others, with the scatter"
        without = f"without it the mean is {row['mean_without']:.4g} and the scatter {row['scatter_without']:.2g}"
        yield f"{one.name}: {which} is {far}; {without}"
    if slope is not None and slope.p_value[1] < max_p:
        by = f"by {format_with_error(slope.coefficients[1], slope.std[1])} per m/s (p {slope.p_value[1]:.2g})"
        yield f"{one.name} changes with v_n {by}; the mean is that at {one.speed:.3g} m/s"
    if one.difference_p < max_p:
        why = f"by more than their errors and the scatter (p {one.difference_p:.2g})"
        yield f"{one.name} differs between the results {why}"
