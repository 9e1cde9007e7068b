"""Errors of ball discs that were drawn by supersampling: found, false, error over bound, z.

python -m benchmarks.tracker.discs [--films 2] [-o out/discs.json]

The table compares them with centroids of a simple script. It takes the difference from the background at half the
contrast of the balls, and opens it by 3 x 3. A position is the centre of moments of a contour with about the area of a
ball. The script is given the true background and contrast.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import cv2
import numpy as np

from benchmarks.harness import ROOT
from tracker.camera.camera import Camera
from tracker.detection.detect import detect, make_view

sys.path.insert(0, str(ROOT / "tests" / "helpers"))
drawing: Any = importlib.import_module("tracker_discs")

FAST = {"speed": 8.0, "size": (240, 320), "rest": (180.3, 120.6), "frames": 30, "contact": 16}
SUITES: dict[str, dict[str, Any]] = {
    "plain": {"texture": 0.0},
    "textured": {"texture": 150.0},
    "dark ball": {"ball": 25.0, "level": 150.0},
    "radius 5 px": {"radius": 5.0},
    "radius 40 px": {"radius": 40.0, "size": (480, 640), "rest": (300.3, 240.6), "speed": 5.0},
    "dim, noisy": {"ball": 110.0, "noise": 6.0},
    "dimmer, noisy": {"ball": 95.0, "noise": 6.0},
    "shadows": {"lit": True, "level": 90.0},
    "blurred": {"shutter": 0.8} | FAST,
    "30 frames a second": {"shutter": 0.2} | FAST,
}


def draw_discs(rng: np.random.Generator, suite: dict[str, Any]) -> tuple[Any, Any, dict[str, Any]]:
    """Frames, places (2, frames, 2), and the suite with its defaults."""
    s = {"texture": 40.0, "ball": 210.0, "level": 70.0, "radius": 9.3, "size": (160, 200), "rest": (90.3, 80.6)}
    s |= {"speed": 1.7, "noise": 2.0, "shutter": 0.0, "frames": 60, "contact": 25} | suite
    ways = drawing.collision(s["frames"], s["contact"], s["radius"], s["speed"], s["rest"])
    ground = drawing.plate(rng, s["level"], s["texture"], s["size"])
    if "lit" in s:
        return (
            drawing.lit_film(rng, ways, radius=s["radius"], noise=s["noise"], ground=ground),
            ways,
            s | {"ground": ground},
        )
    pictures = drawing.film(rng, ways, s["ball"], s["noise"], ground, s["radius"], shutter=s["shutter"])
    return pictures, ways, s | {"ground": ground}


def bound(s: dict[str, Any], way: Any) -> float:
    """Cramer-Rao of one coordinate of a disc of known look, rms of the two, px: by differences of its picture."""
    at, step, inverse = np.array(s["rest"]), 0.1, []
    for side in np.eye(2) * step:
        pair = [
            (s["ball"] - s["ground"]) * drawing.disc(at + k * side, s["radius"], 0.7, way, s["size"]) for k in (1, -1)
        ]
        inverse.append((s["noise"] ** 2 + 1 / 12) / (((pair[0] - pair[1]) / (2 * step)) ** 2).sum())
    return float(np.sqrt(np.mean(inverse)))


def locate(pictures: Any, s: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Frame, place and covariance."""
    size = [s["size"][1], s["size"][0]]
    clip = drawing.recorded(
        pictures, Camera.from_dict({"size": size, "fps": 60.0, "scale": 1e-3, "ball_diameter": 2e-3 * s["radius"]})
    )
    found = detect(clip, make_view(clip, "discs"), "discs").glints
    return found.frame, found.xy, found.cov


