"""The evidence that the analysis receives: tracks and a camera file, or the results of a tracker on a film."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from discrepancy.fitting.predict import collect_measurement_context
from synthcam.dataset.files import write_clip
from synthcam.scene.clip import Clip
from tracker.camera.camera import Camera, LampSettings

from . import worlds
from .boxes import NOISES, SCALE, Truth, camera_file, camera_of, clips_of, launch_of, model_of
from .integrator import Plate, collision, means
from .outsiders import moved

Array = NDArray[np.float64]


def prepare(truth: Truth, folder: Path) -> tuple[Path, Path | None]:
    """Write the evidence of a box into an empty folder: (tracks, camera), or (results, None) of a film."""
    folder.mkdir(parents=True, exist_ok=True)
    return (_film(truth, folder), None) if truth["source"] == "video" else _write_table(truth, folder)


def _write_table(truth: Truth, folder: Path) -> tuple[Path, Path]:
    clips = clips_of(truth)
    camera = camera_of(truth)
    rng = np.random.default_rng([truth["seed"], 1])
    tables = [_tracks(truth, clip, camera, rng) for clip in clips]
    path = folder / "tracks.parquet"
    pd.concat(tables).to_parquet(path, index=False)
    (folder / "camera.json").write_text(json.dumps(_believed_camera(camera_file(truth, clips[0]), truth["defect"])))
    return path, folder / "camera.json"


def _tracks(truth: Truth, clip: Clip, camera: Camera, rng: np.random.Generator) -> pd.DataFrame:
    """Visible balls of one clip with noise, px, in the columns of TRACKS."""
    if truth["source"] == "integrator":
        pixels, seen = integrate_tracks(truth, clip, camera)
    elif "by" in truth.get("world", {}):
        pixels, seen = _at_own_times(truth, clip, camera)
    else:
        pixels, seen = _by_synthcam(clip, camera)
    pixels = _add_tracker_defect(pixels.reshape(-1, 2), truth, camera).reshape(pixels.shape)
    pixels = pixels + noise_of(truth["noise"], clip.frames, rng) / SCALE
    if "world" in truth:
        return _hostile(truth, clip, pixels, seen, rng)
    frame, particle = np.tile(np.arange(clip.frames), 2), np.repeat([0, 1], clip.frames)
    return _rows(truth, clip, frame, particle, pixels.reshape(-1, 2))[seen.ravel()]


def _rows(truth: Truth, clip: Clip, frame: Any, particle: Any, pixels: Array) -> pd.DataFrame:
    std = NOISES[truth["noise"]].std / SCALE / truth["claimed"]
    columns = {"clip": clip.number, "frame": frame, "particle": particle}
    columns |= {"x": pixels[:, 0], "y": pixels[:, 1], "x_std": std, "y_std": std, "cov_xy": 0.0}
    return pd.DataFrame(columns | {"striker": clip.drawn["launch"]["striker"]})


def _at_own_times(truth: Truth, clip: Clip, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """As `_by_synthcam`, each frame as late as this world has it."""
    finer = worlds.FINER
    quick = dataclasses.replace(clip.camera, fps=finer * clip.camera.fps)
    pixels, seen = _by_synthcam(dataclasses.replace(clip, camera=quick, frames=finer * clip.frames), camera)
    late = worlds.late(truth["world"], clip.number, clip.frames, truth["seed"])
    rows = np.minimum(np.rint(finer * (np.arange(clip.frames) + late)).astype(int), pixels.shape[1] - 1)
    return pixels[:, rows], seen[:, rows]


def _hostile(truth: Truth, clip: Clip, pixels: Array, seen: worlds.Mask, rng: np.random.Generator) -> pd.DataFrame:
    """The table of a clip in a hostile world, with what a third ball leaves in it and its times, if uneven."""
    world, seed, number = truth["world"], truth["seed"], clip.number
    passing = worlds.third(world, number, pixels, seen, seed)
    there = seen & worlds.kept(world, number, pixels, seed)
    pixels = worlds.processed(world, pixels, there)
    frame = np.arange(clip.frames)
    parts = [(frame[s], np.full(s.sum(), k), p[s]) for k, (p, s) in enumerate(zip(pixels, there, strict=True))]
    if passing:
        path, taken = passing
        path = path + noise_of(truth["noise"], clip.frames, rng)[0] / SCALE
        parts[1][2][np.isin(parts[1][0], taken)] = path[np.intersect1d(parts[1][0], taken)]
        own = np.setdiff1d(np.flatnonzero(worlds.within(path, truth["size"])), taken)
        parts.append((own, np.full(len(own), 2), path[own]))
    table = _rows(truth, clip, *(np.concatenate(part) for part in zip(*parts, strict=True)))
    if "by" not in world:
        return table
    times = worlds.late(world, number, clip.frames, seed)
    return table.assign(t_s=(table["frame"] + times[table["frame"]]) / clip.camera.fps)


def _by_synthcam(clip: Clip, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Centres (2, frames, 2), px, means over the exposure, and whether a ball is in view (2, frames)."""
    table = clip.tracks
    pixels = table[["x_mean_px", "y_mean_px"]].to_numpy().reshape(2, clip.frames, 2)
    velocity = table[["vx", "vy"]].to_numpy().reshape(2, clip.frames, 2)
    place = camera.unproject(pixels)[0]
    shift = moved(clip.model.effects, place, velocity, clip.launch.bodies.of_a[:, None])
    if np.any(shift):
        pixels = _project(camera, place + shift)
    return pixels, table["visible"].to_numpy().reshape(2, clip.frames)


