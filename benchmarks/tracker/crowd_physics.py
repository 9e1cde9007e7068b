"""The physics of one film of each crowd scene, with errors, against the truth of the simulation.

python -m benchmarks.tracker.crowd_physics [SCENE ...] [--films 20] [--first 701] [--frames N] [-o OUT]

Or `make bench-crowd-physics`. No film is rendered. The tracker's linker joins true positions with 0.05 px noise. Then
come contacts, local estimates, their means over the film, and the gas. Long films are cut to `FRAMES`; `--frames 0`
takes whole ones. A run that was stopped continues: films whose line OUTPUT.jsonl has are not measured again.

z is a deviation over its standard error. 0 is right for its mean, 1 for its rms, and 0.95 for the share below 1.96.
Energies are those at the last frame. The temperature counts in every frame.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import tracker
from benchmarks.harness import ROOT, keep, save
from benchmarks.tracker.crowd_contacts import measure_true_positions
from benchmarks.tracker.gas import read_true_curves
from synthcam.dynamics.supports import Air
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene
from tracker.measurement.crowd.contact_table import summarise_contacts

FRAMES = {"crowd": 200, "cooling": 40, "break": 120, "pucks": 100, "dense": 6}  # of each film, by scene
SINKS = ("lost_in_contacts", "lost_at_walls", "lost_to_plate")
QUANTITIES = ("r", "mu_k", "mu_k of paths", "rolling_loss", "rolling_drag", *SINKS, "temperature")


def measure_film(scene: str, seed: int, frames: int) -> dict[str, list[dict[str, float]]]:
    """The values of one film by quantity: value, std and truth of each; frames: 0 for the whole film."""
    settings: dict[str, Any] = {"timing": {"frames": frames}} if frames else {}
    clip = Scene.read(scene, **settings).draw(seed=seed)
    result = measure_true_positions(clip, seed, linked=True)
    out: dict[str, list[dict[str, float]]] = {}
    for name, value, std, truth in _compare_film(clip, result):
        if np.isfinite(value) and std > 0 and truth != 0:  # without walls a scene loses nothing at them
            out.setdefault(name, []).append({"value": float(value), "std": float(std), "truth": float(truth)})
    return out


def _compare_film(clip: Clip, result: tracker.Result) -> Iterator[tuple[str, float, float, float]]:
    """Name, value, error and truth of all that a film shows."""
    truths = {"r": clip.model.restitution, "mu_k": clip.model.sliding_friction}
    for name, mean in summarise_contacts(result.contacts, result.rows).items():
        if name in truths:
            yield name, mean.coefficients[0], mean.std[0], truths[name]
    gas = tracker.observe_gas(result)
    drag, decel = read_true_loss(clip)
    yield "mu_k of paths", gas.values["mu_k"], gas.values["mu_k_std"], truths["mu_k"]
    losses = {"rolling_loss": decel + drag * gas.values["rolling_speed"], "rolling_drag": drag}
    for name, truth in losses.items():
        yield name, gas.values[name], gas.values[f"{name}_std"], truth
    curves = read_true_curves(clip)[0]
    true = curves["temperature"].to_numpy()[gas.time["frame"]]
    for value, std, truth in zip(gas.time["temperature"], gas.time["temperature_std"], true, strict=True):
        yield "temperature", value, std, truth
    last = gas.time.iloc[-1]
    for name in SINKS:
        yield name, last[name], last[f"{name}_std"], curves[name].iloc[int(last["frame"])]


def read_true_loss(clip: Clip) -> tuple[float, float]:
    """The loss of a clip by rolling, or by gliding on air: the part by the speed, 1/s, and the rest, m/s^2."""
    supports = clip.table.supports if clip.table else ()
    air = next((support for support in supports if isinstance(support, Air)), None)
    return (air.drag, air.decel) if air else (clip.model.rolling_drag, clip.model.rolling_decel)


def summarise(films: Sequence[dict[str, list[dict[str, float]]]]) -> dict[str, dict[str, float]]:
    """Scores of each quantity over films.

    films: how many give it. ratio: the median of value over truth. error: the median error over the truth, and of z
    the mean, the rms and the share below 1.96 in size.
    """
    out = {}
    for name in QUANTITIES:
        given = [film[name] for film in films if name in film]
        out[name] = {"films": float(len(given))}
        if given:
            value, std, truth = pd.DataFrame([row for film in given for row in film])[
                ["value", "std", "truth"]
            ].T.to_numpy()
            z = (value - truth) / std
            out[name] |= {"ratio": float(np.median(value / truth)), "error": float(np.median(std / np.abs(truth)))}
            out[name] |= {"mean": float(z.mean()), "rms": float(np.sqrt((z**2).mean()))}
            out[name]["cover95"] = float((np.abs(z) < 1.96).mean())
    return out


def main() -> None:
    """Measure the films of all scenes and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(FRAMES), metavar="SCENE", help=", ".join(FRAMES))
    parser.add_argument("--films", type=int, default=20, help="of each scene")
    parser.add_argument("--first", type=int, default=701, help="seed of the first film")
    parser.add_argument("--frames", type=int, help="of each film, 0 for whole films; default: FRAMES of the scene")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/crowd_physics.json")
    given = parser.parse_args()
    kept, figures = given.output.with_suffix(".jsonl"), dict[str, Any]()
    for scene in given.scenes:
        frames = FRAMES[scene] if given.frames is None else given.frames
        films = list[dict[str, list[dict[str, float]]]]()
        for seed in range(given.first, given.first + given.films):
            part = f"{scene} {seed}, {frames} frames"
            films.append(keep(kept, part, partial(measure_film, scene, seed, frames)))
            print(part, *(name for name in QUANTITIES if name in films[-1]), flush=True)
        figures[scene] = summarise(films)
        print(pd.DataFrame(figures[scene]).T.round(3).to_string(), flush=True)
    save(given.output, figures)


if __name__ == "__main__":
    main()
