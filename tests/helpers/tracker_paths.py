"""Paths of balls, and their detections, made without a film."""

import numpy as np

from tracker.detection.glints import Glints


def glints(frame, xy, flux=1200.0, flags=0):
    n = len(frame)
    cov = np.tile(np.eye(2) * 1e-4, (n, 1, 1))
    return Glints(
        np.asarray(frame),
        xy[:, 0].copy(),
        xy[:, 1].copy(),
        cov,
        np.broadcast_to(flux, n).astype(float),
        np.full(n, 8.0),
        np.full(n, flags),
    )


def scattered(rng, paths, noise=0.02, lost=()):
    """Glints of paths (n, balls, 2), in random order within each frame, and which ball each is."""
    rows = [
        (k, b)
        for k in range(len(paths))
        for b in range(paths.shape[1])
        if (k, b) not in lost and np.isfinite(paths[k, b, 0])
    ]
    rows = sorted(rows, key=lambda row: (row[0], rng.random()))
    xy = np.array([paths[k, b] for k, b in rows]) + noise * rng.standard_normal((len(rows), 2))
    return glints([k for k, _ in rows], xy), np.array([b for _, b in rows])


def driven(rng, frames=40, columns=5, spacing=120.0, speed=6.0, push=1.7):
    """Paths (frames, bodies, 2) of bodies that are pushed about at random, each by a soft spring near a cell."""
    cells = spacing * (1 + np.stack(np.meshgrid(np.arange(columns), np.arange(columns)), axis=-1).reshape(-1, 2))
    turn = rng.uniform(0, 2 * np.pi, len(cells))
    v, xy, paths = speed * np.column_stack([np.cos(turn), np.sin(turn)]), cells.copy(), []
    for _ in range(frames):
        paths.append(xy.copy())
        v += push * rng.standard_normal(v.shape) - 0.05 * (xy - cells)
        xy += v
    return np.array(paths)


def box(rng, frames=80, balls=8, size=400.0, radius=20.0, speed=18.0, gravity=1.5, steps=20):
    """Paths (frames, balls, 2) of discs that fall and bounce in a box without loss; NaN where the rim cuts one off."""
    cells = np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2)
    xy, turn = (cells[rng.permutation(16)[:balls]] + 0.5) * size / 4, rng.uniform(0, 2 * np.pi, balls)
    v, paths = speed * rng.uniform(0.3, 1.2, balls)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]), []
    for _ in range(frames):
        paths.append(xy.copy())
        for _ in range(steps):
            v = v + np.array([0.0, gravity / steps])
            xy = xy + v / steps
            for i, j in zip(*np.triu_indices(balls, 1), strict=True):
                away = xy[j] - xy[i]
                if np.hypot(*away) < 2 * radius and (v[j] - v[i]) @ away < 0:
                    kick = (v[j] - v[i]) @ away * away / (away @ away)
                    v[i], v[j] = v[i] + kick, v[j] - kick
        v = np.where(((xy < radius) & (v < 0)) | ((xy > size - radius) & (v > 0)), -v, v)
    out, rim = np.array(paths), radius - 6
    out[((out < rim) | (out > size - rim)).any(axis=2)] = np.nan
    return out
