"""Squares in which a shorter program draws the same ball. A software rasteriser runs every branch for each sample."""

from typing import NamedTuple

import numpy as np

from synthcam_shared.arrays import Array, Flags, Float32

GRID = 4  # samples: a software rasteriser shades blocks of 4 x 4
LARGEST = 252  # samples, of a square; larger points are not drawn everywhere
EXPOSURES = 2  # of one tile that may be drawn in squares: a sum of two does not depend on their order


class SquaresByProgram(NamedTuple):
    """Squares (n, 4) of samples: the middle's column and row in the buffer, the side, and the number of the ball.

    Those of one ball overlap. A sample belongs to the first kind whose square holds it.
    """

    mirror: Float32  # the ball may show its neighbour
    inside: Float32  # the ball covers each sample
    rest: Float32


def divide_balls(jobs: Float32, nearest: Float32) -> tuple[SquaresByProgram, ...] | None:
    """Divide balls with one neighbour or none into squares.

    jobs: instance matrices (n, 4, 4), as the shader reads them.
    nearest: the neighbour (n, 4), its centre and radius in radii of the ball, on the camera's axes.

    Returns squares for the first exposure of each tile, for the second, and for all of tiles with further exposures.
    The last are whole, in order, and `mirror`, as are those of balls that may cover each other. Balls that are too
    large or too small for squares give None.
    """
    balls, near = jobs.astype(float), nearest.astype(float)
    middle, extent = balls[:, 0, :2] + balls[:, 0, 2:], balls[:, 3, 1]
    if 2 * extent.max() > LARGEST or extent.min() < 4 * GRID:
        return None
    whole = _make_squares(middle, 2 * extent)
    eye, lens = balls[:, 2, :3], balls[:, 1].reshape(-1, 2, 2)
    slant = np.linalg.norm(eye, axis=1) / np.abs(eye[:, 2])
    coarse, fine = _find_singular_values(lens)  # radii that a sample spans, at most and at least
    at, reach = _locate_mirrored_neighbour(balls, near)
    half = np.where(balls[:, 3, 0] > 0, np.minimum(reach / fine + 2, extent), 0)
    spare = (extent - half)[:, None]  # no square may reach into the tile beside it
    mirror = _make_squares(middle + np.clip(at, -spare, spare), 2 * half)
    inner = np.maximum(0.99 - 2.5 * coarse * slant, 0) / slant / coarse
    inside = _align(middle, inner / np.sqrt(2))
    corner = balls[:, 0, 0] + 1j * balls[:, 0, 1]
    _, first, tile, exposures = np.unique(corner, return_index=True, return_inverse=True, return_counts=True)
    many = exposures[tile] > EXPOSURES
    entire = many | _cover_each_other(balls, near) | (half > extent / 2)
    mirror[entire] = whole[entire]
    early = first[tile] == np.arange(len(balls))
    parted = []
    for turn in (early & ~many, ~early & ~many, many):
        parts = turn & ~entire
        drawn = turn & (mirror[:, 2] > 0), parts & (inside[:, 2] > 0), parts
        parted.append(SquaresByProgram(mirror[drawn[0]], inside[drawn[1]], whole[drawn[2]]))
    return tuple(parted)


def _make_squares(middle: Array, side: Array) -> Float32:
    squares = np.empty((len(middle), 4), np.float32)
    squares[:, :2], squares[:, 2], squares[:, 3] = middle, side, np.arange(len(middle))
    return squares


def _align(middle: Array, half: Array) -> Float32:
    """Largest squares (n, 4) on the grid of blocks, of at most so many samples to each side of the middles (n, 2)."""
    low, high = np.ceil((middle - half[:, None]) / GRID), np.floor((middle + half[:, None]) / GRID)
    side = np.maximum((high - low).min(axis=1), 0)
    return _make_squares((low + side[:, None] / 2) * GRID, side * GRID)


def _find_singular_values(lens: Array) -> tuple[Array, Array]:
    """Find the larger and the smaller singular value (n,) of matrices (n, 2, 2)."""
    square, area = (lens**2).sum(axis=(1, 2)), lens[:, 0, 0] * lens[:, 1, 1] - lens[:, 0, 1] * lens[:, 1, 0]
    larger = np.sqrt((square + np.sqrt(np.maximum(square**2 - 4 * area**2, 0))) / 2)
    return larger, np.abs(area) / larger


def _cover_each_other(balls: Array, near: Array) -> Flags:
    """Tell whether the outline of a neighbour may meet that of its ball in the picture (n,)."""
    line = balls[:, 2, :3] / np.linalg.norm(balls[:, 2, :3], axis=1, keepdims=True)
    aside = near[:, :3] - (near[:, :3] * line).sum(axis=1, keepdims=True) * line
    return np.asarray((balls[:, 3, 0] > 0) & (np.linalg.norm(aside, axis=1) < 1.1 * (1 + near[:, 3]) + 0.1))


def _locate_mirrored_neighbour(balls: Array, near: Array) -> tuple[Array, Array]:
    """Find discs about the images of the neighbours in the balls: samples (n, 2) from the centre, and radii (n,).

    The normal where an image is seen halves the angle between the ways to the eye and to a point of the neighbour. Seen
    from the ball's surface instead of its centre, these ways turn by at most asin(1/e) and asin((1 + R)/d).
    """
    eye = balls[:, 2, :3]
    far, apart = np.linalg.norm(eye, axis=1), np.maximum(np.linalg.norm(near[:, :3], axis=1), 1e-6)
    both = eye / far[:, None] + near[:, :3] / apart[:, None]
    length = np.maximum(np.linalg.norm(both, axis=1), 1e-6)
    turns = [2 * np.sin(np.arcsin(np.minimum(sine, 1)) / 2) for sine in (1 / far, (1 + near[:, 3]) / apart)]
    sine = (turns[0] + turns[1]) / length
    reach = np.where(sine < 0.9, 2 * np.sin(np.arcsin(np.minimum(sine, 1)) / 2), 2)
    normal = both / length[:, None]
    seen = normal[:, :2] - normal[:, 2:] * (eye[:, :2] - normal[:, :2]) / (eye[:, 2:] - normal[:, 2:])
    (a, b), (c, d) = np.moveaxis(balls[:, 1].reshape(-1, 2, 2), 0, -1)
    x, y = seen[:, 0], seen[:, 1]
    at = np.stack([d * x - c * y, a * y - b * x], axis=1) / (a * d - b * c)[:, None]
    wider = (1 + 2 / np.maximum(np.abs(eye[:, 2]) - 2, 1e-6)) * far / np.abs(eye[:, 2])  # by the perspective
    return at, 1.05 * reach * wider + 0.02
