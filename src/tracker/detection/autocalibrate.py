"""Estimates from the clip what a camera file leaves open: black level, noise, gain, and the width of a glint."""

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


def estimate_unknown_settings(camera: Camera, plate: EmptyPlate, frames: Sequence[Any]) -> Camera:
    """The camera with black level, read noise, gain and width of the PSF estimated where its file lacks them."""
    sensor = camera.sensor
    encoded = getattr(frames, "lossy", False) and not sensor.codec_noise
    estimated = {"sensor.bits", "sensor.black_level", "sensor.read_noise", "sensor.gain", "psf.sigma_px"}
    if not encoded and estimated.isdisjoint(camera.assumed):
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
    windows = _cut_bright_glints(camera, plate, frames)
    if windows is None:
        return camera if camera.psf_sigma is not None else replace(camera, psf_sigma=1.0)  # px, of a usual lens
    windows, width = _start_at_glints(windows, camera), None
    if encoded or (wants_gain and "sensor.read_noise" in camera.assumed):
        size, width = _codec_noise(windows, camera, plate.noise, level, wants_gain)
        camera = replace(camera, sensor=replace(camera.sensor, codec_noise=size))
    for _ in range(2 if wants_gain else 1):  # either shifts the other a little
        sigma = camera.sigma
        if "psf.sigma_px" in camera.assumed:
            sigma, width = width or _width(windows, camera.sensor), None  # with another gain it is another
            lamp = camera.lamp_image_radius**2 / 4.0
            camera = replace(camera, psf_sigma=math.sqrt(max(sigma**2 - lamp, 0.01)))
        if wants_gain and sigma is not None:
            camera = replace(camera, sensor=_gain(windows, sigma, camera, plate.noise, level)[0])
    return camera


def _bits(container: int, frames: Sequence[Any]) -> int:
    """Bits of the converter: the fewest that cameras have and that the brightest pixel of 400 frames fits into."""
    if container <= 8:
        return container
    top = max(int(np.max(frames[k])) for k in range(min(len(frames), 400)))
    return next(bits for bits in (8, 10, 12, 14, 16) if top < 2**bits)


def _with_read_noise(camera: Camera, sensor: SensorSpec, noise: float, level: float) -> SensorSpec:
    """The sensor with the read noise that the plate's fluctuations show, if the file does not give it."""
    if "sensor.read_noise" not in camera.assumed:
        return sensor
    shot = max(level - sensor.black_level, 0.0) / sensor.gain
    rest = max(noise**2 - 1.0 / 12.0 - shot, 1e-4)
    return replace(sensor, read_noise=sensor.gain * math.sqrt(rest))


