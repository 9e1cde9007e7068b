"""The pictures of docs/pictures.md: each a scene and a crop, magnified and, if it says so, brightened.

python -m benchmarks.camera.gallery [-o docs/pictures]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import ROOT
from synthcam.scene.clip import Clip
from synthcam.scene.scene import check_scene
from synthcam.settings import read_yaml

Counts = NDArray[Any]
ONE = {"launch": {"kind": "single", "contact": [0.0, 0.0], "v0": 0.01}}
TWO = {"launch": {"v0": 0.3, "b": 0.3, "heading": 0.5, "contact": [0.0, 0.0]}}
CLOSE = {"size": [96, 64], "scale": 8e-5}
ROOM = {"room": 0.2}
PLATE = {"plate_gloss": 0.004, "plate_texture": 0.1, "plate_shadow": True, "steel": "iron"}
OBLIQUE = {"position": [0.25, 0.15, 0.3], "facing": "centre", "room": 0.7}

SNOOKER, WHITE = (read_yaml(ROOT / "scenes" / f"{name}.yaml") for name in ("snooker", "matte_white"))
STEEL = {
    "camera": {"size": [640, 360], "scale": 1.2e-5, "psf_sigma_px": 0.7, "colour": True},
    "timing": {"frames": 2, "contact_frame": 0.5, "exposure": 2e-5, "fps": 1000},
    "launch": {"v0": 0.05, "b": 0.1, "heading": 0.35, "contact": [0.0, 0.0]},
    "lamp": {"ambient": 0.4, "radius": 0.12, "position": [0.15, 0.1, 0.35]},
    "surface": {"ball": "steel", "plate": "wood", "plate_albedo": 0.4},
}

# name: settings, frame, gamma of the print (1: unchanged, 2.5: faint light brightened)
PICTURES: dict[str, tuple[dict[str, Any], int, float]] = {
    "one_ball": (ONE | {"camera": CLOSE}, 1, 1.0),
    "one_ball_faint": (ONE | {"camera": CLOSE, "lamp": ROOM}, 1, 2.2),
    "contact": (TWO | {"camera": CLOSE, "lamp": ROOM}, 1, 2.2),
    "oblique_lamp": (TWO | {"camera": CLOSE, "lamp": OBLIQUE, "surface": PLATE}, 1, 2.2),
    "ring_lamp": (
        ONE
        | {
            "camera": CLOSE | {"scale": 4e-5},
            "lamp": {"shape": "ring", "radius": 0.2, "inner": 0.17, "room": 0.1, "position": [0.0, 0.0, 0.6]},
        },
        1,
        1.0,
    ),
    "bar_and_second_lamp": (
        ONE
        | {
            "camera": CLOSE | {"scale": 4e-5},
            "lamp": {
                "shape": "bar",
                "length": 0.3,
                "width": 0.02,
                "position": [0.0, 0.15, 0.45],
                "room": 0.05,
                "second": {"position": [-0.2, -0.1, 0.4], "radius": 0.01},
            },
        },
        1,
        1.6,
    ),
    "saturated": (TWO | {"camera": CLOSE, "sensor": {"glint_peak": 2500, "full_well": 60000}}, 1, 1.0),
    "dim": (TWO | {"camera": CLOSE, "sensor": {"glint_peak": 12}}, 1, 2.2),
    "blurred": (TWO | {"camera": CLOSE, "timing": {"exposure": 4e-3}}, 1, 1.0),
    "rolling_shutter": (
        TWO
        | {
            "camera": CLOSE | {"shutter": "rolling", "line_time": 1e-4},
            "lamp": {"room": 0.5},
            "launch": TWO["launch"] | {"v0": 0.6},
        },
        1,
        1.6,
    ),
    "defocus": (TWO | {"camera": CLOSE | {"defocus_px": 4.0, "psf_sigma_px": 0.6}, "lamp": ROOM}, 1, 1.6),
    "diffraction": (
        ONE
        | {
            "camera": CLOSE | {"f_number": 32.0, "psf_sigma_px": 0.5},
            "lamp": {"room": 0.0},
            "sensor": {"glint_peak": 4000, "full_well": 90000},
        },
        1,
        1.6,
    ),
    "rough_and_scratched": (
        ONE | {"camera": CLOSE | {"scale": 4e-5}, "surface": {"roughness": 0.02, "scratches": 0.4}},
        1,
        2.2,
    ),
    "snooker": (
        SNOOKER | {"camera": SNOOKER["camera"] | {"size": [128, 84]}, "launch": TWO["launch"] | {"v0": 0.8}},
        1,
        2.2,
    ),
    "matte_white": (
        WHITE | {"camera": WHITE["camera"] | {"size": [144, 96]}, "launch": TWO["launch"]},
        1,
        2.2,
    ),
    "hot_pixels": (ONE | {"camera": CLOSE, "sensor": {"hot_pixels": 0.003, "hot_dark": 4e6}}, 1, 1.0),
}


def clip_of(settings: dict[str, Any]) -> Clip:
    timing = settings.get("timing", {}) | {"frames": 3, "contact_frame": 1.06}
    return check_scene({"name": "gallery"} | settings | {"timing": timing}, "gallery").draw(0, 0)


def frames_of(clip: Clip) -> list[Counts]:
    return list(clip.pictures())


def printed(counts: Counts, clip: Clip, gamma: float, magnify: int) -> Counts:
    """Eight bits, black at the black level, every pixel a square."""
    top = 2.0**clip.sensor.bits - 1
    black = clip.sensor.black_level if gamma != 1 else 0.0
    shown = 255 * np.clip((counts - black) / (top - black), 0, 1) ** (1 / gamma)
    large = shown.astype(np.uint8).repeat(magnify, axis=0).repeat(magnify, axis=1)
    return large[..., ::-1] if large.ndim == 3 else large  # as OpenCV writes colours


def animation(path: Path) -> None:
    """The collision, 30 frames at a tenth of their rate, cropped and magnified."""
    settings = {
        "camera": {"size": [160, 88], "scale": 1.1e-4},
        "launch": {"v0": 0.3, "b": 0.4, "heading": 0.12, "contact": [-0.002, 0.0005]},
        "lamp": {"room": 0.25},
        "timing": {"frames": 30, "contact_frame": 9.3},
    }
    clip = clip_of(settings)
    shown = [printed(counts, clip, 2.0, 3) for counts in frames_of(clip)]
    shown = [(frame // 12) * 12 for frame in shown]  # 22 greys: noise does not compress
    imageio.imwrite(path, shown, duration=40, loop=0)


def steel(path: Path) -> None:
    """Two steel balls on wood, in colour: the first picture of README.md."""
    clip = check_scene(STEEL, "gallery").draw(0, 0)
    picture = printed(next(iter(clip.pictures())), clip, 2.2, 1)
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 88])


def main() -> None:
    parser = argparse.ArgumentParser(description="Draws the pictures of docs/pictures.md.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "pictures")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    for name, (settings, frame, gamma) in PICTURES.items():
        clip = clip_of(settings)
        picture = printed(frames_of(clip)[frame], clip, gamma, 5)
        cv2.imwrite(str(folder / f"{name}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    animation(folder / "collision.gif")
    steel(folder / "steel.jpg")


if __name__ == "__main__":
    main()
