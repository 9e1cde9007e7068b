"""Error bars where the camera file is wrong by its errors: figures for the gate.

Each case measures collisions of known motion from true centres with noise. A figure NAME.rms_z is the root mean square
of error / claimed standard error, which is 1 where error bars are true. NAME.errors counts the errors in it.
`wrong_camera` has those of all wrong keys.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import synthcam
from synthcam.scene.clip import Clip
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks, to_centres
from tracker.measurement.estimate import fit_all_jointly, measure

Floats = NDArray[np.float64]

NOISE_PX = 0.015
CLIPS = 24  # of each wrong key
SHARE = 0.004  # standard error of a key of the camera file, relative
# quantities in whose standard errors the key has a part
TOUCHED = {"scale": ("v0", "r", "mu_k", "C", "tau1"), "fps": ("v0", "mu_k", "tau1")}
TOUCHED |= {"ball_diameter": ("b", "r", "mu_k", "C", "tau1"), "lamp": ("v0", "b")}
LAMP_HEIGHT_M, LAMP_ERROR_M = 0.12, 0.008
CAMERAS, CLIPS_OF_EACH = 12, 6
ENCODED_NOISE_PX, LASTING_PX, LASTING_FRAMES = 0.1, 0.1 * 0.05**0.5, 30  # as H.264 at crf 28 shifts glints
# quantities of such a film; two in six are independent of the others
OF_ENCODED = ("v0", "r", "mu_k", "tau1", "tau2", "energy_fraction")

SHAKEN = {
    "model": {
        "restitution": {"uniform": [0.75, 0.98]},
        "spin_transfer": {"uniform": [0.1, 0.36]},
        "sliding_friction": {"uniform": [0.12, 0.35]},
    },
    "launch": {"v0": {"uniform": [0.1, 0.6]}, "b": {"uniform": [-0.3, 0.3]}, "heading": {"uniform": [0, 6.2832]}},
    "timing": {"contact_frame": {"uniform": [20, 30]}},
}


def follow_centres(clip: Clip, rng: np.random.Generator, noise_px: float = NOISE_PX) -> Tracks:
    """Tracks of the true centres of a clip, off by noise that they claim."""
    seen = clip.tracks[clip.tracks["visible"]].sort_values(["particle", "frame"])
    x, y = (seen[["x_mean_px", "y_mean_px"]].to_numpy() + rng.normal(0, noise_px, (len(seen), 2))).T
    frame, particle = (seen[name].to_numpy(np.int64) for name in ("frame", "particle"))
    cov = np.broadcast_to(noise_px**2 * np.eye(2), (len(seen), 2, 2))
    flux = np.full(len(seen), 1250.0)  # counts of a glint
    return Tracks(frame, particle, x, y, cov, flux, np.full(len(seen), ""), x, y)


def doubt_key(camera: Camera, key: str, off: float) -> Camera:
    """The camera as a person knows it: one key wrong by `off` of the standard errors that are given for it."""
    given = {name: getattr(camera, name) for name in ("size", "exposure", "striker", "scale", "fps", "ball_diameter")}
    given[key] *= 1 + SHARE * off
    return Camera.from_dict(given | {f"{key}_std": SHARE * given[key]})


def measure_by_wrong_key(clips: list[Clip], key: str, rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    """A row for each clip, measured by a camera file in which a key is wrong by its error."""
    for clip in clips:
        camera = doubt_key(Camera.of(clip.camera_json), key, rng.normal())
        yield measure(follow_centres(clip, rng), camera)[0]


def measure_by_wrong_lamp(clips: list[Clip], rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    """A row for each clip whose glints are of one lamp, taken to centres by another that was measured."""
    for clip in clips:
        position = (0.01, -0.01, LAMP_HEIGHT_M)
        lamp = {"position": position, "position_std": [LAMP_ERROR_M] * 3}
        told = Camera.from_dict({**clip.camera_json, "lamp": lamp})
        real = {"position": (position + rng.normal(0, LAMP_ERROR_M, 3)).tolist()}
        true = Camera.from_dict({**clip.camera_json, "lamp": real})
        tracks = follow_centres(clip, rng)
        x, y = true.glint_of_centre(true.unproject(np.column_stack([tracks.x, tracks.y]))[0]).T
        seen = Tracks(**vars(tracks) | {"x": x, "y": y})
        yield measure(to_centres(seen, told), told)[0]


def fit_clips_of_each_camera(clips: list[Clip], rng: np.random.Generator) -> Floats:
    """z of mu_k and of its mean in the joint fits of some cameras, whose clips share one wrong frame rate."""
    z = []
    for number in range(CAMERAS):
        off, rows = rng.normal(), []
        for clip in clips[number * CLIPS_OF_EACH : (number + 1) * CLIPS_OF_EACH]:
            rows += measure(follow_centres(clip, rng), doubt_key(Camera.of(clip.camera_json), "fps", off))
        fit, true = fit_all_jointly(pd.DataFrame(rows)), clips[0].truth["mu_k"]
        mean = fit["scatter"]["mu_k"]
        found = [fit["chi2"]["mu_k"], mean["mean"]], [fit["chi2"]["mu_k_std"], mean["std"]]
        value, std = np.array(found, dtype=float)  # None, of clips that claim nothing, is NaN
        z.append((value - true) / std)
    return np.array(z)


def summarise(name: str, z: Floats, *, min_share: float = 0.6) -> dict[str, float]:
    """The figures of one quantity from its errors over the claimed ones; NaN if fewer than `min_share` are claimed."""
    known = z[np.isfinite(z)]
    rms = float(np.sqrt(np.mean(known**2))) if len(known) >= min_share * len(z) else np.nan
    return {f"{name}.rms_z": rms, f"{name}.errors": float(max(len(known), 1))}


def pool(figures: dict[str, float]) -> dict[str, float]:
    """The root mean square of all z of wrong camera files together; the quantities of one clip count as one error."""
    names = [name.removesuffix(".rms_z") for name in figures if name.startswith("wrong_") and name.endswith(".rms_z")]
    cases = {name.partition(".")[0] for name in names}
    squares = [figures[f"{name}.rms_z"] ** 2 for name in names]
    return {"wrong_camera.rms_z": float(np.sqrt(np.mean(squares))), "wrong_camera.errors": float(len(cases) * CLIPS)}


def compare_with_truth(case: str, names: tuple[str, ...], rows: Iterator[dict[str, Any]], clips: list[Clip]) -> Any:
    """The figures of some quantities of one case, of both fits.

    NAME.without_camera, of the first quantity, is the rms of z without the errors of the camera file, and shows that
    they are needed.
    CASE.spread is chi^2 over the degrees of freedom, whose number is CASE.errors.
    """
    pairs = list(zip(rows, (clip.truth for clip in clips), strict=True))
    figures: dict[str, float] = {}
    for name in (f"{quantity}{fit}" for fit in ("", "_free") for quantity in names):
        off = np.array([row[name] - truth[name.removesuffix("_free")] for row, truth in pairs], dtype=float)
        figures |= summarise(f"{case}.{name}", off / np.array([row[f"{name}_std"] for row, _ in pairs], dtype=float))
    off = np.array([row[names[0]] - truth[names[0]] for row, truth in pairs], dtype=float)
    own = np.array([find_own_error(row, names[0]) for row, _ in pairs])
    figures[f"{case}.{names[0]}.without_camera"] = float(np.sqrt(np.nanmean((off / own) ** 2)))
    dof = sum(row["dof"] for row, _ in pairs)
    return figures | {f"{case}.spread": sum(row["chi2"] for row, _ in pairs) / dof, f"{case}.errors": float(dof)}


def find_own_error(row: dict[str, Any], name: str) -> float:
    """The standard error of a quantity of the tied fit without the part of the camera file."""
    table = json.loads(row["cov"])
    at = table["names"].index(name)
    shared = sum(part["tied"][at] ** 2 for part in table.get("shared", {}).values())
    return float(np.sqrt(max(row[f"{name}_std"] ** 2 - shared, 0.0)))


def measure_encoded(clips: list[Clip], rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    """A row for each clip with positions as of an encoded film: a part of their errors lasts for some 30 frames."""
    for clip in clips:
        tracks, camera = follow_centres(clip, rng, ENCODED_NOISE_PX), Camera.of(clip.camera_json)
        shift = rng.normal(0, LASTING_PX, (len(tracks.frame), 2))
        kept = np.exp(-1 / LASTING_FRAMES)
        for k in np.flatnonzero(np.diff(tracks.particle) == 0) + 1:
            shift[k] = kept * shift[k - 1] + np.sqrt(1 - kept**2) * shift[k]
        moved = replace(tracks, x=tracks.x + shift[:, 0], y=tracks.y + shift[:, 1])
        yield measure(moved, replace(camera, sensor=replace(camera.sensor, codec_noise=3.0)))[0]


def measure_error_bars(seed: int) -> dict[str, float]:
    """All figures, some 20 seconds of work."""
    rng, scene = np.random.default_rng(seed), synthcam.Scene.build("shaken", **SHAKEN)
    clips = [scene.draw(number, seed) for number in range(CLIPS)]
    figures: dict[str, float] = {}
    for key in ("scale", "fps", "ball_diameter"):
        rows = measure_by_wrong_key(clips, key, rng)
        figures |= compare_with_truth(f"wrong_{key}", TOUCHED[key], rows, clips)
    rows = measure_by_wrong_lamp(clips, rng)
    figures |= compare_with_truth("wrong_lamp", TOUCHED["lamp"], rows, clips)
    figures |= pool(figures)
    rows = measure_encoded([*clips, *clips], rng)
    encoded = compare_with_truth("encoded", OF_ENCODED, rows, [*clips, *clips])
    squares = [encoded[f"encoded.{name}.rms_z"] ** 2 for name in OF_ENCODED]
    figures |= {"encoded.rms_z": float(np.sqrt(np.mean(squares))), "encoded.errors": 2.0 * len(squares) * CLIPS / 3}
    same = synthcam.Scene.build("same", **{name: part for name, part in SHAKEN.items() if name != "model"})
    shared = fit_clips_of_each_camera([same.draw(number, seed) for number in range(CAMERAS * CLIPS_OF_EACH)], rng)
    for name, z in zip(("mu_k", "mu_k_mean"), shared.T, strict=True):
        figures |= summarise(f"one_camera.{name}", z)
    return figures
