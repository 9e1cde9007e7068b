"""Crowds from true positions with noise: identities beside trackpy and laptrack, contacts, and the physics of a film.

python -m benchmarks.tracker.crowds [--films 20] [--short] [-o JSON] [--figure PNG]   # or make bench-crowds

No film is rendered. Positions are those of the simulation with 0.05 px noise; a hundredth is missing, and each frame
has one false spot in the mean. All linkers get the same positions in the same run. trackpy predicts by the nearest
velocity, with a reach that adapts. A linker's reach is 1.2 of the longest true step of a ball. Tracks of one or two
frames count for none. `--short` shortens the long films and takes five films for the contacts. A run that was stopped
continues: parts whose line OUTPUT.jsonl has are not measured again.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from benchmarks.harness import ROOT, keep, save
from benchmarks.tracker.crowd_contacts import measure_films
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene
from tracker.camera.camera import Camera
from tracker.detection.glints import Glints
from tracker.detection.link import assign_track_numbers
from tracker.detection.linkers.laptrack import Laptrack
from tracker.scoring.tracking_metrics import TrackPoints, score_tracks
from tracker.settings import LinkSettings

trackpy: Any = importlib.import_module("trackpy")  # it has no types
Ints = NDArray[np.int64]
NOISE_PX, MISSED, FALSE_SPOTS = 0.05, 0.01, 1.0
SPEEDS = (0.1, 0.3, 0.6, 1.2, 2.4, 4.8)  # m/s, root mean square at the start
SIDE = 0.15  # m, of the tray of 100 balls


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
    rng, camera, every = np.random.default_rng(seed), clip.camera_json, clip.tracks
    seen = every[every.visible & (rng.random(len(every)) >= MISSED)]
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
    true = clip.tracks
    steps = np.hypot(*true.groupby("particle")[["x_mean_px", "y_mean_px"]].diff().to_numpy().T)
    return float(np.median(steps[true.frame == 1])), float(np.nanmax(steps))


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
        "tracker": lambda spots: assign_track_numbers(spots, camera, settings=settings),
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


def score_tray(speed: float, frames: int = 60) -> dict[str, Any]:
    """Scores of all linkers on a tray of 100 balls."""
    return score_linkers(make_tray(speed, frames))


def rank_linkers(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """A line for each linker, the best first: means over the trays, and all exchanged identities."""
    scores = {name: [row[name] for row in rows if row[name]] for name in ("tracker", "trackpy", "laptrack")}
    lines = [
        {"name": name, "trays": len(own)}
        | {key: float(np.mean([score[key] for score in own])) for key in ("hota", "idf1", "mota", "ms_per_frame")}
        | {"swaps": sum(score["swaps"] for score in own)}
        for name, own in scores.items()
    ]
    return pd.DataFrame(lines).sort_values(["trays", "hota"], ascending=False, ignore_index=True)


def draw(figures: dict[str, Any], path: Path) -> None:
    """HOTA by step over spacing, and the mean r of each film with its error; legible in print without colours."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    rows = figures["linking"]
    styles = {"tracker": ("o-", "0.1", "0.1"), "trackpy": ("s--", "C1", "white"), "laptrack": ("^:", "C0", "C0")}
    for name, (line, color, inside) in styles.items():
        known = [(row["step_px"] / row["spacing_px"], row[name]["hota"]) for row in rows if row[name]]
        left.plot(*zip(*known, strict=True), line, color=color, mfc=inside, label=name)
    left.set(xlabel="median first step / spacing", ylabel="HOTA", ylim=(0, 1.03), title="100 balls in a tray")
    left.legend(frameon=False, loc="lower left")
    means = [film["means"]["r"] for film in figures["contacts"]["films"] if "r" in film["means"]]
    value, std = (np.array([mean[key] for mean in means]) for key in ("value", "std"))
    right.errorbar(np.arange(1, len(means) + 1), value, std, fmt="o", ms=4, color="0.1", label="measured")
    right.xaxis.get_major_locator().set_params(integer=True)
    right.axhline(means[0]["truth"], color="C1", lw=1, ls="--", label="truth")
    right.set(xlabel="film of thirty balls", ylabel="mean r of its contacts")
    right.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run all parts and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, help="films whose contacts are measured; 20, or 5 with --short")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/crowds.json")
    parser.add_argument("--figure", type=Path, default=ROOT / "out/crowds.png")
    parser.add_argument("--short", action="store_true", help="fewer frames of the two long films, and fewer films")
    given = parser.parse_args()
    of_30, of_100, films = (300, 200, 5) if given.short else (1000, 500, 20)
    long_films: dict[str, Callable[[], Any]] = {
        f"crowd of 30, {of_30} frames": lambda: score_linkers(
            Scene.read("crowd", timing={"frames": of_30}).draw(seed=1)
        ),
        f"100 balls that cool, {of_100} frames": lambda: score_tray(0.3, of_100),
    }
    kept = given.output.with_suffix(".jsonl")
    figures: dict[str, Any] = {"linking": []}
    for speed in SPEEDS:
        figures["linking"].append(keep(kept, f"linking {speed}", partial(score_tray, speed)))
        print(figures["linking"][-1], flush=True)
    for name, make in long_films.items():
        figures[name] = keep(kept, name, make)
        print(name, figures[name], flush=True)
    figures["contacts"] = measure_films("crowd", range(1, (given.films or films) + 1), kept)
    print({name: value for name, value in figures["contacts"].items() if name != "films"})
    ranked = rank_linkers(figures["linking"])
    print(ranked.round(3).to_string())
    figures["leaderboard"] = ranked.to_dict("records")
    save(given.output, figures)
    draw(figures, given.figure)


if __name__ == "__main__":
    main()
