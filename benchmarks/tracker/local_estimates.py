"""Coverage of the local estimate on simulated hits with known truth, one by one and as sets.

python -m benchmarks.tracker.local_estimates [--hits 200] [--seed 1] [--only KIND] [-o out/local_estimates.json]

Hits are those of six kinds:

- balls: billiard balls of 61.5 mm at 50 frames a second, noise 0.3 mm. The striker slides and then rolls, or slides
  up to the hit, by the textbook in three dimensions. r, the friction between balls, that of the cloth and the loss
  scatter from hit to hit. The friction of the cloth is 0.12 to 0.32, not that of the prior, and so is the loss, 0.02
  to 0.12 m/s^2.
- small balls: the same with 20 mm and 0.2 to 0.7 m/s, at 120 frames a second, noise 0.055 mm.
- discs: pucks of 50 mm on air at 250 frames a second, noise 0.03 mm. Each run has a drag of its own, the rims rub, and
  the masses are unequal and given.
- pucks: discs of 30 mm that slide on a dry plate until they stop. They have 240 frames a second, as in a film of 320 x
  240 with loss. Errors of 0.1 px last over some frames, and those of pucks at rest hardly change. With --claimed the
  tables have a fifth of that, as of a film whose codec repeats what hardly changes.
- dry pucks: the same, and the camera file says that they slide.
- uneven pucks: dry pucks whose friction differs from stretch to stretch as the estimate allows: 20 % along the path,
  10 % across it.

With --warp W the positions are shifted by a smooth map of W m rms over 0.1 m, which no fit knows. With --claimed the
tables have the true errors of positions; without it the errors come from the scatter. With --nearest N the tables have
N positions of each body on either side of the hit, as of a short clip. With --mirrored each hit is measured again with
the opposite errors. The mean of both deviations is the bias, since the noise itself cancels.

For each quantity the table gives the number with an error, the rms of z = error / standard error, and the share within
1 and 1.96 standard errors. It does so by the residuals alone, with the prior of one recording, and with errors fitted
to the set.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.harness import ROOT, save
from benchmarks.real.hits import measure_hit
from benchmarks.real.recordings import RecordedHit
from tracker.measurement.local.local_columns import LocalErrors, apply_errors, calibrate_set

sys.path.insert(0, str(ROOT / "tests" / "helpers"))
billiard: Any = importlib.import_module("tracker_billiard")
Floats = NDArray[np.float64]
QUANTITIES = ("v0", "r", "s", "impact_energy", "energy_fraction", "v1ox", "v1oy", "v2ox", "v2oy")


def draw_balls(
    rng: np.random.Generator, fps: float = 50.0, radius: float = 0.03075, speeds: tuple[float, float] = (1.0, 4.0)
) -> tuple[list[Floats], dict[str, float], dict[str, Any]]:
    """Positions (n, 2) of a resting and a striking ball, the truth, and the camera file."""
    while True:
        p = billiard.Physics(
            r=min(rng.normal(0.96, 0.03), 1.0), mu=rng.uniform(0.12, 0.32), c=rng.uniform(0.02, 0.15),
            drag=0.011, decel=rng.uniform(0.02, 0.12), radius=radius,
        )  # fmt: skip
        v, b, before = rng.uniform(*speeds), rng.uniform(-0.7, 0.7), rng.uniform(0.15, 0.5)
        target = billiard.rolling([0.0, 0.0], [0.0, 0.0], radius)
        striker = billiard.rolling([-v * before - 2 * radius, -2 * radius * b], [v, 0.0], radius)
        striker[2] = striker[2] * rng.choice([0.0, 0.5, 1.0])
        legs, hits = billiard.play([target, striker], before + 0.6, p)
        if len(hits) == 1:
            break
    _, two, one, early, late = hits[0]
    paths = list(billiard.positions(legs, np.arange(int((before + 0.55) * fps)) / fps, p))
    truth = billiard.truth(hits[0], p) | {
        f"v{k + 1}o{a}": late[i][1][j] for k, i in enumerate((one, two)) for j, a in enumerate("xy")
    }
    truth["impact_energy"] = sum(state[1] @ state[1] for state in late) / sum(state[1] @ state[1] for state in early)
    camera = {"size": [2000, 2000], "fps": fps, "scale": 1e-3, "exposure": 0.0, "ball_diameter": 2 * radius}
    return paths, truth, camera


def draw_discs(rng: np.random.Generator) -> tuple[list[Floats], dict[str, float], dict[str, Any]]:
    """Positions (n, 2) of a resting and a striking disc, the truth, and the camera file."""
    fps, masses, v0, b = 250.0, rng.uniform(0.02, 0.04, 2), rng.uniform(0.3, 1.2), rng.uniform(-0.7, 0.7)
    r, rub = rng.normal(0.8 - 0.1 * v0, 0.04), rng.uniform(0.0, 0.25)
    n = np.array([np.sqrt(1 - b**2), b])
    t = np.array([-n[1], n[0]])
    before = np.array([v0, 0.0])
    impulse = masses.prod() / masses.sum() * ((1 + r) * (before @ n) * n + rub * (before @ t) * t)
    after = impulse / masses[0], before - impulse / masses[1]
    losses, time = rng.uniform(0.05, 1.0, 3), np.arange(90) / fps
    since = time - rng.uniform(0.16, 0.18)

    def glide(v: Floats, loss: float) -> Floats:
        way = since - loss * since**2 / (2 * max(float(np.hypot(*v)), 1e-9))
        return np.asarray(way[:, None] * v)

    late = (since > 0)[:, None]
    target = np.where(late, glide(after[0], losses[0]), 0.0)
    striker = -0.05 * n + np.where(late, glide(after[1], losses[1]), glide(before, -losses[2]))
    energy = sum(m * v @ v for m, v in zip(masses, after, strict=True)) / (masses[1] * v0**2)
    truth = {"v0": v0, "r": r, "s": 1 - rub, "impact_energy": energy, "energy_fraction": energy}
    truth |= {f"v{k + 1}o{a}": after[k][j] for k in (0, 1) for j, a in enumerate("xy")}
    camera = {"size": [2000, 2000], "fps": fps, "scale": 1e-3, "exposure": 0.0, "ball_diameter": 0.05}
    return [target, striker], truth, camera | {"ball_masses": masses.tolist()}


def draw_pucks(
    rng: np.random.Generator, scatter: tuple[float, float] = (0.0, 0.0)
) -> tuple[list[Floats], dict[str, float], dict[str, Any]]:
    """Positions (n, 2) of a resting and a striking puck, the truth, and the camera file.

    scatter: of the friction from stretch to stretch, along and across the path, over the common one.
    """
    fps, radius, v0, b = 240.0, 0.015, rng.uniform(0.7, 1.6), rng.uniform(-0.6, 0.6)
    r, rub, friction = rng.normal(0.88, 0.04), rng.uniform(0.0, 0.2), 9.81 * rng.uniform(0.12, 0.2)
    n = np.array([np.sqrt(1 - b**2), b])
    t, before = np.array([-n[1], n[0]]), np.array([v0, 0.0])
    impulse = ((1 + r) * (before @ n) * n + rub * (before @ t) * t) / 2
    after, time = (impulse, before - impulse), np.arange(160) / fps
    since = time - rng.uniform(0.1, 0.2)

    def slide(v: Floats) -> Floats:
        speed = float(np.hypot(*v))
        along, across = np.array([1.0, 0.0]) + (scatter * rng.normal(size=2) if any(scatter) else 0.0)
        pull = -friction / speed * (max(along, 0.3) * v + across * np.array([-v[1], v[0]]))
        late = np.minimum(since, speed**2 / float(-pull @ v))[:, None]
        return np.asarray(late * v + late**2 / 2 * pull)

    late = (since > 0)[:, None]
    paths = np.where(late, slide(after[0]), 0.0), np.where(late, slide(after[1]), slide(before)) - 2 * radius * n
    energy = float(sum(v @ v for v in after)) / v0**2
    truth = {"v0": v0, "r": r, "s": 1 - rub, "impact_energy": energy, "energy_fraction": np.nan}
    truth |= {f"v{k + 1}o{a}": after[k][j] for k in (0, 1) for j, a in enumerate("xy")}
    camera = {"size": [2000, 2000], "fps": fps, "scale": 1.75e-3, "exposure": 0.0, "ball_diameter": 2 * radius}
    return list(paths), truth, camera


def err_like_codec(path: Floats, noise: float, rng: np.random.Generator, lasting: float = 0.7) -> Floats:
    """Errors (n, 2) that last over some frames, of a body that moves; those of one at rest hardly change."""
    fresh = rng.normal(0, noise * np.sqrt(1 - lasting**2), path.shape)
    errors: Floats = fresh / np.sqrt(1 - lasting**2)  # the first lasts as long as the body rests
    moves = np.hypot(*np.diff(path, axis=0, prepend=path[:1]).T) > 1e-6
    for k in range(1, len(path)):
        errors[k] = lasting * errors[k - 1] + fresh[k] if moves[k] else errors[k - 1] + 0.1 * fresh[k]
    return errors


def bend(place: Floats, waves: Floats, size: float) -> Floats:
    """Shift positions by a smooth map of `size` rms, made of a few waves (k, 2, 3) of wave vector and phase."""
    phase = place @ waves[:, 0, :2].T + waves[:, 0, 2]
    shift = np.stack([np.sin(phase).sum(-1), np.cos(phase + waves[:, 1, 2]).sum(-1)], -1)
    return np.asarray(place + size * shift * np.sqrt(2 / len(waves)), dtype=np.float64)


KINDS: dict[str, tuple[Callable[..., tuple[list[Floats], dict[str, float], dict[str, Any]]], float, str]] = {
    "balls": (draw_balls, 3e-4, "cloth"),
    "small balls": (partial(draw_balls, fps=120.0, radius=0.01, speeds=(0.2, 0.7)), 5.5e-5, "cloth"),
    "discs": (draw_discs, 3e-5, "air"),
    "pucks": (draw_pucks, 1.75e-4, ""),
    "dry pucks": (draw_pucks, 1.75e-4, "sliding"),
    "uneven pucks": (partial(draw_pucks, scatter=(0.2, 0.1)), 1.75e-4, "sliding"),
}


def measure_kind(
    kind: str, hits: int, seed: int, warp: float, claimed: bool = False, sign: float = 1.0, nearest: int = 0
) -> list[dict[str, Any]]:
    """Measure hits of one kind: their rows with the truth as NAME_true."""
    return [measure_one(kind, k, seed, warp, claimed, sign, nearest) for k in range(hits)]


def draw_one(
    kind: str, k: int, seed: int, warp: float = 0.0, claimed: bool = False, sign: float = 1.0
) -> tuple[RecordedHit, dict[str, float]]:
    """Draw the hit of a number, with its truth; sign: of the errors of positions."""
    draw, noise, _ = KINDS[kind]
    waves, rng = np.random.default_rng(seed).normal(0, 10.0, (8, 2, 3)), np.random.default_rng([seed, k])
    paths, truth, camera = draw(rng)
    parts, origin = [], rng.uniform(-0.5, 0.5, 2)
    for ball, path in enumerate(paths):
        errors = err_like_codec(path, noise, rng) if "pucks" in kind else rng.normal(0, noise, path.shape)
        x, y = (bend(path + origin, waves, warp) + sign * errors).T
        part = pd.DataFrame({"frame": np.arange(len(path)), "particle": ball, "x": x, "y": y})
        said = noise / 5 if "pucks" in kind else noise
        parts.append(part.assign(x_std=said, y_std=said) if claimed else part)
    return RecordedHit(f"{kind} {k}", pd.concat(parts, ignore_index=True), camera), truth


def measure_one(
    kind: str, k: int, seed: int, warp: float, claimed: bool = False, sign: float = 1.0, nearest: int = 0
) -> dict[str, Any]:
    """Measure the hit of a number: its row with the truth as NAME_true; sign: of the errors of positions."""
    hit, truth = draw_one(kind, k, seed, warp, claimed, sign)
    if nearest:
        hit = replace(hit, tracks=keep_nearest(hit.tracks, nearest))
    return measure_hit(hit, KINDS[kind][2]) | {f"{name}_true": value for name, value in truth.items()}


def keep_nearest(tracks: pd.DataFrame, count: int) -> pd.DataFrame:
    """Keep the frames next to that in which the bodies are nearest: `count` on either side."""
    one, two = (part[["frame", "x", "y"]].to_numpy() for _, part in tracks.groupby("particle"))  # of the same frames
    nearest = one[int(np.argmin(((one - two)[:, 1:] ** 2).sum(axis=1))), 0]
    since = tracks["frame"].to_numpy() - nearest
    kept: pd.DataFrame = tracks.loc[(since > -count) & (since <= count)]
    return kept


def cover(rows: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """For each quantity: number with an error, rms of z, shares within 1 and 1.96 errors, median error."""
    out = {}
    for name in QUANTITIES:
        known = [row for row in rows if np.isfinite(row[f"{name}_local_std"] + row.get(f"{name}_true", np.nan))]
        if not known:
            continue
        std = np.array([row[f"{name}_local_std"] for row in known])
        z = np.array([row[f"{name}_local"] - row[f"{name}_true"] for row in known]) / std
        shares = [float(np.mean(np.abs(z) < limit)) for limit in (1.0, 1.96)]
        rms = float(np.sqrt(np.mean(np.minimum(z**2, 25.0))))
        out[name] = [len(known), *(round(v, 3) for v in (rms, *shares, float(np.median(std))))]
    return out


def show_cover(title: str, table: Mapping[str, list[float]]) -> None:
    """Print what `cover` returns."""
    print(f"{title}: number, rms z, within 1 and 1.96 errors, median error")
    for name, line in table.items():
        print(f"  {name:16}{line}", flush=True)


def measure_bias(rows: Sequence[dict[str, Any]], mirrored: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """For each quantity: number of hits, and the mean of both deviations over the mean error, with its error."""
    out = {}
    for name in QUANTITIES:
        off, std = (
            np.array([[row[f"{name}_local{end}"] for row in each] for each in (rows, mirrored)]) for end in ("", "_std")
        )
        z = (off.mean(axis=0) - [row[f"{name}_true"] for row in rows]) / std.mean(axis=0)
        z = z[np.isfinite(z)]
        if len(z):
            out[name] = [len(z), round(float(z.mean()), 3), round(float(z.std() / np.sqrt(len(z))), 3)]
    return out


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hits", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--warp", type=float, default=0.0)
    parser.add_argument("--claimed", action="store_true")
    parser.add_argument("--nearest", type=int, default=0, help="positions on either side of the hit; default: all")
    parser.add_argument("--mirrored", action="store_true")
    parser.add_argument("--only", choices=list(KINDS), action="append", help="only this kind; may be given again")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/local_estimates.json"))
    given, out = parser.parse_args(), {}
    for kind in given.only or KINDS:
        rows = measure_kind(kind, given.hits, given.seed, given.warp, given.claimed, nearest=given.nearest)
        bare = [row | apply_errors(row, LocalErrors()) for row in rows]
        out[kind] = {"residuals": cover(bare), "prior": cover(rows), "set": cover(calibrate_set(rows))}
        for errors, table in out[kind].items():
            show_cover(f"{kind}, {errors}", table)
        if given.mirrored:
            other = measure_kind(kind, given.hits, given.seed, given.warp, given.claimed, -1.0, given.nearest)
            out[kind]["bias"] = measure_bias(bare, [row | apply_errors(row, LocalErrors()) for row in other])
            print(f"{kind}, bias: number, mean deviation in errors, and its error")
            for name, line in out[kind]["bias"].items():
                print(f"  {name:16}{line}", flush=True)
    save(given.output, out)


if __name__ == "__main__":
    main()
