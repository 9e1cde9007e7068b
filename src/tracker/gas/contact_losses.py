"""What single contacts take of the energy of translation: by the paths of their balls, or by their kicks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from synthcam_shared.arrays import Array, Flags
from tracker.gas.free_paths import FreePath
from tracker.gas.velocities import HalfVelocities


def measure_energies(velocities: HalfVelocities, noise: float) -> tuple[Array, Array]:
    """Measure the energies of the balls per unit mass (m^2/s^2), and their variances; noise: of a coordinate, m."""
    square, variance = velocities.square(noise)
    return square / 2, variance / 4


def measure_end_energies(path: FreePath, noise: float) -> tuple[Array, Array]:
    """Measure the energies of a ball at the start and at the end of a free path (2,), and their variances."""
    value, variance = measure_energies(path.velocities.take(slice(-2, None)), noise)
    return value, variance + 2 * np.maximum(value, 0) * path.unsure_in_all[-2:] ** 2


def predict_losses(contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float) -> tuple[Array, Array, Array]:
    """Predict the energy that each contact takes, by its kick K and the velocities before it.

    Along the line of centres two balls lose K^2 (1 - r)/(1 + r). The median of all K/v_n of the film gives r. Across it
    they keep the share s of their relative speed v_t and lose (1 - s^2) v_t^2/4. The kick of a wall is the whole change
    of a velocity, and its energy needs no r.

    Returns the values (n,), the variances (n,) of what each contact has for itself, and effects (n, 2). These are the
    effects of one standard error of r and of s, which all contacts share. Values are NaN for a table without kicks.
    """
    least = 5  # contacts with a known r
    lost, variance = np.full((2, len(contacts)), np.nan)
    common = np.zeros((len(contacts), 2))
    if "kick" not in contacts or not len(contacts):
        return lost, variance, common
    kick, kick_std = (contacts[name].to_numpy(dtype=np.float64) for name in ("kick", "kick_std"))
    wall = contacts["particle2"].to_numpy() < 0
    along, across, both = find_approaches(contacts, paths, noise)
    lost[wall] = (kick * (along - kick / 2))[wall]
    errors = [(along - kick) * kick_std, across * kick_std, kick * both]
    variance[wall] = sum(error**2 for error in errors)[wall]
    seen = ~wall & (both < 0.1 * along)
    if seen.sum() >= least:
        each, (keep, keep_error) = 2 * kick[seen] / along[seen] - 1, _find_kept_share(contacts, least)
        r = float(np.clip(np.median(each), 0.0, 1.0))
        r_error = 1.86 * float(np.median(np.abs(each - r))) / np.sqrt(seen.sum()) + 0.01  # 1.86: of a median
        share, square = (1 - r) / (1 + r), np.maximum(across**2 - both**2, 0)
        errors = [2 * share * kick * kick_std, (1 - keep**2) / 2 * np.abs(across) * both]
        effects = np.stack([2 / (1 + r) ** 2 * kick**2 * r_error, keep * keep_error / 2 * square], axis=1)
        lost[~wall] = (share * kick**2 + (1 - keep**2) * square / 4)[~wall]
        variance[~wall] = sum(error**2 for error in errors)[~wall]
        common[~wall] = effects[~wall]
    return lost, variance, common


def find_approaches(contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float) -> tuple[Array, Array, Array]:
    """Relative velocities before contacts, along and across the line of centres, and their errors; NaN if unknown."""
    balls, normal = contacts[["particle1", "particle2"]].to_numpy(), contacts[["nx", "ny"]].to_numpy(dtype=np.float64)
    wall = balls[:, 1] < 0
    before, spread = np.full((len(contacts), 2, 2), np.nan), np.full((len(contacts), 2), np.nan)
    before[wall, 1] = spread[wall, 1] = 0.0
    for path in paths:
        if path.end >= 0:
            last, which = path.velocities.take(slice(-1, None)), int(balls[path.end, 0] != path.ball)
            before[path.end, which] = (last.even[0] + last.odd[0]) / 2
            gain = last.gain_even[0] + last.gain_odd[0] + 2 * last.gain_common[0]
            spread[path.end, which] = noise**2 * gain / 4 + path.unsure_in_all[-1] ** 2
    approach = before[:, 1] - before[:, 0]
    along, across = (approach * normal).sum(axis=1), approach[:, 0] * normal[:, 1] - approach[:, 1] * normal[:, 0]
    return along, across, np.sqrt(spread.sum(axis=1))


def expect_losses(
    contacts: pd.DataFrame, taken: Array, variance: Array, across: Array, is_wall: Flags
) -> tuple[Array, Array]:
    """The losses (n,) that kicks and tangential velocities let expect, as in the contacts of the film that show theirs.

    The squares of the kick and of the tangential velocity, and their product, each cost a share of themselves. It is
    the same for all contacts of balls, or with walls. Surfaces that slide on one another lose the product. The errors
    (n,) are the scatter of contacts about that. Shares follow from relative losses: no large loss alone decides.
    """
    least = 10  # contacts that show their losses
    kick = contacts["kick"].to_numpy(dtype=np.float64)
    slip = np.abs(np.where(np.isfinite(across), across, kick))
    terms = np.stack([kick**2, slip**2, kick * slip], axis=1)
    total = terms.sum(axis=1)
    expected, std = np.full((2, len(contacts)), np.nan)
    for kind in (is_wall, ~is_wall):
        known = kind & np.isfinite(taken)
        if known.sum() < least:
            continue
        scatter = 0.1  # over the sum of the terms
        for _ in range(3):  # each without those that another contact disturbs
            weight = 1 / np.sqrt((scatter * total[known]) ** 2 + variance[known])
            share = nnls(terms[known] * weight[:, None], taken[known] * weight)[0]
            away = taken - terms @ share
            scatter = float(np.median(np.abs(away[known] / total[known]))) / 0.67449
            known = kind & (np.abs(away) < 4 * np.hypot(scatter * total, np.sqrt(variance)))
        expected[kind], std[kind] = terms[kind] @ share, scatter * total[kind]
    return expected, std


def _find_kept_share(contacts: pd.DataFrame, least: int) -> tuple[float, float]:
    """The share s of a relative speed that bodies keep, and its error, by the contacts that show their friction.

    With fewer than `least` it lies between 1, of smooth bodies, and that of balls that stick to one another, 5/7.
    """
    max_error, columns = 0.15, ["mu_bb", "mu_bb_std", "r", "v_n", "v_t"]
    if set(columns) <= set(contacts):
        friction, std, r, along, across = contacts[columns].to_numpy(dtype=np.float64).T
        with np.errstate(divide="ignore", invalid="ignore"):
            lever = (1 + r) * along / across
        known = (std * lever < max_error) & ~contacts["misfit"].to_numpy(dtype=bool)
        if known.sum() >= least:
            each = 1 - (friction * lever)[known]
            keep = float(np.median(each))
            error = 1.86 * float(np.median(np.abs(each - keep))) / np.sqrt(known.sum()) + 0.02
            return float(np.clip(keep, 0.0, 1.0)), error
    return 6 / 7, 1 / 7


def lies_inside(contacts: pd.DataFrame) -> Flags:
    """Decide which contacts lie inside the hull of all by more than 2 % of its smallest width."""
    out = np.zeros(len(contacts), dtype=bool)
    if "x" not in contacts:
        return out
    place = contacts[["x", "y"]].to_numpy(dtype=np.float64)
    known = np.isfinite(place).all(axis=1)
    place = place[known]
    if len(place) < 4 or np.linalg.matrix_rank(place - place.mean(axis=0), tol=1e-9) < 2:  # all on one line
        return out
    hull = ConvexHull(place)
    depth = -(place @ hull.equations[:, :2].T + hull.equations[:, 2])
    out[known] = depth.min(axis=1) > 0.02 * depth.max(axis=0).min()
    return out


def measure_contact_losses(
    contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float, frame_s: float = 0.0
) -> tuple[Array, Array, Array]:
    """Energy that both balls lose in each contact (n,), its variance, and the effects (n, 2) of errors that all share.

    Contacts with an energy_lost and no misfit keep it. Others have the difference of the free paths, continued to the
    contact, if both are known, or what their kick predicts. The loss is NaN where it is not known,
    and at

    - a kink inside the hull of all contacts: a hit of a ball that was not found;
    - a wall that would take more than its kick K allows, K^2/2;
    - a wall next to another contact of the ball: the kick is not the wall's alone.

    frame_s: duration of a frame, s.
    """
    balls = contacts[["particle1", "particle2"]].to_numpy()
    value, variance = np.full((len(contacts), 2, 2), np.nan), np.full((len(contacts), 2, 2), np.nan)
    value[balls[:, 1] < 0, 1] = variance[balls[:, 1] < 0, 1] = 0.0
    for path in paths:
        own, error = measure_end_energies(path, noise)
        for row, after, k in ((path.start, 1, 0), (path.end, 0, 1)):
            if row >= 0:
                which = int(balls[row, 0] != path.ball)
                value[row, which, after], variance[row, which, after] = own[k], error[k]
    lost, spread = (value[:, :, 0] - value[:, :, 1]).sum(axis=1), variance.sum(axis=(1, 2))
    predicted, error, common = predict_losses(contacts, paths, noise)
    better = np.isfinite(predicted) & ~(spread < error + (common**2).sum(axis=1))
    lost[better], spread[better] = predicted[better], error[better]
    given = find_measured(contacts)
    lost[given] = contacts["energy_lost"][given]
    spread[given] = contacts["energy_lost_std"][given] ** 2
    common[given | ~better] = 0.0
    unlike_wall = lies_inside(contacts) | _is_mixed(contacts, frame_s)
    if "kick" in contacts:
        most, errors = contacts["kick"].to_numpy(dtype=np.float64) ** 2 / 2, 3 * np.sqrt(spread)
        unlike_wall |= (lost > most + errors) | (lost < -errors)
    lost[(balls[:, 1] < 0) & unlike_wall] = np.nan
    return lost, spread, common


def find_measured(contacts: pd.DataFrame) -> Flags:
    """Decide which contacts have a loss by their local estimate."""
    known = np.isfinite(contacts["energy_lost"]) & np.isfinite(contacts["energy_lost_std"]) & ~contacts["misfit"]
    return np.asarray(known, dtype=bool)


def _is_mixed(contacts: pd.DataFrame, frame_s: float) -> Flags:
    """Decide which contacts are so near another one of the same ball that the kicks of both are one kink."""
    out, time = np.zeros(len(contacts), dtype=bool), contacts["t_s"].to_numpy(dtype=np.float64)
    balls = contacts[["particle1", "particle2"]].to_numpy()
    for ball in np.unique(balls[balls >= 0]):
        own = np.flatnonzero((balls == ball).any(axis=1))
        own = own[np.argsort(time[own], kind="stable")]
        near = np.diff(time[own]) < 2.0 * frame_s  # after more, the path between them shows
        out[own[1:][near]] = out[own[:-1][near]] = True
    return out