def integrate_tracks(truth: Truth, clip: Clip, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """The same by the integrator that shares nothing with synthcam's motion."""
    numbers = {"gravity": 9.81, "diameter": 2.38e-3, "density": 7800.0} | truth["base"] | truth["hidden"]
    opens = np.arange(clip.frames) / camera.fps
    end = clip.frames / camera.fps
    paths = collision(Plate(numbers), launch_of(clip), clip.drawn["launch"]["striker"] == "a", end)
    place = means(paths, opens, camera.exposure)
    half = np.array(camera.size) / 2 * SCALE - camera.radius
    return _project(camera, place), np.asarray((np.abs(place) < half).all(axis=-1))


def _project(camera: Camera, place: Array) -> Array:
    return np.asarray(camera.project(np.concatenate([place, np.full((*place.shape[:-1], 1), camera.radius)], axis=-1)))


def _add_tracker_defect(pixels: Array, truth: Truth, camera: Camera) -> Array:
    """Apply the defect of a tracker to centres (n, 2), px."""
    defect = truth["defect"]
    if "pixel_locking" in defect:
        return np.asarray(pixels - defect["pixel_locking"] * np.sin(2 * np.pi * pixels))
    if "glint" in defect:
        return camera.glint_of_centre(_on_plate(camera, pixels))
    if "lamp" in defect:
        wrong = dataclasses.replace(camera, lamp=_move_lamp(camera, defect["lamp"]))
        return wrong.centre_of_glint(camera.glint_of_centre(_on_plate(camera, pixels)))[0]
    bent = model_of(truth).laws("measure", pixels, collect_measurement_context(camera))
    return np.asarray(bent)


def _on_plate(camera: Camera, pixels: Array) -> Array:
    return camera.unproject(pixels)[0]


def _move_lamp(camera: Camera, by: float) -> LampSettings:
    assert camera.lamp is not None
    x, y, z = camera.lamp.position
    return dataclasses.replace(camera.lamp, position=(x + by, y + by, z + by))


def _believed_camera(known: dict[str, Any], defect: dict[str, float]) -> dict[str, Any]:
    """camera.json as an experimenter wrote it who is wrong about lamp or scale, or knows of no lamp."""
    if "scale" in defect:
        factor = 1 + defect["scale"]
        matrix = np.array(known["K"])
        matrix[:2, :2] /= factor
        known |= {"K": matrix.tolist(), "scale": known["scale"] * factor}
    if "lamp" in defect:
        place = [p + defect["lamp"] for p in known["lamp"]["position"]]
        known |= {"lamp": known["lamp"] | {"position": place}}
    return known


def noise_of(kind: str, frames: int, rng: np.random.Generator) -> Array:
    """(2, frames, 2), m: drawn from the covariance that the detection limit was worked out with."""
    noise = NOISES[kind]
    own = noise.std * _chain(rng, (2, frames, 2), noise.rho)
    return own + noise.shake * _chain(rng, (1, frames, 2), 0.9)


def _chain(rng: np.random.Generator, shape: tuple[int, int, int], rho: float) -> Array:
    out = rng.standard_normal(shape)
    for k in range(1, shape[1]):
        out[:, k] = rho * out[:, k - 1] + np.sqrt(1 - rho**2) * out[:, k]
    return out


def _film(truth: Truth, folder: Path) -> Path:
    """Film every clip, let the tracker look at the film alone, and keep what it says."""
    dataset, results, secret = folder / "film", folder / "results", folder / "truth"
    for clip in clips_of(truth):
        place = dataset / f"clips/{clip.number:06d}"
        write_clip(place, clip, clip.pictures(), secret / f"{clip.number:06d}")
        known = _believed_camera(json.loads((place / "camera.json").read_text()), truth["defect"])
        if "glint" in truth["defect"]:
            known.pop("lamp")  # without it a tracker has nothing but the glint
        (place / "camera.json").write_text(json.dumps(known))
    shutil.rmtree(secret)
    command = [str(Path(sys.executable).with_name("tracker")), "track", str(dataset), "-o", str(results)]
    done = subprocess.run(
        [*command, "--workers", "1"], capture_output=True, text=True, env=isolated_environment(), check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr.strip())
    shutil.rmtree(dataset)
    return results


def isolated_environment() -> dict[str, str]:
    """An environment in which numpy keeps to one core."""
    return os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
