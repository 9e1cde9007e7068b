"""The contacts of crowds and what each gives, with their errors, against the truth of the simulation.

python -m benchmarks.tracker.crowd_contacts [--films 20] [--first 1] [--scene crowd] [--rendered]

Or `make bench-crowd-contacts`. A run that was stopped continues: films whose line OUTPUT.jsonl has are not measured
again.

Positions are true ones with 0.05 px noise, unless films are rendered and tracked. The score z is a deviation over its
standard error. Each column of contacts.parquet has its mean and rms z, and the shares of |z| below 1 and 1.96: 0.68 and
0.95 are right. Contacts that the tracker marks as misfits count for their times and kicks only.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import tracker
from benchmarks.harness import ROOT, keep, save
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene
from tracker.camera.camera import Camera
from tracker.detection.glints import Glints
from tracker.detection.link import assign_track_numbers
from tracker.measurement.crowd.contact_table import summarise_contacts
from tracker.measurement.local.recommendation import NONE

Floats = NDArray[np.float64]
NOISE_PX = 0.05
MARGIN_S = 0.012  # at either end of a film, where paths are too short for a contact
REACH_S = 0.008  # within which a contact that is found may be a true one
COLUMNS = ("t_s", "kick", "v_n", "v_t", "r", "mu_bb", "mu_k", "impulse", "energy", "energy_lost")


def measure_film(scene: str, number: int, *, rendered: bool = False) -> dict[str, Any]:
    """Numbers of one film, and rows of each true contact that is found: column, value, std, truth, gap."""
    clip = Scene.read(scene).draw(seed=number)
    result = tracker.track(clip.film(), clip.camera_json) if rendered else measure_true_positions(clip, number)
    contacts = result.contacts.replace(dict.fromkeys(("particle1", "particle2"), name_balls(clip, result)))
    last = clip.frames / clip.camera_json["fps"] - MARGIN_S
    true = read_true_contacts(clip)
    true = true[true["t_s"].between(MARGIN_S, last)]
    found = contacts[contacts["t_s"].between(MARGIN_S, last)]
    rows = match(true, found)
    ratios = result.estimates[result.estimates["recommended"] != NONE]
    ratios = ratios[~ratios["misfit_local"].astype(bool) & (ratios["mass_ratio_std"] > 0)]
    recoil = {"column": "mass_ratio", "value": ratios["mass_ratio"], "std": ratios["mass_ratio_std"], "truth": 1.0}
    rows = pd.concat([rows, pd.DataFrame(recoil)], ignore_index=True)
    model = clip.model
    truths = {"r": model.restitution, "mu_k": model.sliding_friction}
    means = {
        name: {"value": float(mean.coefficients[0]), "std": float(mean.std[0]), "truth": truths[name]}
        for name, mean in summarise_contacts(result.contacts, result.rows).items()
        if name in truths
    }
    counts = {"contacts": len(true), "found": len(found), "matched": int((rows["column"] == "t_s").sum())}
    return counts | {"means": means, "rows": rows.to_dict("records")}


def measure_true_positions(clip: Clip, seed: int, *, linked: bool = False) -> tracker.Result:
    """Measure the true positions of a clip with noise.

    linked: the tracker's linker numbers the balls, not the simulation.
    """
    rng = np.random.default_rng(seed)
    true, camera = clip.tracks, clip.camera_json
    x, y = (true[f"{axis}_mean_px"] + NOISE_PX * rng.standard_normal(len(true)) for axis in "xy")
    table = true[["frame", "particle"]].assign(x=x, y=y, x_std=NOISE_PX, y_std=NOISE_PX, cov_xy=0.0)
    table = table[true.visible].reset_index(drop=True)
    return tracker.measure(_link(table, camera) if linked else table, camera)


def _link(table: pd.DataFrame, camera: dict[str, Any]) -> pd.DataFrame:
    """The positions that the tracker's linker joins to tracks, with its numbers of the balls."""
    table = table.sort_values(["frame", "x"]).reset_index(drop=True)
    count, frame = len(table), table["frame"].to_numpy(np.int64)
    cov = np.tile(NOISE_PX**2 * np.eye(2), (count, 1, 1))
    of_glint = np.full(count, 1200.0), np.full(count, 8.0), np.zeros(count, np.int64)  # flux, background, flags
    spots = Glints(frame, table["x"].to_numpy(), table["y"].to_numpy(), cov, *of_glint)
    table["particle"] = assign_track_numbers(spots, Camera.from_dict(camera))
    return table[table["particle"] >= 0]


def name_balls(clip: Clip, result: tracker.Result) -> dict[int, int]:
    """The true ball of each particle: the one that is nearest in most frames; -1 stays."""
    both = result.tracks[["frame", "particle", "x", "y"]].merge(
        clip.tracks[["frame", "particle", "x_mean_px", "y_mean_px"]], on="frame", suffixes=("", "_true")
    )
    both["far"] = np.hypot(both["x"] - both["x_mean_px"], both["y"] - both["y_mean_px"])
    nearest = both.loc[both.groupby(["particle", "frame"])["far"].idxmin()]
    every: list[Any] = nearest["particle"].unique().tolist()
    return {k: int(nearest["particle_true"][nearest["particle"] == k].mode()[0]) for k in every}


