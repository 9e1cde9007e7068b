"""Films of matte discs on textured plates, drawn by supersampling: nothing of the detector's own profile is in them."""

import numpy as np
from scipy.ndimage import gaussian_filter

from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import Recording

SIZE, R, FINE, FPS = (160, 200), 9.3, 8, 60.0  # (h, w) px; px; samples a pixel and direction
CAMERA = {"size": [200, 160], "fps": FPS, "scale": 1e-3, "ball_diameter": 2 * R * 1e-3}


def disc(place, radius=R, blur=0.7, way=(0.0, 0.0), size=SIZE):
    """Coverage (h, w) of a disc, by FINE x FINE samples a pixel, the mean over its way in the exposure, and blurred."""
    h, w = size
    steps = max(int(np.hypot(*way) * 3), 0) + 1
    reach = radius + 4 * blur + np.abs(way).max() + 2
    left, top = (max(int(np.floor(c - reach)), 0) for c in place)
    right, bottom = (min(int(np.ceil(c + reach)) + 1, n) for c, n in zip(place, (w, h), strict=True))
    out = np.zeros(size)
    if right <= left or bottom <= top:
        return out
    x, y = ((np.arange((b - a) * FINE) + 0.5) / FINE - 0.5 + a for a, b in ((left, right), (top, bottom)))
    inside = np.zeros((len(y), len(x)))
    for s in (np.arange(steps) + 0.5) / steps - 0.5:
        inside += (x - place[0] - s * way[0]) ** 2 + (y[:, None] - place[1] - s * way[1]) ** 2 < radius**2
    cells = (inside / steps).reshape(bottom - top, FINE, right - left, FINE).mean(axis=(1, 3))
    padded = np.pad(cells, 8)
    out[top:bottom, left:right] = gaussian_filter(padded, blur)[8:-8, 8:-8]
    return out


def plate(rng, level=70.0, texture=40.0, size=SIZE):
    """A textured background, with a lamp's glare that never moves."""
    h, w = size
    glare = 150 * np.exp(-(((np.arange(w) - 0.75 * w) ** 2)[None] + ((np.arange(h) - 30) ** 2)[:, None]) / 200)
    return level + texture * gaussian_filter(rng.normal(size=size), 3) + glare


def collision(frames=60, contact=25, radius=R, speed=1.7, rest=(90.3, 80.6)):
    """Places (2, frames, 2) of a target at rest and a striker that hits it; both stay in the picture."""
    n, rest = np.array([np.cos(0.5), np.sin(0.5)]), np.array(rest)
    since = (np.arange(frames) - contact - 0.4)[:, None] * speed / 1.7
    late = np.maximum(since, 0)
    striker = rest - 2 * radius * n + np.where(since < 0, 1.7 * since * [1.0, 0.1], 0.25 * since * [1.0, -0.6])
    return np.stack([rest + 1.1 * late * n, striker])


def apart(frames=60):
    """Places of two balls that move side by side and never meet: of them no collision has to be fitted."""
    striker = collision(frames)[1]
    return np.stack([striker + np.array([0.0, 50.0]), striker])


def film(rng, ways, ball=210.0, noise=2.0, ground=None, radius=R, blur=0.7, shutter=0.0):
    """uint8 frames of discs at ways (balls, frames, 2); shutter: the exposure, of a frame's time."""
    ground = plate(rng) if ground is None else ground
    swept, out = shutter * np.gradient(ways, axis=1), []
    for k in range(ways.shape[1]):
        cover = sum(disc(way[k], radius, blur, sweep[k], ground.shape) for way, sweep in zip(ways, swept, strict=True))
        light = ground * (1 - cover) + ball * cover + rng.normal(0, noise, ground.shape)
        out.append(np.clip(np.rint(light), 0, 255))
    return np.array(out).astype(np.uint8)


def lit_film(rng, ways, lamp=(0.6, -0.4), radius=R, noise=2.0, ground=None, shade=0.45):
    """The same of white spheres under a lamp to one side, (x, y) of its direction, and the shadows that they cast."""
    ground, out = plate(rng) if ground is None else ground, []
    y, x = np.mgrid[: ground.shape[0], : ground.shape[1]].astype(float)
    lamp = np.array([*lamp, np.sqrt(1 - np.hypot(*lamp) ** 2)])
    for k in range(ways.shape[1]):
        light = ground.copy()
        for way in ways[:, k]:
            light *= 1 - shade * disc(way - radius * lamp[:2] / lamp[2], radius, 1.5, (0, 0), ground.shape)
        for way in ways[:, k]:
            u, v = (x - way[0]) / radius, (y - way[1]) / radius
            facing = u * lamp[0] + v * lamp[1] + np.sqrt(np.clip(1 - u * u - v * v, 0, 1)) * lamp[2]
            cover = disc(way, radius, 0.7, (0, 0), ground.shape)
            light = light * (1 - cover) + (60 + 160 * np.clip(facing, 0, 1)) * cover
        out.append(np.clip(np.rint(light + rng.normal(0, noise, ground.shape)), 0, 255))
    return np.array(out).astype(np.uint8)


def recorded(pictures, camera):
    """The frames as a clip."""
    return Recording(0, camera, wrap_frames(pictures))
