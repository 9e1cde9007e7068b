"""Milliseconds of processor time a frame, one core: this tracker, trackpy, SimpleBlobDetector and HoughCircles.

python -m benchmarks.tracker.pace [-o out/pace.json]        # or make bench-pace

All four get the same films of two matte discs or of glints, drawn here, in the same run. The glints are filmed twice:
in a short film, most of whose time is that of the collision, and in one of 300 frames. The time of this tracker is
that of the whole chain: choice of the detector, background, detection, linking and fits. The time of the others is
that of the call for each frame alone, on every fourth or thirtieth frame. A ball counts as found if a position is
within half a radius of the true one. A line for each film says how the time of this tracker is spent.
"""

from __future__ import annotations

import argparse
import importlib
import os
import time
import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.harness import ROOT, save
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene
from synthcam_shared.jobs import use_one_thread
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import Recording
from tracker.detection.choose import select_detector
from tracker.detection.detect import detect_until_blur_converges, find_detected_point, make_view
from tracker.detection.link import link_into_tracks
from tracker.recording import measure_clip, track_and_measure

# width, height, diameter of a ball (px), frames, speed of the striker (m/s)
DISCS = {
    "discs of 60 px, 1920 x 1080": (1920, 1080, 60, 120, 1.0),
    "discs of 100 px, 1920 x 1080": (1920, 1080, 100, 120, 0.7),
    "discs of 110 px, 3840 x 2160": (3840, 2160, 110, 60, 2.0),
}
trackpy: Any = importlib.import_module("trackpy")  # it has no types
GLINTS = {"glints, 640 x 480, 100 frames": 100, "glints, 640 x 480, 300 frames": 300}
DIAMETER = 0.04  # m


