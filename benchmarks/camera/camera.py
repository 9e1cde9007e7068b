"""How true and how fast is the camera? Pictures against float64 rays, noise against EMVA 1288, frames a second.

python -m benchmarks.camera.camera [--pairs 60] [--balls 12] [--clips 60] [-o out/camera.json]    about three minutes
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import synthcam
from benchmarks.camera import camera_reference
from benchmarks.harness import ROOT, run, save
from synthcam.camera import reflections
from synthcam.camera.exposure import Picture
from synthcam.camera.glints import find_glints
from synthcam.camera.lamp import Lamp
from synthcam.camera.pinhole import PinholeCamera
from synthcam.camera.render import FINENESS, MirrorRenderer, gl_info
from synthcam.camera.sensor import Sensor, SensorChip
from synthcam.camera.surface import IRON_N_K, Surface

BLACK = {"metal": np.array([1.0, 1e-9]), "zenith": 0.0}  # the refractive index of air: no reflection
Array = NDArray[np.float64]
R = 1.19e-3
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)
SCENE = {
    "name": "camera-benchmark",
    "camera": {"size": [512, 256], "scale": 1.0e-4},
    "launch": {"v0": {"uniform": [0.1, 0.6]}, "b": {"uniform": [-0.3, 0.3]}, "heading": {"uniform": [0, 6.2832]}},
    "timing": {"contact_frame": {"uniform": [20, 30]}},
}
AT_MOST = {
    "primary place, px rms": 0.002,
    "primary flux, relative": 0.01,
    "secondary place, px rms": 0.01,
    "secondary flux, relative": 0.02,
    "flux of a pair's glints as drawn, relative": 0.01,
    "light between mirrors": 0.01,  # at each gap
    "crowd, primary place": 0.003,
    "crowd, secondary place": 0.003,
    "crowd of 100": 80.0,  # 25 frames a second on two cores
    "outline": 0.005,  # of each case
    "gain, relative": 0.02,
    "read noise, relative": 0.02,
    "PRNU, relative": 0.02,
    "DSNU, relative": 0.02,
    "noise shared by two frames": 0.01,
    "fixed pattern not shared by clips": 0.02,
}
AT_LEAST = {"generate: frames a second at the margin": 1000.0, "generate: faster than the experiment ran": 4.0}
FPS, FRAMES = 250, 100  # of a clip


def overhead(**changes: Any) -> PinholeCamera:
    settings: dict[str, Any] = {"size": (512, 256), "scale": 1e-4, "height": 0.5, "ball_radius": R}
    return PinholeCamera.overhead(**settings | {"fps": 250, "exposure": 5e-4, "psf_sigma_px": 1.0} | changes)


def still(centres: Array) -> Any:
    return lambda times: np.broadcast_to(centres, (len(times), *centres.shape))


def glints(pairs: int, rng: np.random.Generator) -> dict[str, float]:
    """Pairs at contact and apart, anywhere in view: places as drawn and fluxes as found less those traced.

    Glints of three and more reflections overlap those of two. So only their sum shows the flux that is drawn.
    """
    film = MirrorRenderer(overhead(), LAMP, [R, R], room=0.0)
    positions: dict[int, list[float]] = {1: [], 2: []}
    fluxes: dict[int, list[float]] = {1: [], 2: []}
    sums: list[float] = []
    for k in range(pairs):
        gap = 2 * R * (1 if k % 2 else 1 + rng.exponential(0.3))
        turn = rng.uniform(0, 2 * np.pi)
        middle = rng.uniform([-0.021, -0.009], [0.021, 0.009])
        half = gap / 2 * np.array([np.cos(turn), np.sin(turn)])
        centres = np.array([[*(middle - half), R], [*(middle + half), R]])
        (picture,) = film.frames(still(centres), [[0.0, 0.0]])
        image: Array = (picture.image - picture.plate).astype(float) / film._unit
        near = find_glints(film.camera, LAMP, centres[None], film.radii, np.ones((1, 2), bool))
        traced = [
            camera_reference.lamp_image(film.camera, LAMP, centres, film.radii, pixel, int(order))
            for pixel, order in zip(near.pixels, near.order, strict=True)
        ]
        spots = [camera_reference.spot(film.camera, image.shape, *found) for found in traced]
        at = np.array([position for position, _, _ in traced])
        offsets = camera_reference.separate(image, spots, at)
        sums.append(image.sum() / sum(flux for _, flux, _ in traced) - 1)
        for j, order in enumerate(near.order.tolist()):
            crowd = np.linalg.norm(np.delete(at, j, axis=0) - at[j], axis=1)
            if order > 2 or crowd.min(initial=9) < 1:
                continue  # spots that overlap have no centres of their own
            positions[order].append(float(np.linalg.norm(offsets[j])))
            fluxes[order].append(float(near.flux[j] / traced[j][1] - 1))
    out = {}
    for order, name in ((1, "primary"), (2, "secondary")):
        out[f"{name} place, px rms"] = float(np.sqrt(np.mean(np.square(positions[order])) / 2))
        out[f"{name} place, px worst"] = float(np.max(positions[order]))
        out[f"{name} flux, relative"] = float(np.abs(fluxes[order]).max())
        out[f"{name} glints"] = len(positions[order])
    return out | {"flux of a pair's glints as drawn, relative": float(np.abs(sums).max())}


def crowd(rng: np.random.Generator) -> dict[str, float]:
    """A crowd of steel balls: glints less those traced, and what a frame of 100 balls costs."""
    camera, found = overhead(size=(1024, 1024)), synthcam.Scene.read("cooling").draw(0, int(rng.integers(1 << 30)))
    centres = found.view.at(np.zeros(1))[:, 0, :3]
    radii = found.launch.bodies.radius
    near = find_glints(camera, LAMP, centres[None], radii, np.ones((1, len(radii)), bool))
    chosen = np.flatnonzero(near.flux > 1e-3 * near.flux[near.order == 1].mean())
    off: dict[int, list[tuple[float, float]]] = {1: [], 2: [], 3: []}
    for k in rng.permutation(chosen)[:200].tolist():
        order = int(near.order[k])
        around = np.argsort(np.linalg.norm(centres - centres[near.ball[k]], axis=1))[:40]
        true = camera_reference.lamp_image(camera, LAMP, centres[around], radii[around], near.pixels[k], order)
        off.setdefault(order, []).append((float(np.linalg.norm(near.pixels[k] - true[0])), near.flux[k] / true[1] - 1))
    out: dict[str, float] = {}
    for order, name in ((1, "primary"), (2, "secondary"), (3, "tertiary")):
        at, bright = np.array(off[order]).reshape(-1, 2).T
        out |= {f"crowd, {name} place, px worst": at.max(initial=0), f"crowd, {name} glints": len(at)}
        out[f"crowd, {name} flux, relative"] = np.abs(bright).max(initial=0)
    frames, taken = 60, np.inf
    for _ in range(3):
        started = time.process_time()
        for _ in islice(found.pictures(), frames):
            pass
        taken = min(taken, (time.process_time() - started) / frames)
    return out | {"crowd of 100, 1024 x 1024: processor ms a frame": 1e3 * taken}


def thrown(pairs: int, rng: np.random.Generator) -> dict[str, float]:
    """Light that two balls throw on each other, by any number of bounces, over what rays bring of 2 to 9, less one."""
    camera, radii, out = overhead(), np.full(2, R), {}
    for gap in (0.0, 0.01, 0.05, 0.1, 0.2):
        off = []
        for _ in range(max(2, pairs // 20)):
            start = together(1, rng)[0]
            centres = np.array([start, start + (2 + gap) * R * direction(rng)])
            found = find_glints(camera, LAMP, centres[None], radii, np.ones((1, 2), bool))
            brought = 0.0
            for order in range(2, 10):
                ends = np.array([[(k + end) % 2 for k in range(order)] for end in (0, 1)])
                paths = reflections.reflect(LAMP.position, camera.centre, centres[ends], np.full((2, order), R))
                for start_at in camera.project(paths.points[paths.exists, -1]):  # where to look, no more
                    brought += camera_reference.lamp_image(camera, LAMP, centres, radii, start_at, order)[1]
            off.append(found.flux[found.order > 1].sum() / brought - 1)
        out[f"light between mirrors {gap:g} R apart, relative"] = float(np.abs(off).max())
    return out


def outline(balls: int, rng: np.random.Generator) -> dict[str, float]:
    """Edges of balls that mirror nothing, on a bright plate, less the spheres' own: in each way that films take."""
    even, drawn_plate = Surface(steel=IRON_N_K), Surface(steel=IRON_N_K, plate_texture=1e-9)
    cases: dict[str, tuple[dict[str, Any], Surface, int, float]] = {  # camera, surface, balls, travel in px
        "even plate": ({}, even, 1, 0.0),
        "drawn plate": ({}, drawn_plate, 1, 0.0),
        "pairs at contact": ({}, even, 2, 0.0),
        "pairs, drawn plate": ({}, drawn_plate, 2, 0.0),
        "moving 3 px": ({}, even, 1, 3.0),
        "moving 12 px": ({}, even, 1, 12.0),
        "tilted, distorted": ({"tilt": (0.15, -0.1), "distortion": (-0.2, 0.1, 1e-3, 1e-3, 0)}, even, 1, 0.0),
        "defocused by 2 px": ({"defocus_px": 2.0}, even, 1, 0.0),
        "rolling shutter": ({"line_time": 1e-5}, even, 1, 1.5),
    }
    out = {}
    for name, (settings, surface, many, travel) in cases.items():
        camera = overhead(**settings)
        film = MirrorRenderer(camera, LAMP, [R] * many, room=1.0, surface=surface)
        film._uniforms |= BLACK
        film._unit = 0.0
        errors = []
        for _ in range(balls if not travel else -(-balls // 4)):
            start, way = together(many, rng), travel * camera.scale * direction(rng)
            path = moving(start, way / camera.exposure)
            (picture,) = film.frames(path, [[0.0, camera.exposure if travel else 0.0]])
            nodes, weights = np.polynomial.legendre.leggauss(3 + int(2 * travel))
            times, shares = ((nodes + 1) / 2 * camera.exposure, weights / 2) if travel else (np.zeros(1), np.ones(1))
            bottom = camera.size[1] * camera.line_time
            low, high = camera_reference.window(camera, np.concatenate(path(np.array([0.0, camera.exposure + bottom]))))
            anchors = np.arange(low[1], high[1] + 3, 3) if camera.line_time else np.zeros(1)
            seen = [
                np.tensordot(
                    shares,
                    [camera_reference.hidden(camera, c, R, low, high, camera.defocus_px) for c in path(times + late)],
                    axes=1,
                )
                for late in anchors * camera.line_time
            ]
            true: Array = seen[0] if len(seen) == 1 else by_rows(anchors - low[1], seen)
            drawn = np.asarray(1 - picture.image / picture.plate, dtype=float)[low[1] : high[1], low[0] : high[0]]
            errors.append(camera_reference.displaced(drawn, true))
        out[f"outline, {name}, px rms"] = rms(np.concatenate(errors))
    return out


def by_rows(anchors: Array, pictures: list[Array]) -> Array:
    """Row r of the picture that is interpolated at r between those of the anchors."""
    rows = np.arange(len(pictures[0]))
    before = np.minimum(np.searchsorted(anchors, rows, "right") - 1, len(anchors) - 2)
    share = ((rows - anchors[before]) / np.diff(anchors)[before])[:, None]
    stack = np.stack(pictures)
    return np.asarray((1 - share) * stack[before, rows] + share * stack[before + 1, rows])


def lit_outline(balls: int, rng: np.random.Generator) -> dict[str, float]:
    """Lines of equal light at the rim of a ball that mirrors its room, less those of float64 rays."""
    film = MirrorRenderer(overhead(), LAMP, [R], room=1.0)
    film._unit = 0.0
    errors = []
    for _ in range(balls):
        centres = together(1, rng)
        (picture,) = film.frames(still(centres), [[0.0, 0.0]])
        low, high = camera_reference.window(film.camera, centres)
        dark = 0.05 * (LAMP.position[2] ** 2 / np.sum((LAMP.position - centres * [1, 1, 0]) ** 2, axis=1)) ** 2
        true = camera_reference.lit(film.camera, centres, film.radii, dark, 1.0, (low, high))
        drawn = np.asarray(picture.image - picture.plate, dtype=float)[low[1] : high[1], low[0] : high[0]]
        across, down = np.meshgrid(*[np.arange(a, b) for a, b in zip(low, high, strict=True)])
        at = film.camera.project(centres[0])
        rim = np.abs(np.hypot(across - at[0], down - at[1]) - R / film.camera.scale) < 1.5
        errors.append(camera_reference.displaced(drawn, true, rim))
    return {"outline, as lit, px rms": rms(np.concatenate(errors))}


def together(many: int, rng: np.random.Generator) -> Array:
    """A ball anywhere in view, or that and others in a row at contact."""
    first = np.array([*rng.uniform([-0.02, -0.008], [0.02, 0.008]), R])
    return first + 2 * R * np.arange(many)[:, None] * direction(rng)


def direction(rng: np.random.Generator) -> Array:
    turn = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(turn), np.sin(turn), 0.0])


