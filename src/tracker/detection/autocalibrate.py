"""What a camera file leaves open, estimated from the clip: black level, noise, gain, and the glint's width."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from tracker.camera.camera import Camera
from tracker.camera.sensor import SensorSpec
from tracker.detection.candidates import CandidateSearch, EmptyPlate
from tracker.detection.likelihood.glint_fit import GlintWindows, fit_glints

FRAMES = 40  # used
DEEP = 400  # frames of 16 bits searched for the brightest pixel
WIDTHS = (0.4, 5.0)  # px, between which a glint's width is sought
GAINS = (2.0, 500.0)  # e-/count of 8 bits; of 12 bits each count is a sixteenth
LOUDER = (0.3, 100.0)  # of the plate's noise, between which an encoder's beside glints is sought, and
LEAST = 0.5  # the same, that is anything at all
CLEARLY = 100.0  # by how much more likely (its logarithm) the windows must be by it
DEFAULT_SIGMA = 1.0  # px, where the clip does not show it either
TYPICAL = 1.2  # px, a first width
LONGEST = 2.5  # px, of a way during the exposure
SHORT = 0.3  # of a frame's time, an exposure in which whole-pixel positions give the displacement well enough
SURE = 1.5  # spread of the logarithm of gains that cameras have, about 20 e-/count
BRIGHT = 20.0  # deviations of a box sum over the plate, for a glint that is measured


def estimate_unknown_settings(camera: Camera, plate: EmptyPlate, frames: Sequence[Any]) -> Camera:
    """The camera with black level, read noise, gain and PSF filled in where its file does not give them."""
    sensor = camera.sensor
    encoded = getattr(frames, "lossy", False) and not sensor.codec_noise
    if not encoded and not {"sensor.bits", "sensor.black_level", "sensor.read_noise", "sensor.gain", "psf.sigma_px"} & {
        *camera.assumed
    }:
        return camera
    level = float(np.median(plate.level))
    if "sensor.bits" in camera.assumed:
        sensor = replace(sensor, bits=_bits(8 * plate.level.dtype.itemsize, frames))
    if "sensor.black_level" in camera.assumed:
        sensor = replace(sensor, black_level=level)
    sensor = _with_read_noise(camera, sensor, plate.noise, level)
    camera = replace(camera, sensor=sensor)
    wants_gain = "sensor.gain" in camera.assumed
    if camera.psf_sigma is not None and not wants_gain and not encoded:
        return camera
    windows = _brightest(camera, plate, frames)
    if windows is None:
        return camera if camera.psf_sigma is not None else replace(camera, psf_sigma=DEFAULT_SIGMA)
    if encoded or (wants_gain and "sensor.read_noise" in camera.assumed):
        size = _codec_noise(windows, camera, plate.noise, level, wants_gain)
        camera = replace(camera, sensor=replace(camera.sensor, codec_noise=size))
    for _ in range(2 if wants_gain else 1):  # either shifts the other a little
        sigma = camera.sigma
        if "psf.sigma_px" in camera.assumed:
            sigma = _width(windows, camera.sensor)
            lamp = camera.lamp_image_radius**2 / 4.0
            camera = replace(camera, psf_sigma=math.sqrt(max(sigma**2 - lamp, 0.01)))
        if wants_gain and sigma is not None:
            camera = replace(camera, sensor=_gain(windows, sigma, camera, plate.noise, level)[0])
    return camera


def _bits(container: int, frames: Sequence[Any]) -> int:
    """Bits of the converter: the fewest that cameras have and that hold the brightest pixel seen."""
    if container <= 8:
        return container
    top = max(int(np.max(frames[k])) for k in range(min(len(frames), DEEP)))
    return next(bits for bits in (8, 10, 12, 14, 16) if top < 2**bits)


def _with_read_noise(camera: Camera, sensor: SensorSpec, noise: float, level: float) -> SensorSpec:
    """Read noise such that the plate flickers as it does, if the file does not give it."""
    if "sensor.read_noise" not in camera.assumed:
        return sensor
    shot = max(level - sensor.black_level, 0.0) / sensor.gain
    rest = max(noise**2 - 1.0 / 12.0 - shot, 1e-4)
    return replace(sensor, read_noise=sensor.gain * math.sqrt(rest))


def _brightest(camera: Camera, plate: EmptyPlate, frames: Sequence[Any]) -> GlintWindows | None:
    """Windows about clear glints, the way of each from its nearest neighbour one frame before."""
    radius = camera.diameter_px / 2.0 if camera.metric else 8.0
    search = CandidateSearch(plate, TYPICAL, apart=1.6 * radius)
    half = max(3, min(6, round(0.58 * radius)))
    least = BRIGHT * search.box * plate.noise
    share = camera.exposure * camera.fps if camera.metric else 0.125
    start = max(0, (len(frames) - FRAMES) // 2)
    cuts, ways = [], []
    before = np.empty((0, 2), np.int64)
    for k in range(start, min(len(frames), start + FRAMES)):
        frame = frames[k]
        finds = search(frame)
        here = np.column_stack([finds.column, finds.row])
        clear = finds.strength > max(least, 0.5 * float(np.max(finds.strength, initial=0.0)))
        clear &= np.all((here >= half) & (here < np.array(frame.shape[::-1]) - half), axis=1)
        for at in here[clear] if len(before) else ():
            way = share * (at - before[int(np.argmin(np.sum((before - at) ** 2, axis=1)))])
            if np.hypot(*way) <= LONGEST and (share < SHORT or not way.any()):
                cuts.append(frame[at[1] - half : at[1] + half + 1, at[0] - half : at[0] + half + 1])
                ways.append(way)
        before = here
    if not cuts:
        return None
    counts, blurs = np.stack(cuts).astype(np.float64), np.array(ways, dtype=np.float64)
    n = len(counts)
    nothing = np.zeros((n, 2))
    return GlintWindows(counts, np.ones_like(counts), nothing, blurs, nothing, np.zeros((n, 0, 3)))


def _width(windows: GlintWindows, sensor: SensorSpec) -> float:
    """The width under which the windows are most likely."""
    return _likeliest(lambda sigma: _loglik(windows, sigma, sensor), WIDTHS)


def _codec_noise(windows: GlintWindows, camera: Camera, noise: float, level: float, wants_gain: bool) -> float:
    """What an encoder leaves out beside glints, counts; 0 where the windows are as likely without.

    It is spread over the blocks in which something is seen; a bare plate is smoothed.
    """

    def coded(size: float) -> Camera:
        return replace(camera, sensor=replace(camera.sensor, codec_noise=size))

    def width(size: float) -> float:
        given = None if "psf.sigma_px" in camera.assumed else camera.sigma
        return given or _width(windows, coded(size).sensor)

    def likely(size: float) -> float:
        if wants_gain:
            return _gain(windows, width(size), coded(size), noise, level)[1]
        return _loglik(windows, width(size), coded(size).sensor)

    sigma = width(0.0)
    size = noise * _likeliest(lambda by: _loglik(windows, sigma, coded(by * noise).sensor), LOUDER)
    if size < LEAST * noise:
        return 0.0
    return size if likely(size) > likely(0.0) + CLEARLY else 0.0


def _gain(windows: GlintWindows, sigma: float, camera: Camera, noise: float, level: float) -> tuple[SensorSpec, float]:
    """The gain under which the glints scatter as they do, a dark pixel's noise kept, and how likely they are by it."""
    unit = 2.0 ** (8 - camera.sensor.bits)

    def sensor(gain: float) -> SensorSpec:
        return _with_read_noise(camera, replace(camera.sensor, gain=gain), noise, level)

    def loglik(gain: float) -> float:
        return _loglik(windows, sigma, sensor(gain)) - 0.5 * (math.log(gain / 20.0) / SURE) ** 2

    best = _likeliest(loglik, (GAINS[0] * unit, GAINS[1]))
    return sensor(best), loglik(best)


def _likeliest(loglik: Callable[[float], float], limits: tuple[float, float]) -> float:
    low, high = map(math.log, limits)
    grid = np.linspace(low, high, 9)
    best = int(np.argmax([loglik(math.exp(g)) for g in grid]))
    around = grid[max(best - 1, 0)], grid[min(best + 1, 8)]
    found = minimize_scalar(lambda g: -loglik(math.exp(g)), bounds=around, method="bounded", options={"xatol": 1e-3})
    return math.exp(float(found.x))


def _loglik(windows: GlintWindows, sigma: float, sensor: SensorSpec) -> float:
    result = fit_glints(windows, sigma, sensor)
    return float(np.sum(np.nan_to_num(result.loglik, nan=-1e9, neginf=-1e9)))
