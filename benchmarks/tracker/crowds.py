"""Crowds from true positions with noise: identities beside trackpy and laptrack, contacts, and the physics of a film.

python -m benchmarks.tracker.crowds [--films 20] [-o out/crowds.json] [--figure out/crowds.png]   # or make bench-crowds

No film is rendered. Positions are those of the simulation with 0.05 px noise; a hundredth is missing, and each frame
has one false spot in the mean. All linkers get the same positions in the same run. trackpy predicts by the nearest
velocity, with a reach that adapts. A linker's reach is 1.2 of the longest true step of a ball. Tracks of one or two
frames count for none.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from numpy.typing import NDArray

import tracker
from benchmarks.harness import ROOT, save
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene
from tracker.camera.camera import Camera
from tracker.detection.glints import Glints
from tracker.detection.link import assign
from tracker.detection.linkers.laptrack import Laptrack
from tracker.measurement.crowd.contact_table import summarise_contacts
from tracker.scoring.tracking_metrics import TrackPoints, score_tracks
from tracker.settings import LinkSettings

trackpy: Any = importlib.import_module("trackpy")  # it has no types
Ints = NDArray[np.int64]
NOISE_PX, MISSED, FALSE_SPOTS = 0.05, 0.01, 1.0
SPEEDS = (0.1, 0.3, 0.6, 1.2, 2.4, 4.8)  # m/s, root mean square at the start
SIDE = 0.15  # m, of the tray of 100 balls
MARGIN_S = 0.012  # at either end of a film, where paths are too short for a contact


def make_tray(speed: float, frames: int, count: int = 100, side: float = SIDE) -> Clip:
    """Steel balls in a tray, 1024 x 1024 px."""
    corners = [[-side / 2, -side / 2], [side / 2, -side / 2], [side / 2, side / 2], [-side / 2, side / 2]]
    walls = [
        {"start": a, "end": b, "restitution": 0.8, "friction": 0.2}
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    inside = [side - 0.003, side - 0.003]
    group = {"count": count, "size": inside, "arrangement": "lattice", "gap": 4e-4, "rms_speed": speed}
    camera = {"size": [1024, 1024], "scale": 1.05 * side / 1024}
    timing = {"frames": frames, "fps": 250}
    return Scene.build("tray of 100", groups=[group], walls=walls, timing=timing, camera=camera).draw(seed=1)


def detect(clip: Clip, seed: int = 0) -> tuple[Glints, Ints]:
    """Detections in random order, and the ball of each, -1 for a false one."""
    rng, camera = np.random.default_rng(seed), clip.camera_json
    seen = clip.tracks[clip.tracks.visible & (rng.random(len(clip.tracks)) >= MISSED)]
    count = rng.poisson(FALSE_SPOTS * clip.frames)
    true = seen[["x_mean_px", "y_mean_px"]].to_numpy() + NOISE_PX * rng.standard_normal((len(seen), 2))
    frame = np.r_[seen.frame.to_numpy(), rng.integers(0, clip.frames, count)].astype(np.int64)
    xy = np.vstack([true, rng.uniform(0, camera["size"], (count, 2))])
    ball = np.r_[seen.particle.to_numpy(), np.full(count, -1)].astype(np.int64)
    order = np.lexsort((rng.random(len(frame)), frame))
    n = len(frame)
    cov = np.tile(NOISE_PX**2 * np.eye(2), (n, 1, 1))
    flags = np.zeros(n, np.int64)
    spots = Glints(frame, xy[:, 0], xy[:, 1], cov, np.full(n, 1200.0), np.full(n, 8.0), flags)
    return spots.take(order), ball[order]


def measure_steps(clip: Clip) -> tuple[float, float]:
    """The median first step and the longest step of a ball, px."""
    steps = np.hypot(*clip.tracks.groupby("particle")[["x_mean_px", "y_mean_px"]].diff().to_numpy().T)
    return float(np.median(steps[clip.tracks.frame == 1])), float(np.nanmax(steps))


def make_linkers(camera: Camera, longest: float) -> dict[str, Callable[[Glints], Ints]]:
    """The linkers by name."""
    settings = LinkSettings(max_speed_m_s=1.2 * longest * camera.fps * camera.scale)

    def link_by_trackpy(spots: Glints) -> Ints:
        trackpy.quiet()
        table = pd.DataFrame({"frame": spots.frame, "x": spots.x, "y": spots.y, "row": np.arange(len(spots))})
        predict = trackpy.predict.NearestVelocityPredict()
        done = predict.link_df(table, search_range=1.2 * longest, memory=settings.max_gap_frames, adaptive_stop=2.0)
        ids = np.full(len(spots), -1, dtype=np.int64)
        ids[done["row"].to_numpy(np.int64)] = done["particle"].to_numpy(np.int64)
        return ids

    return {
        "tracker": lambda spots: assign(spots, camera, settings=settings),
        "trackpy": link_by_trackpy,
        "laptrack": Laptrack(camera, settings),
    }


def score_linkers(clip: Clip) -> dict[str, Any]:
    """Scores and processor time of all linkers, by name; a linker that gives up has none."""
    spots, ball = detect(clip)
    camera = Camera.from_dict(clip.camera_json)
    step, longest = measure_steps(clip)
    spacing = float(np.sqrt(np.prod(camera.size) / clip.tracks.particle.nunique()))
    out: dict[str, Any] = {"step_px": step, "spacing_px": spacing}
    true = TrackPoints.of(spots.frame[ball >= 0], ball[ball >= 0], spots.xy[ball >= 0])
    for name, link in make_linkers(camera, longest).items():
        began = time.process_time()
        try:
            ids = link(spots)
        except trackpy.SubnetOversizeException:
            out[name] = None
            continue
        spent = 1e3 * (time.process_time() - began) / clip.frames
        length = np.bincount(ids[ids >= 0], minlength=1)
        kept = (ids >= 0) & (length[ids] > 2)
        scores = score_tracks([(true, TrackPoints.of(spots.frame[kept], ids[kept], spots.xy[kept]))])
        out[name] = {k: scores[k] for k in ("hota", "idf1", "mota", "swaps")} | {"ms_per_frame": spent}
    return out


def measure_film(number: int) -> dict[str, Any]:
    """One film of the crowd: how many contacts are found, how well, and the physics that they share."""
    clip, rng = Scene.read("crowd").draw(seed=number), np.random.default_rng(number)
    x, y = (clip.tracks[f"{axis}_mean_px"] + NOISE_PX * rng.standard_normal(len(clip.tracks)) for axis in "xy")
    table = clip.tracks[["frame", "particle"]].assign(x=x, y=y, x_std=NOISE_PX, y_std=NOISE_PX, cov_xy=0.0)
    result = tracker.measure(table[clip.tracks.visible], clip.camera_json)
    found = result.contacts
    last = clip.frames / clip.camera_json["fps"] - MARGIN_S
    events = clip.solve().events
    events = events[(events.kind == "contact") & events.t_s.between(MARGIN_S, last)]
    balls = found[(found.kind == "ball") & found.t_s.between(MARGIN_S, last)]
    z, us = list[float](), list[float]()
    left = balls.to_dict("records")
    for event in events.to_dict("records"):
        own = {event["i"], event["j"]}
        near = [c for c in left if {c["particle1"], c["particle2"]} == own and abs(c["t_s"] - event["t_s"]) < 0.008]
        if near:
            off = [float(c["t_s"] - event["t_s"]) for c in near]
            k = int(np.argmin(np.abs(off)))
            left.remove(near[k])
            us.append(1e6 * off[k])
            z.append(off[k] / near[k]["t_s_std"])
    means = {
        name: [float(mean.coefficients[0]), float(mean.std[0]), len(mean.weights)]
        for name, mean in summarise_contacts(found, result.rows).items()
    }
    model = clip.model
    each = (found.r - model.restitution) / found.r_std
    return {
        "contacts": len(events),
        "found": len(balls),
        "matched": len(z),
        "time_us": us,
        "time_z": z,
        "r_z": each[each.notna()].tolist(),
        "means": means,
        "truth": {"r": model.restitution, "mu_k": model.sliding_friction},
    }


def summarise_films(films: list[dict[str, Any]]) -> dict[str, Any]:
    """Recall and precision of contacts, and scores z of times, of r of each contact, and of the means of the films."""
    total = {key: sum(film[key] for film in films) for key in ("contacts", "found", "matched")}
    out: dict[str, Any] = {
        "recall": total["matched"] / total["contacts"],
        "precision": total["matched"] / total["found"],
    }
    lists = {key: np.array([z for film in films for z in film[key]]) for key in ("time_us", "time_z", "r_z")}
    out["median_time_error_us"] = float(np.median(np.abs(lists["time_us"])))
    for name in ("time_z", "r_z"):
        out[name] = {"median_size": float(np.median(np.abs(lists[name]))), "n": len(lists[name])}
        out[name] |= {"rms": float(np.sqrt(np.mean(lists[name] ** 2)))}
    for name in ("r", "mu_k"):
        means = [(film["means"][name], film["truth"][name]) for film in films if name in film["means"]]
        z = np.array([(value - true) / std for (value, std, _), true in means])
        out[f"mean_{name}"] = {"films": len(z), "z_mean": float(z.mean()), "z_rms": float(np.sqrt((z**2).mean()))}
    return out


def draw(figures: dict[str, Any], path: Path) -> None:
    """HOTA by step over spacing, and the mean r of each film with its error."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    rows = figures["linking"]
    for name, marker in (("tracker", "o"), ("trackpy", "s"), ("laptrack", "^")):
        known = [(row["step_px"] / row["spacing_px"], row[name]["hota"]) for row in rows if row[name]]
        left.plot(*zip(*known, strict=True), marker=marker, label=name)
    left.set(xlabel="median first step / spacing", ylabel="HOTA", ylim=(0, 1.02))
    left.legend()
    films = [film for film in figures["films"] if "r" in film["means"]]
    value, std = np.array([film["means"]["r"][:2] for film in films]).T
    right.errorbar(np.arange(len(films)), value, std, fmt="o", ms=4)
    right.xaxis.get_major_locator().set_params(integer=True)
    right.axhline(films[0]["truth"]["r"], color="grey", lw=1)
    right.set(xlabel="film", ylabel="mean r of its contacts")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run all parts and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, default=20)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/crowds.json")
    parser.add_argument("--figure", type=Path, default=ROOT / "out/crowds.png")
    given = parser.parse_args()
    figures: dict[str, Any] = {"linking": [score_linkers(make_tray(speed, 60)) for speed in SPEEDS]}
    print(*figures["linking"], sep="\n", flush=True)
    for name, clip in (
        ("crowd of 30, 1000 frames", Scene.read("crowd", timing={"frames": 1000}).draw(seed=1)),
        ("100 balls that cool, 500 frames", make_tray(0.3, 500)),
    ):
        figures[name] = score_linkers(clip)
        print(name, figures[name], flush=True)
    figures["films"] = [measure_film(number) for number in range(1, given.films + 1)]
    figures["summary"] = summarise_films(figures["films"])
    print(figures["summary"])
    save(given.output, figures)
    draw(figures, given.figure)


if __name__ == "__main__":
    main()
