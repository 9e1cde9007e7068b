"""Planes of a film that show balls better than grey does: differences and distances of colours, and of brightness.

Most are of a film in colour, and a shadow hardly shows in them.

A shadow darkens red, green and blue by one factor, so that their shares of the sum stay. All planes here but one are
made of these shares. Their counts are uint8, whatever the depth of the film:

- "red-green", "red-blue", "green-blue": 128 and 127 times the difference of two shares;
- "colour": the distance from the colours of the picture without balls, 0 to 200. It saturates at a few standard
  deviations of the noise, so that a ball of two colours is one disc;
- "plate": the distance from the line of colours that the plate takes from shadow to full light, 0 to 200. It saturates
  in the same way. The plate has one colour, so that balls show where they rest all the time, too;
- "contrast", of any film: how far the brightness is from that of the picture without balls, 0 to 200. It saturates in
  the same way, so that a body with a white and a black part is one. It shows shadows, too;
- "#rrggbb": how near a pixel is to that colour. It is 200 on the colour, and 0 as far from it as the usual colour of
  the film.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.camera_keys import CHANNELS, CONTRAST, PLANES

PLATE = "plate"
Colours = NDArray[Any]  # (h, w, 3): red, green, blue
Shares = NDArray[np.float32]  # (h, w, 3): of the sum of the three


def is_plane(name: str) -> bool:
    """Tell whether a name stands for a plane of distances or differences, and not for a film's own counts."""
    return name in (*PLANES, CONTRAST) or re.fullmatch(r"#[0-9a-fA-F]{6}", name) is not None


def find_shares(picture: Colours, white: float) -> Shares:
    """Compute the shares of red, green and blue in a film's colours, darkened a little towards 0 in dark pixels."""
    dark = 0.03  # of white, added to each colour; so small that shadows do not reach it
    light = np.ascontiguousarray(picture[..., :3], dtype=np.float32)
    return light / (_add_colours(light) + np.float32(3 * dark * white))[..., None]


def _add_colours(values: Shares) -> NDArray[np.float32]:
    """Sums (h, w) over the three colours, in a fifth of the time that numpy takes."""
    return np.asarray(cv2.transform(values, np.ones((1, 3), np.float32)), np.float32).reshape(values.shape[:2])


def read_plane(name: str, sample: Callable[[], Sequence[Colours]], white: float) -> Callable[[Colours], Any]:
    """Return a function that makes one grey plane from red, green and blue, by the plane's name.

    sample: gives pictures spread over the film, for planes that depend on its colours; white: the largest count.
    """
    dark = 0.15  # of white, added to each colour of a difference; the encoder smears colours into dark pixels
    least_spread = 0.008  # of a share, the noise of an encoder
    saturation_spreads = 4.0  # distance of another colour, in standard deviations of the shares
    if name in CHANNELS:
        layer = CHANNELS.index(name) - 1
        return lambda picture: np.ascontiguousarray(picture[..., layer])
    differences = {"red-green": (0, 1), "red-blue": (0, 2), "green-blue": (1, 2)}
    if name in differences:
        one, two = differences[name]

        def difference(picture: Colours) -> Any:
            light = np.ascontiguousarray(picture[..., :3], dtype=np.float32)
            pair: Any = cv2.transform(light, np.array([np.eye(3)[one] - np.eye(3)[two], np.ones(3)]))
            pair[..., 1] += 3 * dark * white
            return np.rint(128 + 127 * (pair[..., 0] / pair[..., 1])).astype(np.uint8)

        return difference
    top = 200.0  # counts
    if name == PLATE:
        line = _fit_plate_line(sample(), white)
        return lambda picture: np.rint(top - top * cv2.exp(-0.5 * line.measure_squares(picture))).astype(np.uint8)
    shares = [find_shares(picture, white) for picture in sample()]
    usual: Any = np.median(shares, axis=0).astype(np.float32)
    if name == "colour":
        spread = 1.4826 * np.median([np.sqrt(((s - usual) ** 2).sum(axis=2)) for s in shares], axis=0)
        wide = 2 * round(max(usual.shape[:2]) / 100) + 3  # px, of a neighbourhood with one noise
        calm = cv2.blur(spread.astype(np.float32), (wide, wide))
        scale = 1 / (saturation_spreads * np.clip(calm, least_spread, 4 * least_spread)) ** 2

        def distance(picture: Colours) -> Any:
            off = find_shares(picture, white)
            off -= usual
            far = _add_colours(np.multiply(off, off, out=off))
            far *= -scale / 2
            return np.rint(top - top * np.asarray(cv2.exp(far, dst=far))).astype(np.uint8)

        return distance
    named = np.array([[[*bytes.fromhex(name[1:])]]], np.float32)
    wanted = find_shares(named * (white / 255), white)[0, 0]
    reach = max(float(np.sqrt(((wanted - np.median(usual, axis=(0, 1))) ** 2).sum())), 3 * least_spread)

    def nearness(picture: Colours) -> Any:
        far = np.sqrt(_add_colours((find_shares(picture, white) - wanted) ** 2))
        return np.rint(top * np.clip(1 - far / reach, 0, 1)).astype(np.uint8)

    return nearness


