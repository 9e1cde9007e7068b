"""The columns of the local estimate in estimates.parquet, and its calibration by the balance of momentum.

Residuals cannot show an error that is smooth over a stretch. Examples are a bent map of the camera, a marker beside
the centre of mass, and a body that lifts off. The balance of momentum shows such errors. The errors are those of the
residuals times a factor. Each component of each velocity has a further error that is proportional to the speed of the
hit. Along the line of centres there is a bias that is proportional to the normal speed. In one recording the factor is
1 and that error is a prior. In a set they are fitted: the factor where errors are larger in hits that are measured less
well.

The fits of short stretches assume, within allowances, what is known of the motions, such as equal friction along all
paths. In a crowd the balances also show the size of these allowances.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from synthcam_shared.arrays import Array
from tracker.measurement.collision.adequacy import CROWD, GLIDE, ROLL, find_gliding_hits
from tracker.measurement.local.local_estimate import BALANCE, LOCAL_NAMES, UNSEEN_ON_AIR, VELOCITIES, LocalEstimate
from tracker.measurement.local.recommendation import COMPARED, is_known, recommend
from tracker.settings import FitSettings

PRIOR_WIDTH = 1.0  # of the logarithm of the errors of a set, about those of its recordings alone
USUAL_EXCESS = 2.0  # of what a set adds to the errors of residuals, over them; real sets show 0.8 to 2.8
COMMON_SHARE = 0.1  # of the errors of velocities, what all contacts of a crowd share; a bent map makes less
# Largest standard errors with which quantities are reported; others have max_relative_error of their value.
_LARGEST_ERRORS = {"b": 0.05, "s": 0.3, "r": 0.2, "C": 0.1, "final_angle": 0.1, "impact_energy": 0.1}
_LARGEST_ERRORS |= {"energy_fraction": 0.1, "momentum_fraction": 0.1, "mass_ratio": np.inf}
_LARGEST_ERRORS |= dict.fromkeys(("t_c", *VELOCITIES, *BALANCE, "w1n", "w1t", "w2n", "w2t"), np.inf)
_COMPARED = [LOCAL_NAMES.index(name) for name in COMPARED]
COLUMNS = tuple(name if name == "mass_ratio" else f"{name}_local" for name in LOCAL_NAMES)


@dataclass(frozen=True)
class LocalErrors:
    """Errors of velocities beyond their residuals."""

    bias_n: float = 0.0  # of the balance along n, over the normal speed of approach
    bias_std: float = 0.0
    error_n: float = 0.0  # of each component along n, over v0
    error_t: float = 0.0  # of each component along t, over v0
    factor: float = 1.0  # on the errors of velocities by the residuals
    log_ratio: float = 0.0  # logarithm of the mass of the first particle over that of the second, beyond what is given
    log_ratio_std: float = 0.0
    allowances: float = 1.0  # size of the errors of what is known of the motions of a crowd, over the assumed one
    mass_excess: float = 0.0  # the same logarithm where masses are given, which recoil contradicts by this
    common_n: float | None = None  # of what all hits share along n, over the normal speed; None: the bias and its error
    hits: int = 0  # from which these are fitted; 0: a prior


def make_empty_columns() -> dict[str, Any]:
    """Make the columns of a collision without a local estimate."""
    row: dict[str, Any] = {}
    for column in COLUMNS:
        row[column] = row[f"{column}_std"] = np.nan
    row |= {"chi2_local": np.nan, "dof_local": np.nan, "misfit_local": False, "motion_local": "", "local": "{}"}
    row |= dict.fromkeys(("contact_duration_local", "contact_duration_local_std"), np.nan)
    row |= dict.fromkeys(("local_bias", "local_error_n", "local_error_t", "local_factor", "local_allowances"), np.nan)
    row |= {"local_hits": 0}
    return row | {"local_shared": "{}", "recommended": "none", "why": ""}


def make_local_columns(
    estimate: LocalEstimate | str, masses_known: bool = False, foreign: str = "", settings: FitSettings | None = None
) -> dict[str, Any]:
    """Write a local estimate as columns; its errors beyond the residuals are the prior of one recording.

    A text is the reason why there is none. foreign: why the tied fit is not one of these bodies, "" if it is.
    """
    if isinstance(estimate, str):
        local = json.dumps({"reason": estimate, "foreign": foreign}, separators=(",", ":"))
        return make_empty_columns() | {"local": local}
    settings = settings or FitSettings()
    excess = max(estimate.chi2 / estimate.dof - 1 - 3 * np.sqrt(2 / max(estimate.dof, 1.0)), 0.0)
    prior = settings.local_velocity_error
    if estimate.errors_known:
        prior = max(prior * min(1.0, float(np.sqrt(excess))), settings.min_local_velocity_error)
    at = [LOCAL_NAMES.index(name) for name in VELOCITIES]
    response = np.nan_to_num(estimate.response[:, :8])
    turn = response[at]  # of components along n and t to those along x and y

    def find_velocity_std(cov: Array) -> Array:
        """The part of errors that velocities make; the rest is that of places, as the line of centres."""
        of_velocities = turn.T @ np.nan_to_num(cov[np.ix_(at, at)]) @ turn
        return np.asarray(np.sqrt(np.maximum(((response @ of_velocities) * response).sum(axis=1), 0.0)))

    raw = {
        "value": _rounded(estimate.value),
        "std": _rounded(estimate.std),
        "velocity_std": _rounded(find_velocity_std(estimate.cov)),
        "r_std": _rounded(estimate.std[[LOCAL_NAMES.index("r")]])[0],
        "response": [_rounded(line) for line in estimate.response],
        "cov": [_rounded(line) for line in estimate.cov[np.ix_(_COMPARED, _COMPARED)]],
        "shared": _name_effects(estimate.shared),
        "v0": float(estimate.value[LOCAL_NAMES.index("v0")]),
        "vn": estimate.normal_speed,
        "prior": prior,
        "max_relative_error": settings.max_relative_error,
        "unseen": sorted(estimate.unseen),
        "masses_known": masses_known,
        "foreign": foreign,
    }
    if estimate.cov_of_known is not None:
        raw["known_std"] = _rounded(np.sqrt(np.maximum(np.diag(estimate.cov_of_known), 0.0)))
        raw["known_velocity_std"] = _rounded(find_velocity_std(estimate.cov_of_known))
    row = make_empty_columns() | {"local": json.dumps(raw, separators=(",", ":"))}
    row |= {"chi2_local": estimate.chi2, "dof_local": estimate.dof}
    row["misfit_local"] = bool(estimate.adequate < settings.rejection_level)
    row["motion_local"] = GLIDE if estimate.glides else ROLL
    push = estimate.push
    if push is not None and push.std <= settings.max_relative_error * push.value:
        row |= {"contact_duration_local": push.value, "contact_duration_local_std": push.std}
    return row | apply_errors(row, LocalErrors(error_n=prior, error_t=prior))


def _rounded(values: Array) -> list[float | None]:
    return [float(f"{v:.9g}") if np.isfinite(v) else None for v in values]


def _name_effects(shared: Mapping[str, tuple[float, Array]]) -> dict[str, dict[str, Any]]:
    """Errors that several hits share as JSON, by key: the value, and the effects of one standard error by quantity."""
    return {
        key: {"of": of, "effect": {n: v for n, v in zip(LOCAL_NAMES, _rounded(effect), strict=True) if v}}
        for key, (of, effect) in shared.items()
    }


def apply_errors(row: Mapping[str, Any], errors: LocalErrors) -> dict[str, Any]:
    """Compute the local columns of a row with these errors beyond the residuals.

    A bias of the balance may be an error of a velocity along n, a loss of momentum, or unknown masses. So it counts as
    an error: that of each velocity in turn, in proportion to its weight in the balance. So does the error of the bias:
    a mean of many hits is no more certain than their balance.
    """
    raw = json.loads(row.get("local", "{}"))
    if "value" not in raw:
        return {}
    value = np.array(raw["value"], dtype=np.float64)
    response, by_mass = np.split(np.nan_to_num(np.array(raw["response"], dtype=np.float64)), [8], axis=1)
    size = raw["v0"] * np.tile([errors.error_n, errors.error_t], 4)
    common = _list_common_errors(row, errors, response, by_mass[:, 0])
    fixed, widened = _split_variances(raw, errors.allowances)
    by_residuals = fixed + errors.factor**2 * widened
    by_set = sum(effect**2 for _, effect in common.values())
    wide = np.sqrt(by_residuals + ((response * size) ** 2).sum(axis=1) + by_set)
    shared = _scale_slides(raw, fixed + widened) | _name_effects(common)
    role = _role(row)
    value = value + by_mass[:, 0] * role * errors.log_ratio
    if errors.log_ratio_std > 0:  # all hits have one ratio, and its error is the only one
        at = LOCAL_NAMES.index("mass_ratio")
        value[at] = np.exp(role * errors.log_ratio)
        wide[at] = value[at] * errors.log_ratio_std
        for key, block in shared.items():
            effect = {name: v for name, v in block["effect"].items() if name != "mass_ratio"}
            if key == "mass_ratio":
                effect["mass_ratio"] = float(role * wide[at])
            shared[key] = block | {"effect": effect}
    b, s = (LOCAL_NAMES.index(name) for name in "bs")
    if not abs(value[b]) > 5.0 * wide[b]:  # s is a ratio by b
        value[s] = np.nan
    out = dict[str, Any]()
    for k, (name, column) in enumerate(zip(LOCAL_NAMES, COLUMNS, strict=True)):
        limit = _LARGEST_ERRORS.get(name, raw["max_relative_error"] * abs(value[k]))
        folded = name == "final_angle" and value[k] < 3 * wide[k]
        known = name not in raw["unseen"] and np.isfinite(value[k]) and wide[k] <= limit and not folded
        out[column], out[f"{column}_std"] = (float(value[k]), float(wide[k])) if known else (np.nan, np.nan)
    out |= {"local_bias": errors.bias_n, "local_error_n": errors.error_n, "local_error_t": errors.error_t}
    out |= {"local_factor": errors.factor, "local_allowances": errors.allowances, "local_hits": errors.hits}
    return out | {"local_shared": json.dumps(shared, separators=(",", ":"))}


def _scale_slides(raw: Mapping[str, Any], variances: Array) -> dict[str, dict[str, Any]]:
    """The shared errors of a hit, with that of the model of slides in proportion to the errors without it."""
    shared = dict(raw["shared"])
    if "slides" in shared:
        shrinks = np.sqrt(variances / np.maximum(np.array(raw["std"], dtype=np.float64) ** 2, 1e-300))
        effect = shared["slides"]["effect"]
        shrunk = {name: float(shrinks[LOCAL_NAMES.index(name)]) * size for name, size in effect.items()}
        shared["slides"] = shared["slides"] | {"effect": shrunk}
    return shared


def _split_variances(raw: Mapping[str, Any], allowances: float = 1.0) -> tuple[Array, Array]:
    """Split variances (n,) by residuals and camera into what the factor does not widen, and what it does.

    It widens the part that velocities make without the errors of the camera. allowances: as in `LocalErrors`.
    """
    std, of_velocities = (np.array(raw[key], dtype=np.float64) for key in ("std", "velocity_std"))
    # A part may exceed the whole: a descent may end with a short step, whose derivatives it does not compute again. The
    # covariance holds those before the step, and the known part those after it.
    if "known_std" in raw:
        known, known_velocities = (
            np.minimum(np.array(raw[key], dtype=np.float64), most)
            for key, most in (("known_std", std), ("known_velocity_std", of_velocities))
        )
        std = np.sqrt(std**2 + (allowances**2 - 1) * known**2)
        of_velocities = np.sqrt(of_velocities**2 + (allowances**2 - 1) * known_velocities**2)
    effects = np.array([[block["effect"].get(name, 0.0) for name in LOCAL_NAMES] for block in raw["shared"].values()])
    of_camera = (np.reshape(effects, (-1, len(std))) ** 2).sum(axis=0)
    widened = np.clip(of_velocities**2 - of_camera, 0.0, std**2)
    return std**2 - widened, widened


def find_covariance(row: Mapping[str, Any]) -> Array:
    """Find the covariance (4, 4) of v0, b, r and s of a local estimate, with the errors beyond the residuals.

    The factor widens the errors, as in the columns, and leaves their correlations.
    """
    raw = json.loads(row["local"])
    fixed, widened = (
        np.nan_to_num(part[_COMPARED]) for part in _split_variances(raw, row.get("local_allowances", 1.0))
    )
    claimed = np.nan_to_num(np.array(raw["std"], dtype=np.float64)[_COMPARED]) ** 2
    growth = np.sqrt((fixed + row["local_factor"] ** 2 * widened) / np.maximum(claimed, 1e-300))
    by_residuals = growth[:, None] * np.nan_to_num(np.array(raw["cov"], dtype=np.float64)) * growth
    response = np.nan_to_num(np.array(raw["response"], dtype=np.float64))[_COMPARED, :8]
    spread = [response * raw["v0"] * np.tile([row["local_error_n"], row["local_error_t"]], 4)]
    for key, block in json.loads(row["local_shared"]).items():
        if key not in raw["shared"]:  # the covariance has those of the camera
            spread.append(np.array([[block["effect"].get(name, 0.0)] for name in COMPARED], dtype=np.float64))
    every = np.hstack(spread)
    return np.asarray(by_residuals + every @ every.T)


def _list_common_errors(
    row: Mapping[str, Any], errors: LocalErrors, response: Array, by_mass: Array
) -> dict[str, tuple[float, Array]]:
    """The errors that all hits of a set have in common, by key: value, and effect (n,) of one standard error.

    They are the bias, which may be that of each velocity along n, and the ratio of the masses. Given masses that recoil
    contradicts change no value, and the contradiction counts as an error.
    """
    weights = response[LOCAL_NAMES.index("balance_n")] * np.tile([1.0, 0.0], 4)
    total, out = float(weights @ weights), {}
    size = float(np.hypot(errors.bias_n, errors.bias_std)) if errors.common_n is None else errors.common_n
    if size and total > 0:
        unit = size * json.loads(row["local"])["vn"] / np.sqrt(total)
        out = {f"bias_{VELOCITIES[k][:3]}": (errors.bias_n, response[:, k] * unit) for k in np.flatnonzero(weights)}
    if errors.log_ratio_std > 0:
        out["mass_ratio"] = (errors.log_ratio, by_mass * _role(row) * errors.log_ratio_std)
    if errors.mass_excess:
        out["ball_masses"] = (errors.mass_excess, by_mass * _role(row) * errors.mass_excess)
    return out


def _role(row: Mapping[str, Any]) -> float:
    """1 if the first of two particles, by their numbers, is the struck ball, else -1."""
    return 1.0 if row.get("particle1", 0) < row.get("particle2", 1) else -1.0


def calibrate_rows(rows: Sequence[Mapping[str, Any]], min_hits: int = 8) -> LocalErrors | None:
    """Fit the errors beyond the residuals to the balance of momentum of all hits of a set; None of too few hits.

    The biases and the ratio of masses are the likeliest. The errors are means over all that fit, because the likeliest
    ones of few hits are too small; see `_Balances`.

    If each of two bodies strikes the other a few times, the ratio of their masses is fitted too, or tested if they are
    given. Recoil from either side distinguishes it from a bias. It counts if it makes the balances likelier by 3
    standard errors. Otherwise wrong masses would look like errors of velocities.

    Contacts of a crowd that no free motion describes are left out: a third body may have hit one of both.

    The balances say nothing if masses are not given and differ from hit to hit (`_is_of_many_masses`).
    """
    usable = [row for row in rows if is_known(row, "r_local") and not _is_disturbed(row)]
    if len(usable) < min_hits:
        return None
    found = [json.loads(row["local"]) for row in usable]
    if _is_of_many_masses(usable, found):
        return None
    crowd = any(row.get("status") == CROWD for row in usable)
    balances, by_mass = _Balances.of(found, crowd)
    recoil = _recoil_by_mass(usable, found, by_mass)
    levers = np.column_stack([[raw["vn"] for raw in found], *recoil])
    best, price = balances.fit(levers)
    if recoil:
        without, price_without = balances.fit(levers[:, :1])
        if price > price_without - 3.0**2 / 2:
            best, levers, recoil = without, levers[:, :1], []
    allowances = balances.find_allowances(levers, best)
    if allowances != balances.allowances:
        balances = replace(balances, allowances=allowances)
        best, _ = balances.fit(levers)
    logs, excess = balances.average(levers, best)
    doubt = np.sqrt(np.diag(np.linalg.inv((levers / balances.find_variance(logs, excess)[:, :1]).T @ levers)))
    errors = LocalErrors(
        bias_n=float(best[0]),
        bias_std=float(doubt[0]),
        error_n=float(np.exp(logs[0])),
        error_t=float(np.exp(logs[1])),
        factor=float(np.hypot(1.0, excess)),
        hits=len(usable),
    )
    errors = replace(errors, allowances=allowances)
    if crowd:
        errors = replace(errors, common_n=_find_common_error(errors))
    if recoil and any(raw["masses_known"] for raw in found):
        return replace(errors, mass_excess=-float(best[1]))
    if recoil:
        half = float(np.clip(-best[1] / 2, -0.99, 0.99))  # the balance goes as tanh(log_ratio / 2)
        errors = replace(errors, log_ratio=2 * np.arctanh(half), log_ratio_std=float(doubt[1]) / (1 - half**2))
    return errors


def _find_common_error(errors: LocalErrors) -> float:
    """Find the root mean square of what all contacts of a crowd share along n, over the normal speed.

    Balls of a crowd meet in all places and directions, so that most errors of velocities average out. The prior of what
    they share is the horseshoe of Carvalho, Polson and Scott (2010), Biometrika 97, 465: a normal distribution whose
    size has the half of a Cauchy distribution, with COMMON_SHARE of what the four velocities of one contact err by.
    Noise of the balances hardly counts then, and a bias of many errors, as that of unequal balls, counts whole.
    """
    quantiles = (np.arange(2000) + 0.5) / 2000
    sizes = COMMON_SHARE * 2 * errors.error_n * np.tan(quantiles * np.pi / 2)
    variance = sizes**2 + errors.bias_std**2
    chance = -(errors.bias_n**2) / variance / 2 - np.log(variance) / 2
    weights = np.exp(chance - chance.max())
    kept = sizes**2 / variance  # share of the bias that is no noise
    square = (kept * errors.bias_n) ** 2 + kept * errors.bias_std**2
    return float(np.sqrt(weights @ square / weights.sum()))


def _is_of_many_masses(
    rows: Sequence[Mapping[str, Any]],
    found: Sequence[Mapping[str, Any]],
    *,
    sigma: float = 5.0,
    least: float = 0.2,
    share: float = 0.25,
) -> bool:
    """Tell if recoil shows masses that differ from hit to hit, and the camera files give none.

    In more than `share` of the hits the logarithm of the mass ratio must be off the median by so many errors, and by
    more than `least`. A fit to the balances would take the masses for errors of velocities, and lose all estimates.
    """
    if any(raw["masses_known"] for raw in found) or any(row.get("status") == CROWD for row in rows):
        return False
    at, prior = LOCAL_NAMES.index("mass_ratio"), LocalErrors()
    sizes = np.tile([prior.error_n, prior.error_t], 4)
    values, errors = np.ones(len(rows)), np.full(len(rows), np.inf)
    for k, raw in enumerate(found):
        value, std = (np.array(raw[key], dtype=np.float64)[at] for key in ("value", "std"))
        pushed = np.array(raw["response"], dtype=np.float64)[at, :8] * raw["v0"] * sizes
        if value > 0 and np.isfinite(wide := np.hypot(std, np.linalg.norm(pushed))):
            values[k], errors[k] = value, wide / value
    logs = np.log(values) * [_role(row) for row in rows]
    off = np.abs(logs - np.median(logs))
    return bool(np.mean(off > np.maximum(sigma * errors, least)) > share)


def _is_disturbed(row: Mapping[str, Any]) -> bool:
    return bool(row.get("status") == CROWD and row.get("misfit_local", False))


@dataclass(frozen=True)
class _Balances:
    """The balances of momentum of the hits of a set, along n and t, and how likely errors beyond the residuals are.

    Each balance has the variance of its residuals and of these errors. A wide prior about the errors of one recording
    counts where the residuals hide them. A share of the hits may be anything, such as two contacts at once: their
    balance is off by a third of the speed. In a crowd a third body may be many times faster than both. So the
    distribution of such balances has the tails of a Cauchy distribution there.
    """

    off: Array  # (hits, 2)
    fixed: Array  # (hits, 2) variances that no factor widens
    widened: Array  # (hits, 2) variances by the residuals of velocities
    spread: Array  # (hits, 2) of a balance by errors of each velocity as large as v0
    v0: Array  # (hits,)
    known: tuple[Array, Array]  # (hits, 2) of both variances, the parts by errors of what is known of the motions
    usual: float  # logarithm of the errors over v0 that one recording is assumed to have
    crowd: bool = False
    allowances: float = 1.0  # as in LocalErrors

    @staticmethod
    def of(found: Sequence[Mapping[str, Any]], crowd: bool) -> tuple[_Balances, Array]:
        """Read the balances, and the derivative of those along n by the logarithm of the mass ratio."""
        at = [LOCAL_NAMES.index(name) for name in BALANCE]
        off = np.array([[raw["value"][k] for k in at] for raw in found])
        fixed, widened = np.array([_split_variances(raw) for raw in found])[..., at].swapaxes(0, 1)
        without = np.array([_split_variances(raw, 0.0) for raw in found])[..., at].swapaxes(0, 1)
        v0 = np.array([raw["v0"] for raw in found])
        response = np.nan_to_num(np.array([[raw["response"][k] for k in at] for raw in found], dtype=np.float64))
        sizes = (response[:, axis, axis:8:2] for axis in (0, 1))
        spread = np.stack([np.sqrt((part**2).sum(-1)) for part in sizes], -1) * v0[:, None]
        least = 1e-4  # error of a velocity over that of the hit, where a setting says that there is none
        usual = float(np.log(max(np.median([raw["prior"] for raw in found]), least)))
        known = (fixed - without[0], widened - without[1])
        return _Balances(off, fixed, widened, spread, v0, known, usual, crowd), response[:, 0, 8]

    def find_variance(self, logs: Array, excess: Array | float) -> Array:
        """Variances (..., hits, 2); logs: of both errors over v0; excess: of the errors of residuals, over them."""
        fixed, widened = (
            part + (self.allowances**2 - 1) * known
            for part, known in zip((self.fixed, self.widened), self.known, strict=True)
        )
        return np.asarray(fixed + (1 + excess**2) * widened + (np.exp(logs) * self.spread) ** 2)

    def weigh(self, logs: Array, excess: Array, levers: Array, lever_sizes: Array) -> Array:
        """Logarithms (..., 2) of the probabilities of the balances along n and t, with those of what is known."""
        odd_share, odd_size = 0.05, 0.3
        var = self.find_variance(logs, excess)
        square = (self.off - np.column_stack([levers @ lever_sizes, 0 * self.v0])) ** 2
        wide = var + (odd_size * self.v0[:, None]) ** 2
        well, unusual = (-0.5 * (square / v + np.log(v)) for v in (var, wide))
        if self.crowd:
            unusual = -np.log1p(square / wide) - 0.5 * np.log(wide * np.pi / 2)
        likelihood = np.logaddexp(np.log(1 - odd_share) + well, np.log(odd_share) + unusual).sum(axis=-2)
        known = ((logs - self.usual) / PRIOR_WIDTH) ** 2 + (excess / USUAL_EXCESS) ** 2 / 2
        return np.asarray(likelihood - 0.5 * known[..., 0, :])

    def fit(self, levers: Array) -> tuple[Array, float]:
        """The likeliest sizes of the levers, and the negative logarithm of their probability."""

        def price(x: Array) -> float:
            """x: logarithms of both errors, excess, and sizes of the levers."""
            return -float(self.weigh(x[None, :2], x[2:3], levers, x[3:]).sum())

        zeros = np.zeros(levers.shape[1])
        starts = [np.append([np.log(error), np.log(error), 0.5], zeros) for error in (0.003, 0.03)]
        sizes = np.append([0.5, 0.5, 0.5], zeros + 0.02)
        simplex = np.vstack([0 * sizes, np.diag(sizes)])
        tries = (
            minimize(price, x, method="Nelder-Mead", options={"initial_simplex": simplex + x, "maxfev": 4000})
            for x in starts
        )
        best = min(tries, key=lambda m: float(m.fun))
        return np.asarray(best.x[3:], dtype=np.float64), float(best.fun)

    def find_allowances(self, levers: Array, lever_sizes: Array) -> float:
        """Find the root mean square of `allowances` over all that fit; its prior is the half of a normal one.

        The prior mean square is 1, so that few hits keep the errors that they have alone.
        """
        if not any(part.any() for part in self.known):
            return self.allowances
        tried = np.linspace(0.0, 3.0, 31)
        logs = np.linspace(self.usual - 4 * PRIOR_WIDTH, self.usual + 4 * PRIOR_WIDTH, 17)[:, None] * np.ones(2)
        excess = np.linspace(0.0, 4 * USUAL_EXCESS, 17)[:, None, None, None]
        parts = [
            replace(self, allowances=float(each)).weigh(logs[:, None], excess, levers, lever_sizes) for each in tried
        ]
        along = np.logaddexp.reduce(np.array(parts), axis=2)  # (tried, excess, 2)
        chance = np.logaddexp.reduce(along.sum(axis=-1), axis=1) - tried**2 / 2
        weights = np.exp(chance - chance.max())
        return float(np.sqrt(weights @ tried**2 / weights.sum()))

    def average(self, levers: Array, lever_sizes: Array) -> tuple[Array, float]:
        """The means of the logarithms of both errors, and the root mean square of the excess, over all that fit."""
        low, high = (self.usual + np.array([-self.usual, k, k]) for k in (-6 * PRIOR_WIDTH, 6 * PRIOR_WIDTH))
        high[0] = 4 * USUAL_EXCESS
        for _ in range(4):  # each time nearer to all that fits
            grid = np.linspace(low, high, 25)
            logs, excess = grid[:, None, 1:], grid[:, None, None, None, 0]
            part = self.weigh(logs, excess, levers, lever_sizes)  # (excess, logs, 2)
            weights = 1 / self.find_variance(logs, excess)[..., 0]
            part[..., 0] -= np.linalg.slogdet((levers.T * weights[..., None, :]) @ levers)[1] / 2  # these are fitted
            either = np.logaddexp.reduce(part, axis=1)
            along = np.logaddexp.reduce(part + either[:, None, ::-1], axis=0)  # the axes share the excess alone
            chance = np.column_stack([either.sum(axis=1), along])
            chance = np.exp(chance - chance.max(axis=0))
            inside = [np.flatnonzero(column > 1e-4) for column in chance.T]
            low = np.array([grid[max(k[0] - 1, 0), axis] for axis, k in enumerate(inside)])
            high = np.array([grid[min(k[-1] + 1, len(grid) - 1), axis] for axis, k in enumerate(inside)])
        chance /= chance.sum(axis=0)
        return (chance * grid).sum(axis=0)[1:], float(np.sqrt(chance[:, 0] @ grid[:, 0] ** 2))


def _recoil_by_mass(rows: Sequence[Mapping[str, Any]], found: Sequence[Any], by_mass: Array) -> list[Array]:
    """The derivative of each balance along n by the logarithm of the mass ratio, if recoil can show the ratio."""
    pairs = [(row.get("particle1", -1), row.get("particle2", -1)) for row in rows]
    strikers = [pair[1] for pair in pairs]
    two = len({frozenset(pair) for pair in pairs}) == 1 and -1 not in pairs[0]
    crowd = any(row.get("status") == CROWD for row in rows)  # its tracks are other balls in the next clip
    if not two or crowd or min(map(strikers.count, pairs[0])) < 3:
        return []
    return [by_mass * [_role(row) for row in rows]]


def calibrate_set(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Calibrate the local columns of a set by its balances of momentum; few hits keep their prior.

    If the bodies of the set glide (`find_gliding_hits`), its other hits have no friction and no spin either.
    """
    rows = withhold_friction(rows) if find_gliding_hits(rows) else rows
    errors = calibrate_rows(rows)
    if errors is None:
        return [dict(row) for row in rows]
    changed = (dict(row) | apply_errors(row, errors) for row in rows)
    return [row | recommend(row) if row.get("local", "{}") != "{}" else row for row in changed]


def withhold_friction(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Withhold the friction and the spins of local estimates, as of bodies that glide."""
    columns = [f"{name}_local{ending}" for name in UNSEEN_ON_AIR for ending in ("", "_std")]
    out = []
    for row in rows:
        raw = json.loads(row.get("local", "{}"))
        if "unseen" in raw:
            raw["unseen"] = sorted({*raw["unseen"], *UNSEEN_ON_AIR})
            row = {**row, **dict.fromkeys(columns, np.nan), "local": json.dumps(raw, separators=(",", ":"))}
        out.append(dict(row))
    return out