def draw_discs(width: int, height: int, px: int, count: int, speed: float) -> tuple[Any, dict[str, Any], Any]:
    """Frames, camera.json and true places (2, frames, 2): a texture that never moves, shot and read noise."""
    scene = Scene.read(
        "matte_white",
        ball={"diameter": DIAMETER},
        launch={"v0": speed, "b": 0.2, "heading": 0.3, "contact": [0, 0]},
        timing={"fps": 250, "frames": count, "exposure": 1e-3, "contact_frame": count // 3},
        camera={"size": [width, height], "scale": DIAMETER / px, "height": 4.0, "psf_sigma_px": 0.8},
    )
    clip, rng = scene.draw(0, seed=0), np.random.default_rng(0)
    ground = 70 + 120 * gaussian_filter(rng.standard_normal((height, width), dtype=np.float32), 3)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    places, pictures = read_places(clip), []
    for k in range(count):
        light = ground.copy()
        for column, row in places[:, k]:
            at = tuple(slice(max(int(c) - px, 0), max(int(c) + px, 0)) for c in (row, column))
            away = np.hypot(x[at] - column, y[at] - row)
            light[at] += (200 - light[at]) * np.clip((px / 2 - away) / 2 + 0.5, 0, 1)  # an edge of 2 px
        light += rng.standard_normal(light.shape, dtype=np.float32) * np.sqrt(2 + 0.03 * light)
        pictures.append(np.clip(np.rint(light), 0, 255).astype(np.uint8))
    return np.array(pictures), clip.camera_json, places


def draw_glints(count: int) -> tuple[Any, dict[str, Any], Any]:
    """The same of glints of steel balls, 640 x 480, as `synthcam generate` makes them."""
    clip = Scene.read("painter_behringer", timing={"frames": count}).draw(0, seed=0)
    return np.array(list(clip.pictures())), clip.camera_json, read_places(clip)


def read_places(clip: Clip) -> Any:
    """True centres (balls, frames, 2), px; NaN where a ball is out of the picture."""
    table = clip.tracks.pivot(index="particle", columns="frame")
    places = np.stack([table[name].to_numpy() for name in ("x_mean_px", "y_mean_px")], axis=-1)
    inside = np.all((places > -0.5) & (places < np.array(clip.camera_json["size"]) - 0.5), axis=-1)
    places[~np.asarray(inside)] = np.nan
    return places


def time_frames(locate: Callable[[Any], Any], frames: Any) -> tuple[float, list[Any]]:
    """Milliseconds a frame, and the places (n, 2) of each."""
    locate(frames[0][:200, :200])  # loads libraries
    began = time.process_time()
    found = [locate(frame) for frame in frames]
    return 1e3 * (time.process_time() - began) / len(frames), found


def track(frames: Any, camera: dict[str, Any]) -> tuple[float, list[Any]]:
    """The same of this tracker, from frames to fits; the second run counts, because the first loads libraries."""
    for _ in range(2):
        clip = Recording(0, Camera.from_dict(camera), wrap_frames(frames))
        began = time.process_time()
        tracks = track_and_measure(clip).tracks
        spent = time.process_time() - began
    of_frames = [tracks[tracks.frame == k][["x", "y"]].to_numpy() for k in range(len(frames))]
    return 1e3 * spent / len(frames), of_frames


def time_stages(frames: Any, camera: dict[str, Any]) -> dict[str, float]:
    """Milliseconds of processor time a frame of each stage of this tracker."""
    clip, marks = Recording(0, Camera.from_dict(camera), wrap_frames(frames)), [time.process_time()]
    name = select_detector(clip).name
    marks.append(time.process_time())
    found, view = detect_until_blur_converges(clip, make_view(clip, name), name)
    marks.append(time.process_time())
    tracks = link_into_tracks(found.glints, view.camera, find_detected_point(name, clip.camera))
    marks.append(time.process_time())
    measure_clip(tracks, view.camera)
    marks.append(time.process_time())
    names = ("choice", "detection", "linking", "fits")
    return {name: round(1e3 * (b - a) / len(frames), 2) for name, (a, b) in zip(names, pairwise(marks), strict=True)}


def make_peers(px: float, glints: bool) -> dict[str, Callable[[NDArray[Any]], Any]]:
    """The other programs with the size of what they look for, px."""
    opencv: Any = cv2  # its stubs lack SimpleBlobDetector_Params
    options = opencv.SimpleBlobDetector_Params()
    options.filterByColor, options.blobColor, options.filterByArea = True, 255, True
    options.filterByCircularity = options.filterByConvexity = options.filterByInertia = False
    options.minArea, options.maxArea = (3.0, 500.0) if glints else (0.2 * px**2, 2.0 * px**2)
    options.minThreshold, options.maxThreshold, options.thresholdStep = (20, 250, 20) if glints else (110, 190, 20)
    options.minRepeatability, options.minDistBetweenBlobs = 1, px / 2
    finder = opencv.SimpleBlobDetector_create(options)
    width = 7 if glints else int(px) // 2 * 2 + 1
    radii = (1, 6) if glints else (int(0.4 * px), int(0.6 * px))

    def find_features(frame: Any) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return trackpy.locate(frame, width, topn=2, separation=px / 2, percentile=99.9 if glints else 64)[
                ["x", "y"]
            ].to_numpy()

    def find_blobs(frame: Any) -> Any:
        return np.array([blob.pt for blob in finder.detect(frame)]).reshape(-1, 2)

    def find_circles(frame: Any) -> Any:
        smooth, votes = cv2.GaussianBlur(frame, (3, 3), 0), 5 if glints else 15
        circles = cv2.HoughCircles(
            smooth, cv2.HOUGH_GRADIENT, 1, 0.8 * px, param1=80, param2=votes, minRadius=radii[0], maxRadius=radii[1]
        )
        return np.empty((0, 2)) if circles is None else circles.reshape(-1, 3)[:, :2]

    return {"trackpy.locate": find_features, "SimpleBlobDetector": find_blobs, "HoughCircles": find_circles}


def count_found(found: list[Any], places: Any, reach: float) -> tuple[float, float]:
    """Share of the balls found, and false positions a ball."""
    hits = false = 0
    for k, xy in enumerate(found):
        away = np.hypot(*np.moveaxis(places[:, k, None] - xy[None], -1, 0))
        near = away < reach
        hits, false = hits + int(near.any(axis=1).sum()), false + int((~near.any(axis=0)).sum())
    balls = int(np.isfinite(places[..., 0]).sum())
    return hits / balls, false / balls


def main() -> None:
    """Run all four on all films, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "pace.json")
    asked = parser.parse_args()
    use_one_thread()
    table: dict[str, dict[str, Any]] = {}
    for name in (*GLINTS, *DISCS):
        frames, camera, places = draw_glints(GLINTS[name]) if name in GLINTS else draw_discs(*DISCS[name])
        diameter, table[name] = Camera.from_dict(camera).diameter_px, {}
        peers = make_peers(diameter, name in GLINTS)
        for program in ("synthcam", *peers):
            every = {"synthcam": 1, "trackpy.locate": 30}.get(program, 4)  # which frames are enough to time it
            used, true = frames[::every], places[:, ::every]
            spent, found = track(used, camera) if program == "synthcam" else time_frames(peers[program], used)
            hit, false = count_found(found, true, diameter / 2)
            table[name][program] = {"ms_per_frame": round(spent, 2), "found": hit, "false": false}
            print(f"{name:30} {program:20} {spent:9.2f} ms  found {hit:.3f}  false {false:.3f}", flush=True)
        stages = table[name]["stages"] = time_stages(frames, camera)
        print(f"{name:30} " + ", ".join(f"{stage} {spent:.2f} ms" for stage, spent in stages.items()), flush=True)
    save(asked.output, table)


if __name__ == "__main__":
    main()
