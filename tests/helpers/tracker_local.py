"""Rows of local estimates, drawn with known errors."""

import json
from dataclasses import replace

import numpy as np

from tracker.measurement.local.local_columns import make_local_columns
from tracker.measurement.local.local_estimate import LOCAL_NAMES, VELOCITIES, LocalEstimate

AT = {name: k for k, name in enumerate(LOCAL_NAMES)}


def draw_rows(
    hits, error_n, error_t, bias, seed=0, residual=0.002, shared=(), settings=None, adequate=0.5, allowed=0.0
):
    """Rows of head-on hits with r = 0.8, whose velocities have errors in proportion to the speed.

    allowed: m/s, error of each velocity that what is known of the motions allows for, and that none of them has.
    """
    rng, rows = np.random.default_rng(seed), []
    for _ in range(hits):
        v0 = rng.uniform(0.5, 2.0)
        off = rng.normal(0, 1, (3, 2)) * [error_n, error_t] * v0 + rng.normal(0, residual, (3, 2))
        (v2i, v1o, v2o) = off + np.array([[v0, 0], [0.9 * v0, 0], [0.1 * v0, 0]])
        v1o = v1o + bias * v0 * np.array([1, 0])
        response = np.zeros((len(LOCAL_NAMES), 9))
        response[AT["balance_n"], [2, 4, 6]] = -1, 1, 1
        response[AT["balance_t"], [3, 5, 7]] = -1, 1, 1
        for k, name in enumerate(VELOCITIES[2:], 2):  # the normal is x
            response[AT[name], k] = 1.0
        closing = v2i[0]
        response[AT["v0"], 2] = 1.0
        response[AT["r"], [2, 4, 6]] = np.array([-(v1o[0] - v2o[0]) / closing, 1, -1]) / closing
        response[AT["mass_ratio"], [2, 4, 6]] = np.array([1, -(v2i[0] - v2o[0]) / v1o[0], -1]) / v1o[0]
        value = np.full(len(LOCAL_NAMES), np.nan)
        balance = v1o + v2o - v2i
        for name, v in (("v0", v0), ("r", (v1o[0] - v2o[0]) / closing), ("mass_ratio", (v2i[0] - v2o[0]) / v1o[0])):
            value[AT[name]] = v
        value[AT["balance_n"]], value[AT["balance_t"]] = balance
        unit = np.nan_to_num(response @ response.T)
        cov, known = unit * (residual**2 + allowed**2), unit * allowed**2
        estimate = LocalEstimate(value, cov, response, v0, 10.0, 10.0, adequate, True, frozenset(), True)
        if allowed:
            estimate = replace(estimate, cov_of_known=known)
        for key, name, share in shared:  # an error of the camera file that changes a quantity by this share
            effect = np.eye(len(value))[AT[name]] * share * value[AT[name]]
            wider = estimate.cov + np.outer(effect, effect)
            estimate = replace(estimate, cov=wider, shared=estimate.shared | {key: (1.0, effect)})
        rows.append({"status": "misfit"} | make_local_columns(estimate, settings=settings))
    return rows


def draw_unequal_rows(heavier, hits=60, **more):
    """Rows of two bodies that strike each other in turn; heavier: logarithm of the mass of body 7 over that of 9.

    The balance by equal masses is off by the kick times tanh of half of it.
    """
    rows = draw_rows(hits, 0.003, 0.003, 0.0, **more)
    for k, row in enumerate(rows):
        role = 1 if k % 2 else -1
        raw = json.loads(row["local"])
        for name, change in (("balance_n", 0.9 * raw["v0"]),):
            raw["response"][AT[name]][8] = change
            raw["value"][AT[name]] -= role * 2 * np.tanh(heavier / 2) * change
        row |= {"particle1": 7 if role > 0 else 9, "particle2": 9 if role > 0 else 7, "local": json.dumps(raw)}
    return rows
