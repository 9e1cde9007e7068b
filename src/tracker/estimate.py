"""From the tracks of one clip to its physics: r, mu_k, C, slide times, energy, momentum, with honest errors.

Three readings stand beside each other: NAME from the tied fit (one physical model of impact, sliding and rolling),
NAME_free from the free fit (any velocities and slide times after the hit), NAME_paper from the paper's finite
differences. Where the first two disagree the model is wrong. What a clip cannot tell is NaN.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import paper
from .encounter import Encounter, Meeting, Past, encounter, first_guess, meetings
from .fitting import COARSE, Fit, Pair, fit_motion
from .kinetics import motion_table
from .motion import AFTER, FREE, TARGET, TIED, release
from .places import Course, courses
from .pooled import fit_all
from .quantities import NAMES, Values, of_free, of_tied
from .single import PARAMETERS, roll_alone

if TYPE_CHECKING:
    from .geometry import Camera
    from .link import Tracks

__all__ = ["fit_all", "interpret", "measure", "motion_table", "told"]

Floats = NDArray[np.float64]

SEEN = 25.0  # chi^2 by which the end of a slide must beat a slide without end: five standard errors
TELLING = 0.2  # a relative error above this, and first-order errors no longer describe the estimate
# quantities whose size may be zero have limits of their own, in their own units
LIMITS = {"b": 0.05, "t_c": np.inf, "s": 0.1, "r": 0.05, "C": 0.05, "final_angle": 0.1}
LIMITS |= {"energy_fraction": 0.05, "momentum_fraction": 0.05, "drag": 2.0, "decel": 0.2}
FREE_LIMITS = LIMITS | {"r": 0.02}
NEEDS = {  # what falls with a slide end that the clip does not show, by ball
    1: ("tau1", "v1f", "w1n", "w1t"),
    2: ("tau2", "v2f", "w2n", "w2t"),
}
NEEDS_START = ("r", "s", "mu_k", "C")  # what falls with a slide too short to show the velocity just after the hit
NEEDS_BOTH = ("energy_fraction", "momentum_fraction", "final_angle")
UNLIKELY = 10.0  # standard deviations of chi^2 beyond which a lone ball was not rolling freely
NO_DIAMETER = "no ball_diameter in the camera file: a collision is measured by where balls of that diameter touch"
POOR_FIT = 1e4  # chi^2 per degree of freedom: 100 sigma off everywhere is no description of the motion


@dataclass(frozen=True)
class Reading:
    """Both fits of one collision and what they say."""

    meeting: Encounter
    tied: Fit
    free: Fit
    slides_seen: tuple[bool, bool]
    of_tied: Values
    of_free: Values


def measure(tracks: Tracks, camera: Camera) -> list[dict[str, Any]]:
    """One row per collision of a clip, in the columns of estimates.parquet without `clip`; never empty.

    SI units. status: "ok", "no_collision" (then v0, drag and decel of the ball that rolls), or the reason
    why nothing can be told.
    """
    if not camera.metric:
        return [_row(camera, 0, "no scale: lengths need a camera file")]
    balls = courses(tracks, camera)
    if not any(len(course) >= 2 for course in balls):
        return [_row(camera, 0, "too few detections")]
    noise = _noise(balls[0], camera)
    if len(balls) > 1 and not camera.knows_diameter:
        return [_row(camera, 0, NO_DIAMETER) | _noise(balls[0], camera)]
    met = meetings(balls, camera.ball_diameter) if len(balls) > 1 else []
    if not met:
        return [_row(camera, 0, "no_collision") | noise | _alone(balls)]
    rows, pasts = [], dict[int, Past]()
    for i, meeting in enumerate(met):
        row, left = _collision(meeting, pasts, camera, i)
        rows.append(row | noise)
        pasts |= left
    return rows


def _noise(course: Course, camera: Camera) -> dict[str, Any]:
    """Where the places' errors come from: the table, or (then with their size, px) the tracks' own scatter."""
    if course.weighed:
        return {}
    return {"noise": "scatter", "noise_px": float(np.sqrt(np.trace(course.cov[0]) / 2) / camera.scale)}


def _collision(
    meeting: Meeting, pasts: dict[int, Past], camera: Camera, index: int
) -> tuple[dict[str, Any], dict[int, Past]]:
    """The row of one collision, and what it leaves of its balls."""
    met = encounter(meeting, camera.ball_diameter, pasts)
    row = _row(camera, index, met.reason or "ok")
    row |= {f"particle{i}": course.particle for i, course in met.pair.balls}
    unknown = {course.particle: Past(np.inf) for _, course in met.pair.balls}
    if met.reason:
        return row, unknown
    read = interpret(met)
    if isinstance(read, str):
        return row | {"status": read}, unknown
    tied, free = told(read)
    readings = paper.read(met, camera.fps)
    for i, name in enumerate(NAMES):
        row[name], row[f"{name}_std"] = tied.value[i], tied.std[i]
        row[f"{name}_free"], row[f"{name}_free_std"] = free.value[i], free.std[i]
        row[f"{name}_paper"], row[f"{name}_paper_std"] = readings[name]
    row["cov"] = _as_json({"tied": read.of_tied.cov, "free": read.of_free.cov})
    at = [TIED.index(name) for name in ("heading", "x", "y", *TARGET)]
    row |= dict(zip(("heading", "x1", "y1", "v1ix", "v1iy"), read.tied.parameters[at].tolist(), strict=True))
    for suffix, fit in (("", read.tied), ("_free", read.free)):
        row |= {f"chi2{suffix}": fit.chi2, f"dof{suffix}": fit.dof, f"dropped{suffix}": fit.dropped}
    return row, _left(read, pasts)


def _left(read: Reading, pasts: dict[int, Past]) -> dict[int, Past]:
    """What the balls carry on: they slide to the later of both fits' ends, and the hit's rub has turned them."""
    pair, tied = read.meeting.pair, read.tied.parameters
    ends = [FREE.index(name) for name in ("log_tau1", "log_tau2")]
    both = (np.asarray(release(tied, pair.spin), dtype=np.float64), read.free.parameters)
    late = np.max([free[0] + np.exp(free[ends]) for free in both], axis=0)
    beta, v0, c = (tied[TIED.index(name)] for name in ("beta", "v0", "C"))
    turn = -c * (v0 * np.sin(beta) + pair.spin)  # R dw = (5/2) n x J/m, the same for both
    particles = [course.particle for _, course in pair.balls]
    return {
        p: Past(float(end), pasts.get(p, Past()).spin + float(turn)) for p, end in zip(particles, late, strict=True)
    }


def interpret(meeting: Encounter) -> Reading | str:
    """Tied and free fit of one collision; or the reason why there is none."""
    guess = first_guess(meeting)
    if guess is None:
        return "the approach does not lead to the other ball"
    pair = meeting.pair
    tied = fit_motion(pair, True, [guess])
    free, seen = _free(pair, tied)
    if tied.chi2 > free.chi2 + 50:  # the free fit has no impact to get wrong: let it lead
        again = fit_motion(pair, True, [_tied_from(free, pair.diameter)])
        if again.chi2 < tied.chi2:
            tied = again
            free, seen = _free(pair, tied)
    if not tied.converged:
        return "the fit did not converge"
    if tied.chi2 > POOR_FIT * tied.dof:
        return "no collision of two rolling balls fits the tracks"
    return Reading(
        meeting, tied, free, seen,
        of_tied(tied.parameters, tied.cov, pair.diameter, pair.spin), of_free(free.parameters, free.cov, pair.diameter),
    )  # fmt: skip


def _free(pair: Pair, tied: Fit) -> tuple[Fit, tuple[bool, bool]]:
    """The free fit, and for each ball whether its slide's end shows.

    Short slides have several minima: other slide times are tried. One without end is the null hypothesis.
    """
    start = np.asarray(release(tied.parameters, pair.spin), dtype=np.float64)
    ends = [FREE.index(name) for name in ("log_tau1", "log_tau2")]
    starts = [start]
    for shift in (-0.5, 0.5):
        other = start.copy()
        other[ends] += shift
        starts.append(other)
    best = fit_motion(pair, False, starts)
    seen = [True, True]
    for i, (end, (_, course)) in enumerate(zip(ends, pair.balls, strict=True)):
        left = course.start[-1] + course.exposure - best.parameters[0]
        if np.exp(best.parameters[end]) > left:
            seen[i] = False
        elif np.exp(best.parameters[end]) > 0.5 * left:
            endless = _endless(best.parameters, 1 + i, left)
            without = fit_motion(pair, False, [endless], COARSE)
            if without.chi2 < best.chi2:
                best = without = fit_motion(pair, False, [without.parameters])
            seen[i] = without.chi2 - best.chi2 > SEEN and bool(np.exp(best.parameters[end]) < left)
    return best, (seen[0], seen[1])


def _endless(free: Floats, ball: int, left: float) -> Floats:
    """The same start of a slide, but one that goes on after the ball is last seen."""
    out, at = free.copy(), AFTER[ball]
    tau, longer = np.exp(free[at + 4]), 1.5 * left
    out[at + 2 : at + 4] = free[at : at + 2] + (free[at + 2 : at + 4] - free[at : at + 2]) * longer / tau
    out[at + 4] = np.log(longer)
    return out


def _tied_from(free: Fit, diameter: float) -> Floats:
    """Tied parameters nearest to a free motion: its launch, and the r, mu_k and C it implies."""
    said = dict(zip(NAMES, of_free(free.parameters, free.cov, diameter).value, strict=True))
    impact = [np.clip(said["r"], 0, 1), np.log(np.clip(said["mu_k"], 1e-3, 10)), np.clip(said["C"], -0.5, 1)]
    return np.concatenate([free.parameters[:8], impact, free.parameters[-len(TARGET) :]])


def told(read: Reading) -> tuple[Values, Values]:
    """What each fit claims: NaN where the clip cannot tell."""
    # without an end in view, slide time and final velocity trade freely: no minimum, and none is needed
    if all(read.slides_seen) and not read.free.converged:
        return _claimed(read.of_tied, LIMITS, set()), _claimed(read.of_free, FREE_LIMITS, set(NAMES))
    free_nan = {name for ball, seen in enumerate(read.slides_seen, 1) if not seen for name in NEEDS[ball]}
    if not all(read.slides_seen):
        free_nan |= {*NEEDS_BOTH, "mu_k", "C"}
    for ball, name in ((1, "log_tau1"), (2, "log_tau2")):
        k = FREE.index(name)
        if read.slides_seen[ball - 1] and read.free.cov[k, k] > TELLING**2:  # too short to show how it began
            free_nan |= {*NEEDS_START, f"w{ball}n", f"w{ball}t"}
    if not _bent(read.of_free.value, read.of_free.std):
        free_nan |= {"s"}
    return _claimed(read.of_tied, LIMITS, set()), _claimed(read.of_free, FREE_LIMITS, free_nan)


def _bent(value: Floats, std: Floats) -> bool:
    """Whether the hit is oblique enough for a tangential restitution, a ratio by b, to have a meaning."""
    b = NAMES.index("b")
    return bool(abs(value[b]) > 10 * std[b])


def _claimed(values: Values, limits: dict[str, float], unseen: set[str]) -> Values:
    value, cov = values.value.copy(), values.cov.copy()
    lost = []
    for i, name in enumerate(NAMES):
        std = values.std[i]
        limit = limits.get(name, TELLING * abs(value[i]) if not name.startswith("w") else np.inf)
        folded = name == "final_angle" and value[i] < 3 * std  # an angle cannot be negative: near zero it is biased
        if name in unseen or not np.isfinite(value[i]) or not std <= limit or folded:
            lost.append(i)
    value[lost] = np.nan
    cov[lost, :] = np.nan
    cov[:, lost] = np.nan
    return Values(value, cov)


def _alone(balls: list[Course]) -> dict[str, Any]:
    """What a rolling ball tells without a collision: its speed when first seen, drag and decel."""
    fits = [f for f in map(roll_alone, balls) if f is not None]
    if not fits:
        return {}
    best = max(fits, key=lambda f: f.speed)
    if best.chi2 > best.dof + UNLIKELY * np.sqrt(2 * best.dof):
        return {"status": "no collision in view, and no ball rolls freely", "chi2": best.chi2, "dof": best.dof}
    out: dict[str, Any] = {"particle2": best.particle, "chi2": best.chi2, "dof": best.dof}
    for name, value, std in best.table():
        told_it = std <= LIMITS.get(name, np.inf)
        out[name], out[f"{name}_std"] = (value, std) if told_it else (np.nan, np.nan)
    out["cov"] = _as_json({"rolling": best.cov[-3:, -3:]}, PARAMETERS[-3:])
    return out


def _row(camera: Camera, index: int, status: str) -> dict[str, Any]:
    row: dict[str, Any] = {"collision": index, "striker": camera.striker, "status": status}
    for name in NAMES:
        for kind in ("", "_free", "_paper"):
            row[f"{name}{kind}"] = row[f"{name}{kind}_std"] = np.nan
    row |= {"cov": "{}", "particle1": -1, "particle2": -1, "heading": np.nan, "x1": np.nan, "y1": np.nan}
    row |= {"v1ix": np.nan, "v1iy": np.nan, "noise": "given", "noise_px": np.nan}
    for suffix in ("", "_free"):
        row |= {f"chi2{suffix}": np.nan, f"dof{suffix}": 0, f"dropped{suffix}": 0}
    return row


def _as_json(blocks: dict[str, Floats], names: tuple[str, ...] = NAMES) -> str:
    """Covariances by fit, in the order of `names`; seven digits, which keeps them positive definite enough."""
    out: dict[str, Any] = {"names": list(names)}
    for fit, cov in blocks.items():
        out[fit] = [[float(f"{v:.7g}") if np.isfinite(v) else None for v in line] for line in cov]
    return json.dumps(out, separators=(",", ":"))
