"""The observables of a gas from true positions with noise, against the truth of the simulation and kinetic theory.

python -m benchmarks.tracker.gas [--films 20] [--trays 5] [--low-friction 0] [--first 1] [-o out/gas.json]
    [--figure out/gas.png]

Or `make bench-gas`. No film is rendered. Positions have 0.05 px noise. Discs on air without any loss are a gas of
hard discs, for Enskog's theory; with r = 0.9 they cool by Haff's law. Their contacts are the true ones with errors of
0.05 frames in time. `cooling` has steel balls that slide and roll, and its contacts are found in the tracks. The
energies of the truth are those of translation, because a film shows no rotation. With --low-friction, so many films of
200 frames of `cooling` follow whose sliding friction is 0.04.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from benchmarks.harness import ROOT, save
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene
from tracker.gas.gas import GasCamera, GasObservables, contact_pair_correlation, contact_rate, measure_gas
from tracker.gas.pair_correlation import pair_correlation
from tracker.measurement.crowd.contact_table import tabulate_contacts
from tracker.measurement.positions import BallTrack, to_ball_tracks
from tracker.tables.read import to_pixels
from tracker.tables.table import TrackTable

Floats = NDArray[np.float64]
NOISE_PX, TIME_ERROR_FRAMES = 0.05, 0.05
DISCS, DIAMETER, SPEED = 60, 0.02, 0.1  # number, m, and root of the temperature, m/s
SIDE = 0.22  # m, of the box: area fraction 0.39
FRAMES_BETWEEN = (40, 20, 10, 6, 4)  # contacts of a disc
CURVES = ("temperature", "energy", "lost_in_contacts", "lost_at_walls", "lost_to_plate", "lost_unresolved")
COMPARED_FRAMES = 10  # of a film
TRAY_SIDE = 0.094  # m, of the scene cooling
LOW_FRICTION, LOW_FRICTION_FRAMES = 0.04, 200
HAFF_R = 0.9  # restitution of the discs that cool


def make_discs(seed: int, frames_between: float, restitution: float = 1.0) -> Clip:
    """Discs on air in a box; frames_between: frames between two contacts of a disc, by Enskog's rate."""
    corners = [[-SIDE / 2, -SIDE / 2], [SIDE / 2, -SIDE / 2], [SIDE / 2, SIDE / 2], [-SIDE / 2, SIDE / 2]]
    walls = [
        {"start": a, "end": b, "restitution": 1.0, "friction": 0.0}
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    fps = round(frames_between * float(contact_rate(SPEED**2, DISCS / SIDE**2, DIAMETER)))
    inside = [SIDE - 1.05 * DIAMETER] * 2
    return Scene.build(
        "discs",
        ball={"diameter": DIAMETER, "density": 1000},
        model={"restitution": restitution, "spin_transfer": 0},
        bodies={"shape": "disc", "mass": 0.01},
        support={"kind": "air", "decel": 0, "drag": 0},
        groups=[{"count": DISCS, "size": inside, "arrangement": "lattice", "rms_speed": SPEED * np.sqrt(2)}],
        walls=walls,
        timing={"fps": fps, "frames": min(12 * frames_between, 240), "exposure": 0.1 / fps},
        camera={"size": [1024, 1024], "scale": 1.05 * SIDE / 1024, "height": 2.0},
    ).draw(seed=seed)


def make_slippery_tray(seed: int) -> Clip:
    """A short film of `cooling` on a plate of low friction, where slides last long."""
    model, timing = {"sliding_friction": LOW_FRICTION}, {"frames": LOW_FRICTION_FRAMES}
    return Scene.read("cooling", model=model, timing=timing).draw(seed=seed)


@dataclass(frozen=True, eq=False)
class Film:
    """A film with its gas, and the same curves and numbers of the truth."""

    gas: GasObservables
    curves: pd.DataFrame
    values: dict[str, float]
    velocities: Floats  # (bodies, frames, 2)
    g_at_contact: float


def observe(clip: Clip, side: float, seed: int, *, on_air: bool) -> Film:
    """Measure the gas of one clip; side: of the box, m. Contacts on air are true ones, with errors of their times."""
    rng = np.random.default_rng(seed)
    x, y = (clip.tracks[f"{axis}_mean_px"] + NOISE_PX * rng.standard_normal(len(clip.tracks)) for axis in "xy")
    table = clip.tracks[["frame", "particle"]].assign(x=x, y=y, x_std=NOISE_PX, y_std=NOISE_PX, cov_xy=0.0)
    read = to_pixels(TrackTable(table[clip.tracks.visible]), "truth", clip.camera_json)
    tracks, camera = read.clips[0][0], read.camera
    contacts = _list_true_contacts(clip, rng) if on_air else tabulate_contacts(tracks, camera, [])
    reach = (side - camera.ball_diameter) / 2
    gas = measure_gas(
        to_ball_tracks(tracks, camera),
        contacts,
        GasCamera(camera.ball_diameter, camera.fps, on_air),
        area=(-reach, -reach, reach, reach),
    )
    balls = to_ball_tracks(tracks, camera)
    return Film(gas, *read_true_curves(clip), _extrapolate_pairs(balls, 2 * reach, camera.ball_diameter))


def _extrapolate_pairs(balls: list[BallTrack], side: float, diameter: float) -> float:
    """The pair correlation at contact, by a parabola through that up to 1.3 diameters."""
    table = pd.DataFrame(np.vstack([ball.position for ball in balls]), columns=["x", "y"])
    table["frame"] = np.concatenate([ball.frame for ball in balls])
    positions = [rows[["x", "y"]].to_numpy() for _, rows in table.groupby("frame")]
    near = pair_correlation(positions, (side, side), 1.3 * diameter, bins=10, least=diameter)
    return float(np.polyval(np.polyfit(near["r"] / diameter - 1, near["g"], 2), 0.0))


def _list_true_contacts(clip: Clip, rng: np.random.Generator) -> pd.DataFrame:
    """The contacts of the simulation as the tracker tabulates them, with errors of their times."""
    events = clip.solve().events
    events = events[events["kind"].isin(["contact", "wall"]) & (events["t_s"] < clip.frames / clip.camera_json["fps"])]
    other = np.where(events["kind"] == "wall", -1, events["j"])
    std = TIME_ERROR_FRAMES / clip.camera_json["fps"]
    unknown = {"energy_lost": np.nan, "energy_lost_std": np.nan, "misfit": False, "t_s_std": std}
    time = events["t_s"] + std * rng.standard_normal(len(events))
    return pd.DataFrame({"t_s": time, "particle1": events["i"], "particle2": other} | unknown)


def read_true_curves(clip: Clip) -> tuple[pd.DataFrame, dict[str, float], Floats]:
    """Curves, numbers and velocities of a clip by its simulation.

    The curves are those of the balls in view in a frame. A ball loses energy while it is in view in the frames before
    and after.
    """
    motion, bodies = clip.solve(), clip.tracks["particle"].nunique()
    every = clip.tracks.sort_values(["particle", "frame"])
    velocities = every[["vx", "vy"]].to_numpy().reshape(bodies, clip.frames, 2)
    seen = every["visible"].to_numpy(dtype=bool).reshape(bodies, clip.frames)
    time = every["t_s"].to_numpy()[: clip.frames]
    events = motion.events[motion.events["kind"].isin(["contact", "wall"])]
    events = events[events["t_s"].between(time[0], time[-1], inclusive="right")]
    at = events["t_s"].to_numpy()
    before, after = (
        motion.at(when)[["vx", "vy"]].to_numpy().reshape(bodies, len(at), 2) for when in (np.maximum(at - 1e-9, 0), at)
    )
    each = (velocities**2).sum(axis=2) / 2
    stays = seen[:, 1:] & seen[:, :-1]
    total = np.append(0.0, (-np.diff(each, axis=1) * stays).sum(axis=0).cumsum())
    step, frame = ((before**2).sum(axis=2) - (after**2).sum(axis=2)) / 2, np.searchsorted(time, at)
    rows, one, wall = np.arange(len(at)), events["i"].to_numpy(), (events["kind"] == "wall").to_numpy()
    other = np.where(wall, one, events["j"].to_numpy())
    step *= stays[:, frame - 1]
    taken, lost = step[one, rows] + np.where(wall, 0.0, step[other, rows]), {}
    for name, kind in (("lost_at_walls", wall), ("lost_in_contacts", ~wall)):
        lost[name] = np.bincount(frame[kind], taken[kind], clip.frames).cumsum()
    masked = np.ma.array(velocities, mask=np.repeat(~seen[..., None], 2, axis=2))
    temperature = masked.var(axis=0, ddof=1).mean(axis=1).filled(np.nan)
    curves = pd.DataFrame({"temperature": temperature, "energy": (each * seen).sum(axis=0)} | lost)
    curves["lost_to_plate"] = total - curves["lost_in_contacts"] - curves["lost_at_walls"]
    way = np.hypot(velocities[..., 0], velocities[..., 1]).mean(axis=1).sum() * (time[-1] - time[0])
    count = int((~wall).sum())
    return (
        curves,
        {"contacts": count, "contact_rate": 2 * count / bodies / (time[-1] - time[0]), "free_path": way / (2 * count)},
        velocities,
    )


def compare(film: Film) -> Iterator[dict[str, Any]]:
    """Deviations of one film from its truth: name, value, truth, std."""
    time = film.gas.time.iloc[np.linspace(0, len(film.gas.time) - 1, COMPARED_FRAMES).astype(int)]
    for name in CURVES[:-1]:
        true = film.curves[name].to_numpy()[time["frame"]]
        for value, std, truth in zip(time[name], time[f"{name}_std"], true, strict=True):
            yield {"name": name, "value": value, "std": std, "truth": truth}
    for name, truth in film.values.items():
        yield {"name": name, "value": film.gas.values[name], "std": film.gas.values[f"{name}_std"], "truth": truth}
    yield {"name": "sonine_a2", "value": film.gas.values["sonine_a2"], "std": film.gas.values["sonine_a2_std"]} | {
        "truth": _true_sonine(film.velocities)
    }


def _true_sonine(velocities: Floats) -> float:
    about = velocities - velocities.mean(axis=0)
    n = len(about)
    square = (about**2).sum(axis=2) / about.var(axis=0, ddof=1).mean(axis=1)
    return float((square**2).mean() / 8 * (n / (n - 1)) ** 2 * n / (n - 1) - 1)


def summarise(films: list[Film]) -> dict[str, dict[str, float]]:
    """Bias (of the sums), and rms and coverage of z, by name."""
    table = pd.DataFrame([row for film in films for row in compare(film)])
    out = {}
    for name, rows in table.groupby("name", sort=False):
        known = rows[rows["std"] > 0]
        z = ((known["value"] - known["truth"]) / known["std"]).to_numpy()
        out[str(name)] = {
            "ratio": float(rows["value"].sum() / rows["truth"].sum()) if rows["truth"].abs().max() > 1e-9 else np.nan,
            "z_mean": float(z.mean()) if len(z) else np.nan,
            "z_rms": float(np.sqrt((z**2).mean())) if len(z) else np.nan,
            "cover68": float((np.abs(z) < 1).mean()) if len(z) else np.nan,
            "cover95": float((np.abs(z) < 1.96).mean()) if len(z) else np.nan,
            "n": len(z),
        }
    return out


def score_every_frame(films: list[Film]) -> dict[str, dict[str, float]]:
    """Scores of temperature and energy in all frames, and the sums of the losses of whole films over the true ones."""
    out = dict[str, dict[str, float]]()
    for name in ("temperature", "energy"):
        z = np.concatenate(
            [
                (film.gas.time[name] - film.curves[name].to_numpy()[film.gas.time["frame"]])
                / film.gas.time[f"{name}_std"]
                for film in films
            ]
        )
        size = np.abs(z)
        out[name] = {"frames": len(z), "rms": float(np.sqrt((z**2).mean())), "median_size": float(np.median(size))}
        out[name] |= {"cover95": float((size < 1.96).mean()), "over_3": int((size > 3).sum())}
    for name in CURVES[2:-1]:
        last = [film.gas.time.iloc[-1] for film in films]
        value, std = (np.array([row[f"{name}{end}"] for row in last]) for end in ("", "_std"))
        truth = np.array([film.curves[name].iloc[int(row["frame"])] for film, row in zip(films, last, strict=True)])
        ratio, z = value / truth, (value - truth) / std
        out[name] = {"ratio": float(value.sum() / truth.sum()), "error": float(np.median(std / truth))}
        out[name]["ratio_std"] = float(ratio.std(ddof=1) / np.sqrt(len(ratio))) if len(ratio) > 1 else np.nan
        out[name] |= {"z_mean": float(z.mean()), "z_rms": float(np.sqrt((z**2).mean()))}
    return out


def compare_with_theory(films: list[Film]) -> dict[str, float]:
    """Contacts and free path of hard discs over those of theory, and the pair correlation at contact; with errors."""
    ratios = {
        name: np.array([film.gas.values[name] / film.gas.values[f"{name}_theory"] for film in films])
        for name in ("contacts", "free_path")
    }
    phi = np.mean([film.gas.values["area_fraction"] for film in films])
    ratios["g_at_contact"] = np.array([film.g_at_contact for film in films]) / float(contact_pair_correlation(phi))
    out = {}
    for name, ratio in ratios.items():
        out[name], out[f"{name}_std"] = float(ratio.mean()), float(ratio.std(ddof=1) / np.sqrt(len(ratio)))
    return out


def cool_by_haff(film: Film, restitution: float) -> Floats:
    """The temperature of Haff's law in two dimensions at each frame, from that of the first and Enskog's rate."""
    time, first = film.gas.time["t_s"].to_numpy(), float(film.curves["temperature"].iloc[0])
    rate = float(contact_rate(first, DISCS / SIDE**2, DIAMETER))
    return np.asarray(first / (1 + (1 - restitution**2) * rate * (time - time[0]) / 4) ** 2)


def draw(figures: dict[str, Any], cooled: list[Film], trays: list[Film], path: Path) -> None:
    """Temperature by Haff's law, the ratio of temperatures by frame rate, and energies of a tray, beside the truth."""
    figure, parts = plt.subplot_mosaic("lur;ldr", figsize=(12, 3.6), layout="constrained")
    left, upper, lower, right = (parts[name] for name in "ludr")
    film = cooled[0]
    time = film.gas.time
    t = time["t_s"] - time["t_s"].iloc[0]
    some = np.arange(0, len(time), max(len(time) // 25, 1))
    shown = time.iloc[some]
    left.errorbar(t.iloc[some], shown["temperature"], shown["temperature_std"], fmt="o", ms=3, label="measured")
    left.plot(t, film.curves["temperature"].to_numpy()[time["frame"]], color="0.2", lw=1, label="truth")
    left.plot(t, cool_by_haff(film, HAFF_R), ls="--", color="#c1440e", lw=1, label="Haff")
    left.set(xlabel="t / s", ylabel="T / (m²/s²)", yscale="log", title="60 discs on air, r = 0.9")
    left.legend(frameon=False)
    ratios = [figures[f"discs, {k} frames"]["temperature"] for k in FRAMES_BETWEEN]
    for axes, name, label, low in ((upper, "ratio", "T over truth", 0.95), (lower, "z_rms", "rms of z", 0.0)):
        axes.plot(FRAMES_BETWEEN, [each[name] for each in ratios], "o-")
        axes.axhline(1, color="0.6", lw=0.8)
        axes.set(ylabel=label, xscale="log", ylim=(low, None), xlim=(3.5, 46))
        axes.minorticks_off()
        axes.set_xticks(FRAMES_BETWEEN, [str(count) for count in FRAMES_BETWEEN])
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("frames between contacts")
    film = trays[0]
    time = film.gas.time
    for name in CURVES[2:-1]:
        value, std = 1e3 * time[name], 1e3 * time[f"{name}_std"]
        (line,) = right.plot(time["t_s"], value, label=name.replace("_", " "))
        right.fill_between(time["t_s"], value - std, value + std, color=line.get_color(), alpha=0.3, lw=0)
        right.plot(time["t_s"], 1e3 * film.curves[name].to_numpy()[time["frame"]], color=line.get_color(), ls=":")
    unknown = 1e3 * time["lost_unresolved"]
    right.plot(time["t_s"], unknown, color="0.5", label="not resolved")
    right.set(xlabel="t / s", ylabel="energy per unit mass / (10⁻³ m²/s²)", title="cooling; dotted: truth")
    right.set_ylim(top=1.35 * right.get_ylim()[1])
    right.legend(frameon=False, fontsize=8, ncols=2, loc="upper left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run all parts and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, default=20)
    parser.add_argument("--trays", type=int, default=5)
    parser.add_argument("--low-friction", type=int, default=0, help="trays with a friction of 0.04, 200 frames each")
    parser.add_argument("--first", type=int, default=1, help="seed of the first film and of the first tray")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/gas.json")
    parser.add_argument("--figure", type=Path, default=ROOT / "out/gas.png")
    given = parser.parse_args()
    figures: dict[str, Any] = {}
    seeds = range(given.first, given.first + given.films)
    for between in FRAMES_BETWEEN:
        films = [observe(make_discs(seed, between), SIDE, seed, on_air=True) for seed in seeds]
        figures[f"discs, {between} frames"] = summarise(films) | {"theory": compare_with_theory(films)}
        print(f"discs, {between} frames", *figures[f"discs, {between} frames"].items(), sep="\n", flush=True)
    cooled = [observe(make_discs(seed, 20, HAFF_R), SIDE, seed, on_air=True) for seed in seeds]
    haff = [film.curves["temperature"].iloc[-1] / cool_by_haff(film, HAFF_R)[-1] for film in cooled]
    figures["discs that cool"] = summarise(cooled) | {"truth_over_haff": float(np.mean(haff))}
    print("discs that cool", *figures["discs that cool"].items(), sep="\n", flush=True)
    clips = {seed: Scene.read("cooling").draw(seed=seed) for seed in range(given.first, given.first + given.trays)}
    trays = [observe(clip, TRAY_SIDE, seed, on_air=False) for seed, clip in clips.items()]
    figures["cooling"] = summarise(trays)
    figures["cooling, whole films"] = score_every_frame(trays)
    for name in ("cooling", "cooling, whole films"):
        print(name, *figures[name].items(), sep="\n")
    if given.low_friction:
        low = range(given.first, given.first + given.low_friction)
        slippery = [observe(make_slippery_tray(seed), TRAY_SIDE, seed, on_air=False) for seed in low]
        figures["low friction"] = score_every_frame(slippery)
        print("low friction", *figures["low friction"].items(), sep="\n")
    save(given.output, figures)
    draw(figures, cooled, trays, given.figure)


if __name__ == "__main__":
    main()