def _cut_bright_glints(camera: Camera, plate: EmptyPlate, frames: Sequence[Any]) -> GlintWindows | None:
    """Windows about clear glints; the blur of each follows from its nearest neighbour one frame before."""
    used_frames = 40  # in the middle of the clip
    max_windows = 400  # a cluttered film has tens of thousands
    max_blur_px = 2.5  # glints that move by more during the exposure are not used
    # Share of the frame time up to which whole-pixel positions give the blur well enough. In longer exposures only
    # glints at rest are used.
    short_share = 0.3
    radius = camera.diameter_px / 2.0 if camera.metric else 8.0
    search = CandidateSearch(plate, sigma=1.2, apart=1.6 * radius)  # px, a first width of the glints
    half = max(3, min(6, round(0.58 * radius)))
    least = 20.0 * search.box * plate.noise  # 20 standard deviations of a box sum over the plate
    share = camera.exposure * camera.fps if camera.metric else 0.125
    start = max(0, (len(frames) - used_frames) // 2)
    cuts, blurs = [], []
    before = np.empty((0, 2), np.int64)
    for k in range(start, min(len(frames), start + used_frames)):
        frame = frames[k]
        found = search(frame)
        here = np.column_stack([found.column, found.row])
        clear = found.strength > max(least, 0.5 * float(np.max(found.strength, initial=0.0)))
        clear &= np.all((here >= half) & (here < np.array(frame.shape[::-1]) - half), axis=1)
        for at in here[clear] if len(before) else ():
            blur = share * (at - before[int(np.argmin(np.sum((before - at) ** 2, axis=1)))])
            if np.hypot(*blur) <= max_blur_px and (share < short_share or not blur.any()):
                cuts.append(frame[at[1] - half : at[1] + half + 1, at[0] - half : at[0] + half + 1])
                blurs.append(blur)
        before = here
    if not cuts:
        return None
    used = np.unique(np.linspace(0, len(cuts) - 1, min(len(cuts), max_windows)).round().astype(int))
    cuts, blurs = [cuts[k] for k in used], [blurs[k] for k in used]
    counts, nothing = np.stack(cuts).astype(np.float64), np.zeros((len(cuts), 2))
    return GlintWindows(
        counts=counts,
        used=np.ones_like(counts),
        start=nothing,
        blur=np.array(blurs, dtype=np.float64),
        bowl=nothing,
        secondaries=np.zeros((len(cuts), 0, 3)),
    )


def _start_at_glints(windows: GlintWindows, camera: Camera) -> GlintWindows:
    """The windows with fitted positions, from which the many fits with other settings end in a third of the steps."""
    usual_sigma = 1.2  # px; the width hardly changes a position
    found = fit_glints(windows, camera.sigma or usual_sigma, camera.sensor)
    inside = found.converged & (np.max(np.abs(found.xy), axis=1) < windows.half)
    return replace(windows, start=np.where(inside[:, None], found.xy, 0.0))


def _width(windows: GlintWindows, sensor: SensorSpec) -> float:
    """The width of a glint, px, of greatest likelihood. 120 windows show it to 2 %, so that no more are fitted."""
    few = windows.take(np.unique(np.linspace(0, len(windows) - 1, min(len(windows), 120)).round().astype(int)))
    return _maximise(lambda sigma: _loglik(few, sigma, sensor), (0.4, 5.0))


def _codec_noise(
    windows: GlintWindows, camera: Camera, noise: float, level: float, wants_gain: bool
) -> tuple[float, float]:
    """Noise that an encoder adds beside glints, counts, and the width of a glint with it, px.

    The noise is 0 where the windows are as likely without it. It is spread over the blocks that contain something; a
    bare plate is smoothed.
    """
    limits = (0.3, 100.0)  # of the plate's noise, within which it is searched
    least = 0.5  # of the plate's noise; less cannot be distinguished from none
    min_log_ratio = 100.0  # by which the log likelihood must be better with it: films without encoding stay below

    def with_noise(size: float) -> Camera:
        return replace(camera, sensor=replace(camera.sensor, codec_noise=size))

    def width(size: float) -> float:
        given = None if "psf.sigma_px" in camera.assumed else camera.sigma
        return given or _width(windows, with_noise(size).sensor)

    def likely(size: float, sigma: float) -> float:
        if wants_gain:
            return _gain(windows, sigma, with_noise(size), noise, level)[1]
        return _loglik(windows, sigma, with_noise(size).sensor)

    sigma = width(0.0)
    size = noise * _maximise(lambda by: _loglik(windows, sigma, with_noise(by * noise).sensor), limits)
    if size < least * noise:
        return 0.0, sigma
    own = width(size)
    return (size, own) if likely(size, own) > likely(0.0, sigma) + min_log_ratio else (0.0, sigma)


def _gain(windows: GlintWindows, sigma: float, camera: Camera, noise: float, level: float) -> tuple[SensorSpec, float]:
    """The gain of greatest posterior probability, a dark pixel's noise kept; and the log of that probability.

    The prior is log-normal: cameras have about 20 e-/count, within a factor of e^1.5.
    """
    unit = 2.0 ** (8 - camera.sensor.bits)  # a count of 12 bits is a sixteenth of one of 8 bits

    def sensor(gain: float) -> SensorSpec:
        return _with_read_noise(camera, replace(camera.sensor, gain=gain), noise, level)

    def loglik(gain: float) -> float:
        return _loglik(windows, sigma, sensor(gain)) - 0.5 * (math.log(gain / 20.0) / 1.5) ** 2

    best = _maximise(loglik, (2.0 * unit, 500.0))  # e-/count
    return sensor(best), loglik(best)


def _maximise(loglik: Callable[[float], float], limits: tuple[float, float]) -> float:
    """The argument that maximises a function: on a logarithmic grid, then by Brent's method between its neighbours."""
    low, high = map(math.log, limits)
    grid = np.linspace(low, high, 9)
    best = int(np.argmax([loglik(math.exp(g)) for g in grid]))
    around = grid[max(best - 1, 0)], grid[min(best + 1, 8)]
    found = minimize_scalar(lambda g: -loglik(math.exp(g)), bounds=around, method="bounded", options={"xatol": 1e-3})
    return math.exp(float(found.x))


def _loglik(windows: GlintWindows, sigma: float, sensor: SensorSpec) -> float:
    enough_steps = 8  # from a fitted position; what moves on is no glint, or the settings are far off
    result = fit_glints(windows, sigma, sensor, max_steps=enough_steps)
    return float(np.sum(np.nan_to_num(result.loglik, nan=-1e9, neginf=-1e9)))