def centroids(pictures: Any, s: dict[str, Any]) -> tuple[Any, Any, Any]:
    """The same by threshold and moments, without errors."""
    contrast, area = s["ball"] - float(np.median(s["ground"])), np.pi * s["radius"] ** 2
    frames, places = [], []
    for number, picture in enumerate(pictures):
        mask = (np.abs(picture - s["ground"]) > abs(contrast) / 2).astype(np.uint8)
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        for line in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
            filled = cv2.drawContours(np.zeros_like(mask), [line], -1, 1, cv2.FILLED)
            m = cv2.moments(filled, binaryImage=True)
            if 0.5 < m["m00"] / area < 1.5:
                frames.append(number)
                places.append([m["m10"] / m["m00"], m["m01"] / m["m00"]])
    return np.array(frames, dtype=int), np.array(places).reshape(-1, 2), np.tile(np.eye(2), (len(frames), 1, 1))


def judge(found: tuple[Any, Any, Any], ways: Any, radius: float) -> dict[str, Any]:
    """Misses by ball and frame; what lies further than half a radius from each ball is false."""
    frame, xy, cov = found
    apart = np.hypot(*np.moveaxis(ways[:, frame] - xy, -1, 0)) if len(frame) else np.empty((2, 0))
    ball = apart.argmin(axis=0) if len(frame) else np.empty(0, int)
    good = apart.min(axis=0) < radius / 2 if len(frame) else np.empty(0, bool)
    speed = np.hypot(*np.moveaxis(np.gradient(ways, axis=1), -1, 0))
    miss = xy[good] - ways[ball[good], frame[good]]
    z = miss / np.sqrt(np.diagonal(cov[good], axis1=1, axis2=2))
    return {
        "seen": len({*zip(frame[good], ball[good], strict=True)}),
        "false": int((~good).sum()),
        "miss": miss,
        "z": z,
        "rests": speed[ball[good], frame[good]] == 0,
    }


def main() -> None:
    """Runs the suites and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--films", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "discs.json")
    asked = parser.parse_args()
    table: dict[str, Any] = {}
    for name, suite in SUITES.items():
        films = [draw_discs(np.random.default_rng(seed), suite) for seed in range(asked.films)]
        balls = sum(ways.shape[0] * ways.shape[1] for _, ways, _ in films)
        s, swept = films[0][2], films[0][2]["shutter"] * np.gradient(films[0][1], axis=1)
        least = np.sqrt(np.mean([bound(s, swept[b, k]) ** 2 for b in (0, 1) for k in range(2, s["frames"], 9)]))
        begun = time.monotonic()
        all_found = [judge(locate(pictures, own), ways, own["radius"]) for pictures, ways, own in films]
        spent = 1e3 * (time.monotonic() - begun) / sum(len(p) for p, _, _ in films)
        miss, z, rests = (np.concatenate([f[key] for f in all_found]) for key in ("miss", "z", "rests"))
        table[name] = {
            "found": sum(f["seen"] for f in all_found) / balls,
            "false": sum(f["false"] for f in all_found) / balls,
            "rmse_px": float(np.sqrt((miss**2).mean())) if len(miss) else None,
            "ratio": float(np.sqrt((miss**2).mean()) / least) if len(miss) and "lit" not in s else None,
            "z_moving": float(np.sqrt((z[~rests] ** 2).mean())) if (~rests).any() else None,
            "z_resting": float(np.sqrt((z[rests] ** 2).mean())) if rests.any() else None,
            "ms_per_frame": round(spent, 2),
        }
        others = [judge(centroids(pictures, own), ways, own["radius"]) for pictures, ways, own in films]
        errors = np.concatenate([f["miss"] for f in others])
        table[name] |= {
            "centroids_found": sum(f["seen"] for f in others) / balls,
            "centroids_false": sum(f["false"] for f in others) / balls,
            "centroids_rmse_px": float(np.sqrt((errors**2).mean())) if len(errors) else None,
        }
        shown = "  ".join(f"{k} {v:.3g}" for k, v in table[name].items() if v is not None)
        print(f"{name:20} {shown}", flush=True)
    asked.output.parent.mkdir(parents=True, exist_ok=True)
    asked.output.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
