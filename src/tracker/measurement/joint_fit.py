"""All clips together: the paper's chi^2 for r, mu_k and C, and how much the clips differ among themselves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from synthcam_shared.arrays import Array
from tracker.measurement.camera_errors import covariance_of_shared, remove_shared, shared_effects
from tracker.measurement.collision.collision_model import GRAVITY, SLIP_RATE
from tracker.measurement.collision.least_squares import covariance
from tracker.measurement.random_effects import fit_random_effects

SHARED = ("r", "mu_k", "C")
OBSERVED = ("v1f", "v2f", "tau1", "tau2")
ROLLING = ("drag", "decel")
MIN_EIGENVALUE = 1e-12  # of a correlation matrix that is positive definite beyond rounding


def fit_all_jointly(estimates: pd.DataFrame) -> dict[str, Any]:
    """Fit all clips of estimates.parquet by one joint fit: the contents of fit.json.

    It leaves out misfits, and tied fits that the local estimate contradicts. A clip whose covariance is not positive
    definite is left out of the sums that need it.

    - chi2: r, mu_k and C that minimise the paper's chi^2, given v0 and any b. It is that of v1f, v2f, tau1 and tau2 of
      the free fits. Errors follow from its curvature, times sqrt(chi2/dof) where that exceeds one.
    - scatter: the weighted mean of the tied fits, and the standard deviation between clips beyond their own errors.
    - rolling: drag and decel together, because one clip determines their sum far better than either. Clips without a
      collision count here too.
    - shared_std: the part of an error that comes from the errors of the camera file. More clips of one camera do not
      lessen it.
    """
    ok = estimates[estimates["status"] == "ok"] if len(estimates) else estimates
    if "recommended" in ok:
        ok = ok[ok["recommended"] == "tied"]
    roll = estimates[estimates["status"].isin(["ok", "no_collision"])] if len(estimates) else estimates
    scatter = {name: _mean_and_scatter(ok, name) for name in SHARED}
    scatter |= {name: _mean_and_scatter(roll, name) for name in ROLLING}
    return {"clips": len(ok), "chi2": _paper_chi2(ok), "scatter": scatter, "rolling": _rolling(roll)}


def predict_quantities(v0: Array, b: Array, shared: Array) -> Array:
    """Predict v1f, v2f, tau1, tau2, (n, 4), for the joint fit, from v0 and b/2R (n,); shared = (r, mu_k, C).

    These are the paper's F, G, H, I (eqs 1-4) for any b. The normal part is scaled by sqrt(1 - b^2), and the tangential
    part passes on 0.4 C of itself.
    """
    r, mu, c = shared
    normal, tangent = v0 * np.sqrt(1 - b**2), v0 * b
    u1, u2 = ((1 + r) / 2 + c) * normal, ((1 + r) / 2 - c) * normal
    rub = 0.4 * c * tangent
    v1f = np.hypot((1 + r) / 2 * normal - 2 * u1 / 7, rub * 5 / 7)
    v2f = np.hypot((1 - r) / 2 * normal + 2 * u2 / 7, tangent - rub * 5 / 7)
    rate = SLIP_RATE * mu * GRAVITY
    return np.column_stack([v1f, v2f, np.hypot(u1, rub) / rate, np.hypot(u2, rub) / rate])


def _paper_chi2(ok: pd.DataFrame) -> dict[str, Any]:
    given = ("v0", "b")
    names = (*OBSERVED, *given)
    columns = [f"{name}_free{end}" for name in names for end in ("", "_std")]
    rows = ok.dropna(subset=columns) if set(columns) <= set(ok.columns) else ok.iloc[:0]
    covs = []
    for _, row in rows.iterrows():
        cov = _read_covariance(row, names, "free")
        diagonal = np.diag([float(row[f"{name}_free_std"]) ** 2 for name in names])  # where the row has no matrix
        covs.append(cov if cov is not None and _positive(cov) else diagonal)
    good = np.array([_positive(cov) for cov in covs], dtype=bool)
    if not good.any():
        return dict.fromkeys([*SHARED, *(f"{name}_std" for name in SHARED), "chi2"]) | {"dof": 0}
    rows = rows[good]
    seen = np.column_stack([rows[f"{n}_free"] for n in OBSERVED]).astype(float)
    v0, b = (rows[f"{n}_free"].to_numpy(float) for n in given)
    steepest = 0.9999  # |b/2R|: the formulas need its neighbourhood
    b = np.clip(b, -steepest, steepest)
    common = shared_effects(rows, names, "free")  # what each shared error adds to seen, v0 and b
    weights = np.stack(covs)[good] - covariance_of_shared(common)
    start = np.append([0.8, 0.2, 0.2], np.zeros(common.shape[2]))
    for _ in range(3):  # the errors of v0 and b count too, and how much depends on r, mu_k, C
        whiten = _whiten(weights, v0, b, start[:3])

        def residual(p: Array, whiten: Array = whiten) -> Array:
            off = common @ p[3:]
            model = predict_quantities(v0 - off[:, 4], np.clip(b - off[:, 5], -steepest, steepest), p[:3])
            return np.append(np.matmul(whiten, (model - seen + off[:, :4])[..., None]).ravel(), p[3:])

        found = least_squares(residual, start, method="lm", x_scale="jac")
        start = np.asarray(found.x, dtype=np.float64)
    dof, chi2, slope = seen.size - 3, float(2 * found.cost), np.asarray(found.jac)
    own = np.diag(covariance(slope[: seen.size, :3]))
    together = np.diag(covariance(slope))[:3] - own
    std = np.sqrt(own * max(1.0, chi2 / max(dof, 1)) + together)
    values = {name: float(v) for name, v in zip(SHARED, start[:3], strict=True)}
    errors = {f"{name}_std": float(s) for name, s in zip(SHARED, std, strict=True)}
    part = dict(zip(SHARED, map(_root, together), strict=True))
    return {**values, **errors, "chi2": chi2, "dof": dof} | ({"shared_std": part} if common.size else {})


def _root(square: float) -> float:
    return float(np.sqrt(max(square, 0.0)))


def _read_covariance(row: pd.Series, names: Sequence[str], *fits: str) -> Array | None:
    """Covariance of these quantities in one clip, from the first of `fits` that its column `cov` has."""
    table = json.loads(row["cov"]) if isinstance(row.get("cov"), str) else {}
    block = next((table[fit] for fit in fits if fit in table), None)
    if block is None:
        return None
    pick = [table["names"].index(name) for name in names]
    return np.array(block, dtype=np.float64)[np.ix_(pick, pick)]


def _positive(cov: Array) -> bool:
    """Test whether a matrix is positive definite beyond rounding."""
    if not np.isfinite(cov).all() or not (np.diag(cov) > 0).all():
        return False
    size = np.sqrt(np.diag(cov))
    return bool(np.linalg.eigvalsh(cov / np.outer(size, size))[0] > MIN_EIGENVALUE)


def _whiten(covs: Array, v0: Array, b: Array, shared: Array) -> Array:
    """(n, 4, 4) that turn seen - predicted into units of its own error, that of v0 and b included."""
    n = len(v0)
    slope = np.zeros((n, 4, 6))
    slope[:, range(4), range(4)] = 1.0
    for column, (dv, db) in enumerate(((1e-6, 0.0), (0.0, 1e-6)), start=4):
        more, less = predict_quantities(v0 + dv, b + db, shared), predict_quantities(v0 - dv, b - db, shared)
        slope[:, :, column] = -(more - less) / 2e-6
    cov = slope @ covs @ np.swapaxes(slope, 1, 2)
    size, axes = np.linalg.eigh(cov)
    least = np.maximum(size, MIN_EIGENVALUE * size[:, -1:])
    return np.asarray(np.swapaxes(axes, 1, 2) / np.sqrt(least)[..., None])


def _rolling(rows: pd.DataFrame) -> dict[str, Any]:
    """drag and decel of all clips, weighed by the inverse of their joint covariances."""
    common = shared_effects(rows, ROLLING, "tied", "rolling")
    errors = common.shape[2]  # each an unknown of normal size 1 beside drag and decel
    information, pull, n = np.diag([0.0, 0.0, *np.ones(errors)]), np.zeros(2 + errors), 0
    for (_, row), effect in zip(rows.iterrows(), common, strict=True):
        value = np.array([row[name] for name in ROLLING], dtype=np.float64)
        cov = _read_covariance(row, ROLLING, "tied", "rolling")
        if cov is None:
            continue
        cov = cov - covariance_of_shared(effect)
        if np.isfinite(value).all() and _positive(cov):
            design = np.column_stack([np.eye(2), effect])
            weight = design.T @ np.linalg.inv(cov)
            information, pull, n = information + weight @ design, pull + weight @ value, n + 1
    if not n:
        return dict.fromkeys([*ROLLING, *(f"{name}_std" for name in ROLLING)]) | {"n": 0}
    joint = np.linalg.inv(information)
    values = dict(zip(ROLLING, map(float, joint[:2] @ pull), strict=True))
    whole = np.diag(joint)[:2]
    stds = {f"{name}_std": float(s) for name, s in zip(ROLLING, np.sqrt(whole), strict=True)}
    part = dict(zip(ROLLING, map(_root, whole - np.diag(np.linalg.inv(information[:2, :2]))), strict=True))
    return values | stds | {"n": n} | ({"shared_std": part} if errors else {})


def _mean_and_scatter(rows: pd.DataFrame, name: str) -> dict[str, Any]:
    """The random-effects mean over clips, its error, and the scatter between clips beyond their errors."""
    columns = [name, f"{name}_std"]
    kept = rows.dropna(subset=columns) if set(columns) <= set(rows.columns) else rows.iloc[:0]
    if not len(kept):
        return {"mean": None, "std": None, "scatter": None, "n": 0}
    effects = shared_effects(kept, (name,), "tied", "rolling")
    value, std = (kept[column].to_numpy(float) for column in columns)
    fit = fit_random_effects(value, remove_shared(std, effects), effects[:, 0])
    part = {"shared_std": float(fit.shared_std[0])} if effects.shape[2] else {}
    scatter = fit.scatter if fit.dof else 0.0
    return {"mean": float(fit.coefficients[0]), "std": float(fit.std[0]), "scatter": scatter, "n": len(value)} | part