def read_contrast(pictures: Sequence[NDArray[Any]]) -> Callable[[NDArray[Any]], NDArray[np.uint8]]:
    """Return a function that makes the plane "contrast" of a picture (h, w).

    pictures: (h, w), spread over the film; their median is the picture without balls.
    """
    top, saturation_spreads, least_counts = 200.0, 5.0, 4.0
    sample = np.array(pictures)
    level = np.median(sample, axis=0).astype(np.float32)
    noise = 1.4826 * float(np.median(np.abs(sample - level)))  # of a pixel; most pixels are the plate's
    spread, empty = max(saturation_spreads * noise, least_counts), _smooth(level)

    def distance(picture: NDArray[Any]) -> NDArray[np.uint8]:
        off = (_smooth(picture) - empty) / np.float32(spread)
        return np.asarray(np.rint(top - top * cv2.exp(-0.5 * off * off)), np.uint8)

    return distance


@dataclass(frozen=True)
class _PlateLine:
    """A line in the space of red, green and blue, counts, near which all pixels of the plate lie."""

    point: Any  # (3,)
    direction: Any  # (3,): of length 1, towards more light
    noise: tuple[float, float]  # variance beside the line, counts^2, at `point`, and its change per count along it
    least_noise: float  # counts^2

    def measure_squares(self, picture: Colours) -> NDArray[np.float32]:
        """Squares (h, w) of the distances from the line, over the distance at which a pixel is another body's."""
        saturation_spreads = 5.0  # that distance, in standard deviations of the noise
        light = _smooth(picture)
        across = np.eye(3) - np.outer(self.direction, self.direction)
        apart = np.asarray(cv2.transform(light, np.column_stack([across, -across @ self.point])))
        along = np.asarray(cv2.transform(light, np.append(self.direction, -self.direction @ self.point)[None]))
        noise = np.maximum(self.noise[0] + self.noise[1] * along, self.least_noise)
        return np.asarray(_add_colours(apart * apart) / (saturation_spreads**2 * noise), np.float32)


def _smooth(picture: NDArray[Any]) -> NDArray[np.float32]:
    """Grey, or red, green and blue, with half the noise of a pixel, so that a black ball differs from a shadow."""
    std_px = 0.5
    light = np.ascontiguousarray(picture[..., :3] if picture.ndim == 3 else picture, dtype=np.float32)
    return np.asarray(cv2.GaussianBlur(light, (0, 0), std_px), np.float32)


def _fit_plate_line(pictures: Sequence[Colours], white: float) -> _PlateLine:
    """Fit the line to the pixels of the plate, which are most pixels of the film.

    Shadows and uneven light determine its direction. Where the plate has one brightness, the line goes through black.
    """
    through_black, least_std = 1e-3, 0.002 * white  # weight of black among the pixels; counts
    most = 500_000  # pixels that are used
    step = 1 + int(np.sqrt(sum(np.prod(picture.shape[:2]) for picture in pictures) / most))
    pixels = np.concatenate([_smooth(picture)[::step, ::step].reshape(-1, 3) for picture in pictures]).astype(float)
    point = np.zeros(3)
    total = pixels.sum(axis=1)
    bright = total >= np.percentile(total, 20)
    direction = np.median(pixels[bright] / np.maximum(total[bright, None], 1e-9), axis=0)
    direction /= max(float(np.linalg.norm(direction)), 1e-9)
    near = np.ones(len(pixels), bool)
    for turn in range(8):
        along = (pixels - point) @ direction
        far = np.linalg.norm(pixels - point - along[:, None] * direction, axis=1)
        std = max(float(np.median(far[near])) / np.sqrt(2 * np.log(2)), least_std)  # of a Rayleigh distribution
        near = far < 4 * std
        if turn > 1:
            point = pixels[near].mean(axis=0)
            off = pixels[near] - point
            spread = off.T @ off / len(off) + through_black * np.outer(point, point)
            direction = np.linalg.eigh(spread)[1][:, 2]
            direction *= np.sign(direction.sum())
    along = (pixels[near] - point) @ direction
    slope = np.polyfit(along, far[near] ** 2 / 2, 1)[0] if np.ptp(along) > least_std else 0.0
    noise = float((far[near] ** 2).mean()) / 2
    return _PlateLine(point, direction, (noise, float(max(slope, 0.0))), least_std**2)
