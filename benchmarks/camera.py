"""How true and how fast is the camera? Pictures against float64 rays, noise against EMVA 1288, frames a second.

benchmarks/camera.py [--pairs 60] [--clips 40] [-o out/camera.json]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import camera_reference as reference
from synthcam.glints import find_glints
from synthcam.lamp import Lamp
from synthcam.optics import Camera
from synthcam.render import FINENESS, Film, gl_info
from synthcam.sensor import Chip, Sensor
from synthcam.surface import Surface

ROOT = Path(__file__).resolve().parent.parent
Array = NDArray[np.float64]
R = 1.19e-3
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)
SCENE = {
    "name": "camera-benchmark",
    "camera": {"size": [512, 256], "scale": 1.0e-4},
    "launch": {"v0": {"uniform": [0.1, 0.6]}, "b": {"uniform": [-0.3, 0.3]}, "heading": {"uniform": [0, 6.2832]}},
    "timing": {"contact_frame": {"uniform": [20, 30]}},
}
LIMITS = {
    "primary place, px rms": 0.002,
    "primary flux, relative": 0.01,
    "secondary place, px rms": 0.01,
    "secondary flux, relative": 0.02,
    "outline, px rms": 0.005,
    "gain, relative": 0.02,
    "read noise, relative": 0.02,
    "PRNU, relative": 0.02,
    "DSNU, relative": 0.02,
    "noise shared by two frames": 0.01,
    "fixed pattern not shared by clips": 0.02,
}


def overhead(**changes: Any) -> Camera:
    settings: dict[str, Any] = {"size": (512, 256), "scale": 1e-4, "height": 0.5, "ball_radius": R}
    return Camera.overhead(**settings | {"fps": 250, "exposure": 5e-4, "psf_sigma_px": 1.0} | changes)


def still(centres: Array) -> Any:
    return lambda times: np.broadcast_to(centres, (len(times), *centres.shape))


def glints(pairs: int, rng: np.random.Generator) -> dict[str, float]:
    """Pairs at contact and apart, anywhere in view: places and fluxes as drawn less those traced."""
    film = Film(overhead(), LAMP, [R, R], room=0.0)
    places: dict[int, list[float]] = {1: [], 2: []}
    fluxes: dict[int, list[float]] = {1: [], 2: []}
    for k in range(pairs):
        gap = 2 * R * (1 if k % 2 else 1 + rng.exponential(0.3))
        turn = rng.uniform(0, 2 * np.pi)
        middle = rng.uniform([-0.021, -0.009], [0.021, 0.009])
        half = gap / 2 * np.array([np.cos(turn), np.sin(turn)])
        centres = np.array([[*(middle - half), R], [*(middle + half), R]])
        (picture,) = film.frames(still(centres), [[0.0, 0.0]])
        image = (picture.image - picture.plate) / film._unit
        near = find_glints(film.camera, LAMP, centres[None], film.radii, np.ones((1, 2), bool))
        traced = [
            reference.lamp_image(film.camera, LAMP, centres, film.radii, pixel, int(order))
            for pixel, order in zip(near.pixels, near.order, strict=True)
        ]
        spots = [reference.spot(film.camera, image.shape, *found) for found in traced]
        at = np.array([place for place, _, _ in traced])
        offsets, shares = reference.separate(image, spots, at)
        for j, order in enumerate(near.order.tolist()):
            crowd = np.linalg.norm(np.delete(at, j, axis=0) - at[j], axis=1)
            if order > 2 or crowd.min(initial=9) < 1:
                continue  # two spots on one place have no places of their own
            places[order].append(float(np.linalg.norm(offsets[j])))
            fluxes[order].append(float(shares[j] - 1))
    out = {}
    for order, name in ((1, "primary"), (2, "secondary")):
        out[f"{name} place, px rms"] = float(np.sqrt(np.mean(np.square(places[order])) / 2))
        out[f"{name} place, px worst"] = float(np.max(places[order]))
        out[f"{name} flux, relative"] = float(np.abs(fluxes[order]).max())
        out[f"{name} glints"] = len(places[order])
    return out


def outline(balls: int, rng: np.random.Generator) -> dict[str, float]:
    """A ball that mirrors nothing on a bright plate: its edge as drawn less the sphere's, by the optics' own slope."""
    camera = overhead()
    film = Film(camera, LAMP, [R], room=1.0, surface=Surface(steel=(2.95, 2.93), plate_texture=1e-9))
    film._uniforms |= {"metal": np.array([1.0, 1e-3]), "zenith": 0.0}  # refractive index of air: no reflection
    errors, shifts = [], []
    for _ in range(balls):
        centre = np.array([*rng.uniform([-0.023, -0.01], [0.023, 0.01]), R])
        (picture,) = film.frames(still(centre[None]), [[0.0, 0.0]])
        error, shift = reference.edge(camera, centre, R, 1 - picture.image / picture.plate)
        errors.append(error)
        shifts.append(shift)
    return {
        "outline, px rms": float(np.sqrt(np.mean(np.concatenate(errors) ** 2))),
        "outline's middle, px rms": float(np.sqrt(np.mean(np.square(shifts)))),
    }


def photon_transfer() -> dict[str, float]:
    """Gain, read noise, PRNU and DSNU of a 12-bit sensor from its flats and darks, by EMVA 1288 release 4.

    Gain: slope of the variance against the mean over pairs of flats (section 7). Non-uniformity: spatial variance of
    means of 200 frames, less the temporal variance over their number (section 8.2, 8.3).
    """
    sensor = Sensor(bits=12, gain=4.0, read_noise=10, black_level=60, dsnu=6, prnu=0.01, full_well=1e5, glint_peak=3000)
    size, many = (512, 512), 200
    chip = Chip(sensor, size, 5e-4, root_seed=1)

    def frame(level: float, clip: int, k: int) -> Array:
        return chip.expose(np.full(size[::-1], level, np.float32), clip, k).astype(float)

    means, variances = [], []
    for step, level in enumerate(np.linspace(0, 0.9, 13)):
        for pair in range(4):
            a, b = (frame(level, step, 2 * pair + k) for k in (0, 1))
            means.append((a + b).mean() / 2)
            variances.append(((a - b) ** 2).mean() / 2 - (a - b).mean() ** 2 / 2)
    slope, _ = np.polyfit(means, variances, 1)
    dark_noise = np.mean(variances[:4])
    stacks = {}
    for name, level, clip in (("dark", 0.0, 100), ("light", 0.5, 101)):
        total, square = np.zeros(size[::-1]), np.zeros(size[::-1])
        for k in range(many):
            one = frame(level, clip, k)
            total, square = total + one, square + one * one
        mean = total / many
        temporal = (square / many - mean**2).mean() * many / (many - 1)
        stacks[name] = (mean, mean.var() - temporal / many)
    (dark, dark_spatial), (light, light_spatial) = stacks["dark"], stacks["light"]
    first, other = frame(0.0, 200, 0), frame(0.0, 200, 1)
    late = np.mean([frame(0.0, 300, k) for k in range(60)], axis=0)
    return {
        "gain, relative": abs(1 / slope / sensor.gain - 1),
        "read noise, relative": abs(np.sqrt(dark_noise - 1 / 12) / slope / sensor.read_noise - 1),
        "PRNU, relative": abs(np.sqrt(light_spatial - dark_spatial) / (light.mean() - dark.mean()) / sensor.prnu - 1),
        "DSNU, relative": abs(np.sqrt(dark_spatial) / slope / sensor.dsnu - 1),
        "noise shared by two frames": abs(float(np.corrcoef((first - dark).ravel(), (other - dark).ravel())[0, 1])),
        "fixed pattern not shared by clips": 1 - _shared_pattern(dark, late, sensor, many, 60),
    }


def _shared_pattern(one: Array, other: Array, sensor: Sensor, n: int, m: int) -> float:
    """Correlation of two mean darks, corrected for the temporal noise left in them."""
    fixed = (sensor.dsnu / sensor.gain) ** 2
    left = [fixed + ((sensor.read_noise / sensor.gain) ** 2 + 1 / 12) / count for count in (n, m)]
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1] * np.sqrt(left[0] * left[1]) / fixed)


def speed(clips: int) -> dict[str, float]:
    """Whole `synthcam generate` with two workers: start-up, and what one more clip costs, by clock and by processor."""
    few, out = 4, {}
    seconds, processor = [], []
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder, "scene.yaml")
        scene.write_text(json.dumps(SCENE))
        for n in (few, few + clips):
            used, started = _children(), time.perf_counter()
            words = ["generate", str(scene), "-o", str(Path(folder, f"film{n}")), "--clips", str(n), "--workers", "2"]
            program = Path(sys.executable).with_name("synthcam")
            subprocess.run([program, *words], check=True, stdout=subprocess.DEVNULL)
            seconds.append(time.perf_counter() - started)
            processor.append(_children() - used)
    frames = 100 * clips
    out["generate: frames a second at the margin"] = frames / (seconds[1] - seconds[0])
    out["generate: processor ms a frame"] = 1e3 * (processor[1] - processor[0]) / frames
    out["generate: frames a second by processor time, two cores"] = 2 * frames / (processor[1] - processor[0])
    out["generate: ms for one more clip of 100 frames"] = 1e3 * (seconds[1] - seconds[0]) / clips
    out["generate: start-up, s"] = seconds[0] - few * (seconds[1] - seconds[0]) / clips
    return out


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def stock(frames: int = 12) -> dict[str, float]:
    """Our drawing, and stock pyrender's at the samples of our bodies and at 8 x 8, one process each, without noise."""
    found: dict[str, float] = {}
    for fine in (FINENESS, 8):
        words = [sys.executable, str(Path(__file__).with_name("stock_pyrender.py")), str(frames), str(fine)]
        found |= json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
    film = Film(overhead(), LAMP, [R, R])
    times = np.arange(100) / 250

    def roll(at: Array) -> Array:
        x, z = 0.1 * (at - 0.2), 0 * at + R
        first = np.stack([np.maximum(x, 0), 0 * x, z], -1)
        return np.stack([first, np.stack([np.minimum(x, 0.1 * x) - 2 * R, 0 * x, z], -1)], 1)

    best = np.inf
    for _ in range(3):
        started = time.process_time()
        for _ in film.frames(roll, np.c_[times, times + 5e-4], [0.2]):
            pass
        best = min(best, time.process_time() - started)
    return {"drawn alone: processor ms a frame": 1e3 * best / len(times)} | found


def main() -> None:
    parser = argparse.ArgumentParser(description="Truth and speed of the camera.")
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--clips", type=int, default=40)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "camera.json")
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    figures: dict[str, float] = glints(options.pairs, rng) | outline(20, rng) | photon_transfer()
    figures |= speed(options.clips) | stock()
    table = Table("figure", "value", "at most", "", title="512 x 256, .1 mm a pixel, two balls")
    good = True
    for name, value in figures.items():
        limit = LIMITS.get(name)
        good &= limit is None or value <= limit
        verdict = "" if limit is None else "ok" if value <= limit else "MISS"
        table.add_row(name, f"{value:.3g}", "" if limit is None else f"{limit:g}", verdict)
    console = Console(width=100)
    console.print(table)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    console.print(f"OpenGL: {gl_info()}; load before the end: {load:.1f}", highlight=False)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    document = {"figures": figures, "limits": LIMITS, "gl": gl_info(), "cores": os.cpu_count(), "load": load}
    options.output.write_text(json.dumps(document, indent=1) + "\n")
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