def moving(start: Array, velocity: Array) -> Callable[[Array], Array]:
    return lambda times: start + times[:, None, None] * velocity


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def photon_transfer() -> dict[str, float]:
    """Gain, read noise, PRNU and DSNU of a 12-bit sensor from its flats and darks, by EMVA 1288 release 4.

    Gain: slope of the variance against the mean over pairs of flats (section 7). Non-uniformity: spatial variance of
    means of 200 frames, less the temporal variance over their number (section 8.2, 8.3).
    """
    sensor = Sensor(bits=12, gain=4.0, read_noise=10, black_level=60, dsnu=6, prnu=0.01, full_well=1e5, glint_peak=3000)
    size, many = (512, 512), 200
    chip = SensorChip(sensor, size, 5e-4, root_seed=1)

    def frame(level: float, clip: int, k: int) -> Array:
        plate = np.full(size[::-1], level, np.float32)
        return chip.expose(plate if level else Picture(plate, (), ()), clip, k).astype(float)  # by pixel, or by tables

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
    """Whole `synthcam generate` with two workers: start-up, and what one more clip costs, by clock and by processor.

    Each of two runs, of few and of many clips, is made twice and the better one counts.
    """
    few = 4
    runs = dict.fromkeys((few, few + clips), (np.inf, np.inf))
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder, "scene.yaml")
        scene.write_text(json.dumps(SCENE))
        for n in [*runs, *runs]:
            used, started = _children(), time.perf_counter()
            dataset = Path(folder, "film")
            run("synthcam", "generate", scene, "-o", dataset, "--clips", str(n), "--workers", "2", quiet=True)
            taken = time.perf_counter() - started, _children() - used
            runs[n] = min(runs[n][0], taken[0]), min(runs[n][1], taken[1])
            shutil.rmtree(dataset)
    (start, start_work), (end, end_work) = runs.values()
    clip, work = (end - start) / clips, (end_work - start_work) / clips
    return {
        "generate: start-up, s": start - few * clip,
        "generate: start-up, processor s": start_work - few * work,
        "generate: ms for one more clip of 100 frames": 1e3 * clip,
        "generate: frames a second at the margin": FRAMES / clip,
        "generate: faster than the experiment ran": FRAMES / clip / FPS,
        "generate: processor ms a frame": 1e3 * work / FRAMES,
        "generate: frames a second by processor time, two cores": 2 * FRAMES / work,
    }


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def stock(frames: int = 12) -> dict[str, float]:
    """Our drawing, and stock pyrender's at the samples of our bodies and at 8 x 8, one process each, without noise."""
    found: dict[str, float] = {}
    positions = []
    for fine in (FINENESS, 8):
        words = [sys.executable, str(Path(__file__).with_name("stock_pyrender.py")), str(frames), str(fine)]
        told = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
        positions.append(told.pop("places"))
        found |= told
    found[f"stock pyrender, {FINENESS} x {FINENESS} samples: highlight off that of 8 x 8, px rms"] = rms(
        np.subtract(*positions)
    )
    film = MirrorRenderer(overhead(), LAMP, [R, R])
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
    return {"ours, drawn alone: processor ms a frame": 1e3 * best / len(times)} | found


