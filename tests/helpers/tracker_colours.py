"""Films of coloured discs on cloth, with a shadow that walks, a hand and a cue."""

import numpy as np
from scipy.ndimage import gaussian_filter
from tracker_discs import SIZE, R, disc

GREEN, ORANGE, SKIN, WOOD = (28.0, 125.0, 98.0), (235.0, 150.0, 30.0), (205.0, 155.0, 130.0), (215.0, 190.0, 140.0)
Y, X = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
FRAMES = 24


def over(picture, cover, colour):
    return picture * (1 - cover[..., None]) + np.array(colour) * cover[..., None]


def shade(k):
    """A soft shadow (h, w) as of a person, that walks through the picture."""
    return 1 - 0.5 * gaussian_filter((np.hypot(X - 20 - 7 * k, (Y - 70) / 1.6) < 45).astype(float), 6)


def hand(k):
    """A palm and three fingers (h, w) that come in from the left and go."""
    tip = 80 - 7 * abs(k - 11)
    parts = [(np.hypot((X - tip + 40) / 1.3, Y - 22) < 17)]
    parts += [(np.abs(Y - 10 - 11 * n) < 4) & (tip - 6 * abs(n - 1) > X) & (tip - 45 < X) for n in range(3)]
    return gaussian_filter(np.any(parts, axis=0).astype(float), 0.7)


def cue(k):
    """A bar (h, w) that comes in from the left and goes."""
    along, across = X + 0.2 * (Y - 140), Y - 140 - 0.2 * X
    return gaussian_filter(((np.abs(across) < 3) & (along < 115 - 9 * abs(k - 14))).astype(float), 0.7)


def cluster(balls, bend, frames=FRAMES):
    """Places (balls, frames, 2) of a chain of balls in contact, bent by an angle at each, that turns and drifts."""
    angles = np.arange(balls - 1) * bend + 0.05 * np.arange(frames)[:, None]
    steps = (2 * R + 0.05) * np.stack([np.cos(angles), np.sin(angles)], axis=2)
    places = np.concatenate([np.zeros((frames, 1, 2)), np.cumsum(steps, axis=1)], axis=1)
    drift = (np.arange(frames)[:, None] - frames / 2) * [4.0, 1.8] + [95, 80]
    return (places - places.mean(axis=1, keepdims=True)).swapaxes(0, 1) + drift


def draw(ways, balls, ground=GREEN, shadow=True, people=(), seed=0):
    """uint8 frames (n, h, w, 3) of balls, functions (distance in x) -> colour, or colours."""
    rng, out = np.random.default_rng(seed), []
    for k in range(ways.shape[1]):
        picture = np.broadcast_to(ground, (*SIZE, 3)).copy()
        for way, ball in zip(ways[:, k], balls, strict=True):
            two = ball if isinstance(ball[0], tuple) else (ball, ball)
            cover, right = disc(way), way[0] < X
            picture = over(over(picture, cover * ~right, two[0]), cover * right, two[1])
        for shape, colour in people:
            picture = over(picture, shape(k), colour)
        picture *= shade(k)[..., None] if shadow else 1
        out.append(np.clip(np.rint(picture + rng.normal(0, 2.0, picture.shape)), 0, 255))
    return np.array(out).astype(np.uint8)


def smeared_ring(gap, frames=12, radius=14.5, smear=2.0, seed=0):
    """Places (4, frames, 2) and frames of three balls in a ring, gaps in px, that turns and drifts, and of one alone.

    Colours are blurred and brightness is not, as by an encoder.
    """
    rng, time, size = np.random.default_rng(seed), np.arange(frames), (200, 360)
    angles = 0.4 + 0.07 * time + 2 * np.pi * np.arange(3)[:, None] / 3
    ring = (2 * radius + gap) / np.sqrt(3) * np.stack([np.cos(angles), np.sin(angles)], axis=2)
    middle = np.stack([60 + 210 * time / (frames - 1), 100 + 1.5 * np.sin(time)], axis=1)
    ways = np.concatenate([ring + middle, [np.stack([0 * time + 335, 20 + 150 * time / (frames - 1)], axis=1)]])
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    blue, green, red, yellow = (30.0, 60.0, 110.0), (20.0, 120.0, 60.0), (190.0, 40.0, 60.0), (225.0, 170.0, 60.0)
    out = []
    for k in time:
        picture = np.broadcast_to((205.0, 210.0, 200.0), (*size, 3)).copy()
        for n, (way, two) in enumerate(
            zip(ways[:, k], [(blue, yellow), (green, yellow), (red, red)] * 2, strict=False)
        ):
            cover, turn = disc(way, radius, 0.8, size=size), 0.1 * k + 2 * n
            first = (x - way[0]) * np.cos(turn) + (y - way[1]) * np.sin(turn) > 0
            picture = over(over(picture, cover * first, two[0]), cover * ~first, two[1])
        picture += rng.normal(0, 2.0, picture.shape)
        grey = picture @ [0.299, 0.587, 0.114]
        colours = gaussian_filter(picture - grey[..., None], (smear, smear, 0))
        out.append(np.clip(np.rint(grey[..., None] + colours), 0, 255))
    return ways, np.array(out).astype(np.uint8)