def read_true_contacts(clip: Clip) -> pd.DataFrame:
    """The contacts and bounces of the simulation with the values that contacts.parquet has."""
    motion, ball = clip.solve(), clip.model.ball
    events = motion.events[motion.events["kind"].isin(["contact", "wall"])].reset_index(drop=True)
    at, count = events["t_s"].to_numpy(), len(motion.at([0.0]))
    before, after = (
        motion.at(when).sort_values(["particle", "t_s"])[["x", "y", "vx", "vy"]].to_numpy().reshape(count, len(at), 4)
        for when in (np.maximum(at - 1e-9, 0), at)
    )
    one, other = (events[k].to_numpy() for k in "ij")
    is_pair, rows = (events["kind"] == "contact").to_numpy(), np.arange(len(at))
    pair = np.where(is_pair, other, one)
    normal = before[pair, rows, :2] - before[one, rows, :2]
    normal /= np.maximum(np.hypot(*normal.T), 1e-12)[:, None]
    into, out = (state[pair, rows, 2:] - state[one, rows, 2:] for state in (before, after))
    along = np.maximum(np.abs((into * normal).sum(axis=1)), 1e-12)
    impulse = events["impulse_n"].to_numpy() / (ball.density * np.pi * ball.diameter**3 / 6)
    energies = [(state[pair, rows, 2:] ** 2 + state[one, rows, 2:] ** 2).sum(axis=1) / 2 for state in (before, after)]
    values = {
        "v_n": along,
        "v_t": np.abs(into[:, 0] * normal[:, 1] - into[:, 1] * normal[:, 0]),
        "r": np.abs((out * normal).sum(axis=1)) / along,
        "mu_bb": np.abs(events["impulse_t"]) / events["impulse_n"],
        "mu_k": clip.model.sliding_friction,
        "impulse": impulse,
        "kick": impulse,
        "energy": (into**2).sum(axis=1) / 4,
        "energy_lost": energies[0] - energies[1],
    }
    return pd.DataFrame({"t_s": at, "one": one, "other": np.where(is_pair, other, -1)} | values)


def match(true: pd.DataFrame, found: pd.DataFrame) -> pd.DataFrame:
    """Rows column, value, std, truth and gap of the contacts that are found; gap: s, to the next of either ball."""
    left, out = found.to_dict("records"), list[dict[str, Any]]()
    for event in true.to_dict("records"):
        own = {event["one"], event["other"]}
        near = [c for c in left if {c["particle1"], c["particle2"]} == own and abs(c["t_s"] - event["t_s"]) < REACH_S]
        if not near:
            continue
        best = min(near, key=lambda contact: abs(contact["t_s"] - event["t_s"]))
        left.remove(best)
        same = true["one"].isin(own - {-1}) | true["other"].isin(own - {-1})
        gap = (true["t_s"][same] - event["t_s"]).abs().nlargest(int(same.sum()) - 1).min()
        names = COLUMNS if event["other"] >= 0 else ("t_s",)
        out += [
            {"column": name, "value": best[name], "std": best[f"{name}_std"], "truth": event[name], "gap": gap}
            for name in names
            if np.isfinite(best[name]) and (name in ("t_s", "kick") or not best["misfit"])
        ]
    return pd.DataFrame(out, columns=["column", "value", "std", "truth", "gap"])


def score(z: Floats) -> dict[str, float]:
    """Mean, median size and rms of scores, and the shares within one error and within 1.96."""
    size = np.abs(z)
    return {
        "n": len(z),
        "mean": float(z.mean()),
        "rms": float(np.sqrt((z**2).mean())),
        "median_size": float(np.median(size)),
        "cover68": float((size < 1).mean()),
        "cover95": float((size < 1.96).mean()),
    }


def measure_films(scene: str, numbers: Sequence[int], kept: Path, *, rendered: bool = False) -> dict[str, Any]:
    """Recall and precision of contacts, scores of each column, scores of the means of the films, and the films.

    kept: the file of the films that were measured before.
    """
    films = list[dict[str, Any]]()
    for number in numbers:
        part = f"{'rendered ' if rendered else ''}{scene} {number}"
        films.append(keep(kept, part, partial(measure_film, scene, number, rendered=rendered)))
        print(part, *(f"{name} {mean}" for name, mean in films[-1]["means"].items()), flush=True)
    table = pd.DataFrame([row for film in films for row in film.pop("rows")])
    table["z"] = (table["value"] - table["truth"]) / table["std"]
    total = {key: sum(film[key] for film in films) for key in ("contacts", "found", "matched")}
    late = table[table["column"] == "t_s"]
    figures: dict[str, Any] = {
        "recall": total["matched"] / total["contacts"],
        "precision": total["matched"] / total["found"],
        "median_time_error_us": float(1e6 * (late["value"] - late["truth"]).abs().median()),
        "columns": {name: score(part["z"].to_numpy()) for name, part in table.groupby("column")},
    }
    for name in ("r", "mu_k"):
        means = [film["means"][name] for film in films if name in film["means"]]
        if means:
            figures[f"mean_{name}"] = score(np.array([(m["value"] - m["truth"]) / m["std"] for m in means]))
            figures[f"mean_{name}"]["std"] = float(np.median([m["std"] for m in means]))
    return figures | {"films": films}


def main() -> None:
    """Measure all films and write the scores of each column."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, default=20)
    parser.add_argument("--first", type=int, default=1, help="seed of the first film")
    parser.add_argument("--scene", default="crowd")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/crowd_contacts.json")
    parser.add_argument("--rendered", action="store_true", help="render the films and track them")
    given = parser.parse_args()
    kept = given.output.with_suffix(".jsonl")
    numbers = range(given.first, given.first + given.films)
    figures = measure_films(given.scene, numbers, kept, rendered=given.rendered)
    save(given.output, figures)
    print(pd.DataFrame(figures["columns"]).T.round(2).to_string())
    print({name: value for name, value in figures.items() if name not in ("columns", "films")})


if __name__ == "__main__":
    main()