def goal(name: str) -> tuple[str, float]:
    if name in AT_LEAST:
        return "at least", AT_LEAST[name]
    kind = next((start for start in AT_MOST if name.startswith(start)), name)
    return ("at most", AT_MOST[kind]) if kind in AT_MOST else ("", np.nan)


def main() -> None:
    parser = argparse.ArgumentParser(description="Truth and speed of the camera.")
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--balls", type=int, default=12)
    parser.add_argument("--clips", type=int, default=60)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "camera.json")
    options = parser.parse_args()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else np.nan
    figures = speed(options.clips)  # first, while this process holds nothing
    figures |= stock()
    rng = np.random.default_rng(0)
    figures |= (
        glints(options.pairs, rng)
        | crowd(rng)
        | thrown(options.pairs, rng)
        | outline(options.balls, rng)
        | lit_outline(options.balls, rng)
    )
    figures |= photon_transfer()
    table = Table("figure", "value", "goal", "", title="512 x 256, .1 mm a pixel, two balls")
    missed = []
    for name, value in figures.items():
        which, limit = goal(name)
        good = not which or (value >= limit if which == "at least" else value <= limit)
        missed += [] if good else [name]
        table.add_row(name, f"{value:.3g}", *([f"{which} {limit:g}", "ok" if good else "MISS"] if which else []))
    console = Console(width=110)
    console.print(table)
    console.print(f"OpenGL: {gl_info()}; {os.cpu_count()} cores, load before the start: {load:.1f}", highlight=False)
    goals = {name: goal(name) for name in figures if goal(name)[0]}
    document = {"figures": figures, "goals": goals, "gl": gl_info(), "cores": os.cpu_count(), "load": load}
    save(options.output, document)
    sys.exit(f"missed: {', '.join(missed)}" if missed else 0)


if __name__ == "__main__":
    main()
