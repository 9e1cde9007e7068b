"""How far simulation and measurement stand apart on collisions that no fit has seen, before and after."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.fit import Fit, fit
from discrepancy.forecast import forecast
from discrepancy.measured import Measured
from discrepancy.noise import Noise


@dataclass(frozen=True)
class Gap:
    """chi^2 a point, and rms in um, on the clips kept out; the floor is what noise alone leaves of the same fit."""

    before: float
    after: float
    floor: float
    closure: float
    before_um: float
    after_um: float
    floor_um: float


@dataclass(frozen=True)
class Shown:
    """The gap with the two fits of the clips kept out, for the figures."""

    gap: Gap
    before: Fit
    after: Fit


def show(
    clips: Sequence[Measured], base: Fit, best: Fit, noise: Noise, tick: Callable[[], None] = lambda: None
) -> Shown:
    """The gap on `clips`, kept out of both fits: shared parameters frozen, each clip's launch refitted."""
    before = fit(clips, base.model, (), noise, tick=tick)
    after = before if best is base else fit(clips, best.model, (), noise, before.launches, tick)
    floor = 1 - before.launches.size / before.points
    one, two = before.chi2 / before.points, after.chi2 / after.points
    closure = (one - two) / (one - floor) if one > floor else float("nan")
    spread = [float(np.sqrt(np.trace(c.covariance, axis1=1, axis2=2).mean() / 2)) for c in clips]
    noise_um = 1e6 * noise.scale * float(np.sqrt(np.mean(np.square(spread)) * floor))
    return Shown(Gap(one, two, floor, closure, _rms_um(clips, before), _rms_um(clips, after), noise_um), before, after)


def _rms_um(clips: Sequence[Measured], now: Fit) -> float:
    expected = forecast(now.model, now.launches, clips)
    squares = [(c.xy - e) ** 2 for c, e in zip(clips, expected, strict=True)]
    return 1e6 * float(np.sqrt(np.mean(np.concatenate(squares))))


def as_dict(gap: Gap) -> dict[str, float]:
    return dataclasses.asdict(gap)
