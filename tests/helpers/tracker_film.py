"""Small films of glints for the tracker's tests, drawn without any of its code."""

import json
import math
from pathlib import Path

import numpy as np
import tifffile
from scipy.special import erf

CAMERA = {
    "scale": 1.6e-4,
    "K": [[3117.5625, 0, 99.5], [0, 3117.5625, 79.5], [0, 0, 1]],
    "dist": [0, 0, 0, 0, 0],
    "R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "t": [0, 0, 0.5],
    "size": [200, 160],
    "fps": 250.0,
    "exposure": 5e-4,
    "ball_diameter": 2.38e-3,
    "lamp": {"position": [0.05, 0.0, 0.45], "radius": 0.0},
    "psf": {"sigma_px": 1.0},
    "sensor": {"bits": 8, "gain": 20, "read_noise": 20, "prnu": 0.0, "dsnu": 0.0, "full_well": 6000, "black_level": 8},
}


def spot(shape, x, y, sigma, blur=(0.0, 0.0), steps=60):
    """Unit-flux Gaussian over square pixels, drawn out along `blur`, by a plain sum of many short exposures."""
    count = steps if max(map(abs, blur)) > 0 else 1
    share = ((np.arange(count) + 0.5) / count - 0.5)[:, None]
    rows, columns = (
        np.diff(erf((np.arange(n + 1) - 0.5 - middle - share * way) / sigma / math.sqrt(2))) / 2
        for n, middle, way in ((shape[0], y, blur[1]), (shape[1], x, blur[0]))
    )
    return rows.T @ columns / count


def disc(shape, x, y, radius):
    """A ball's dim profile: brightest in its middle, nothing beyond .71 of its radius."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    square = ((columns - x) ** 2 + (rows - y) ** 2) / radius**2
    return np.clip(1 - 2 * square, 0, None)


def expose(rng, picture, gain=20.0, read=20.0, black=8.0, bits=8):
    """Counts from a picture in counts over black: Poisson, read-out, rounding, clipping."""
    electrons = rng.poisson(np.maximum(picture, 0) * gain) + read * rng.standard_normal(picture.shape)
    return np.clip(np.rint(electrons / gain + black), 0, 2**bits - 1).astype(np.uint8 if bits <= 8 else np.uint16)


def film(rng, paths, shape=(160, 200), peak=200.0, sigma=1.0, exposure_share=0.125, profile=4.0, blank=(), **sensor):
    """Frames (n, h, w) of glints along paths (n, balls, 2) px, a slope of the way being each frame's motion blur."""
    steps = np.gradient(paths, axis=0) * exposure_share
    frames = []
    for k, positions in enumerate(paths):
        picture = np.full(shape, 0.5)
        for ball, (x, y) in enumerate(positions):
            if np.isfinite(x) and (k, ball) not in blank:
                reach = 12
                c, r = round(x), round(y)
                rows = slice(max(0, r - reach), min(shape[0], r + reach + 1))
                columns = slice(max(0, c - reach), min(shape[1], c + reach + 1))
                part = picture[rows, columns]
                if part.size:
                    at = (x - columns.start, y - rows.start)
                    part += peak * 2 * math.pi * sigma**2 * spot(part.shape, *at, sigma, steps[k, ball])
                    part += profile * disc(part.shape, *at, 7.44)
        frames.append(expose(rng, picture, **sensor))
    return np.array(frames)


def collision(frames=60, contact=25.3, speed=9.0, angle=0.4, offset=0.2, centre=(100.0, 80.0), diameter=14.875):
    """Paths (n, 2, 2) px: ball 0 rests and is hit by ball 1, which hands on most of its speed along the normal."""
    way = np.array([math.cos(angle), math.sin(angle)])
    turn = math.asin(offset)
    normal = np.array([math.cos(angle + turn), math.sin(angle + turn)])
    rest = np.array(centre)
    meet = rest - diameter * normal
    time = np.arange(frames) - contact
    along = speed * (way @ normal)
    struck, striker = 0.8 * along * normal, speed * way - 0.8 * along * normal
    before, after = np.minimum(time, 0)[:, None], np.maximum(time, 0)[:, None]
    one = rest + after * struck
    two = meet + before * speed * way + after * striker
    return np.stack([one, two], axis=1)


def film_of_lost_balls(rng, count, longest, bend=None):
    """Frames with one ball each, far from the one before, smeared in any direction; and the mean positions (n, 2).

    bend: angle by which it turns in the middle of the exposure.
    """
    frames, places = [], []
    for _ in range(count):
        x, y = rng.uniform([30, 30], [170, 130])
        length, angle = rng.uniform(3.0, longest), rng.uniform(0, 2 * np.pi)
        ways = [length * np.array([np.cos(a), np.sin(a)]) for a in (angle, angle + (bend or 0.0))]
        picture = np.full((160, 200), 0.5) + 4 * disc((160, 200), x, y, 7.44)
        if bend is None:
            picture += 1600 * spot(picture.shape, x, y, 1.0, ways[0])
            places.append((x, y))
        else:
            halves = [np.array([x, y]) + side * way / 4 for side, way in zip((-1, 1), ways, strict=True)]
            for (column, row), way in zip(halves, ways, strict=True):
                picture += 800 * spot(picture.shape, column, row, 1.0, way / 2)
            places.append(np.mean(halves, axis=0))
        frames.append(expose(rng, picture))
    return np.array(frames), np.array(places)


def write_clip(folder: Path, frames, camera=None):
    """A clip folder: frames.tif and camera.json."""
    folder.mkdir(parents=True, exist_ok=True)
    tifffile.imwrite(folder / "frames.tif", frames, imagej=True)
    (folder / "camera.json").write_text(json.dumps(CAMERA if camera is None else camera))
    return folder


def write_dataset(folder: Path, rng, clips=2, frames=40):
    """A dataset of collisions, with something secret under truth/."""
    for number in range(clips):
        paths = collision(frames, contact=18.4 + number, speed=2.5, angle=0.4 + number)
        position = write_clip(folder / "clips" / f"{number:06d}", film(rng, paths))
        (position / "truth").mkdir()
        (position / "truth" / "tracks.parquet").write_bytes(b"not for the tracker")
    (folder / "truth").mkdir()
    return folder
