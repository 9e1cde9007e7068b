"""A score in a few lines: how far positions and quantities are off, and whether that is good enough."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from tracker.report.estimates_text import QUANTITIES
from tracker.scoring.score import DetectorScore

SAID = ("r", "mu_k", "tau1", "tau2")
LOST = 0.01  # share of the balls missed, or found where none is, up to which tracks are good
NEAR = 1.5  # times the bound, up to which a fit takes from the pictures what is in them
FEW = 20  # clips, from which on the spread of z says something
SAMPLING = 3.0  # standard errors by which a spread of z may be over 1


def summarise(score: DetectorScore) -> Iterator[str]:
    """Lines for a terminal, the last of which says what the tracks are good for."""
    where, swaps = score.localisation, score.tracking["swaps"]
    yield f"{score.statuses['n']} clips: " + ", ".join(f"{v} {k}" for k, v in score.statuses.items() if k != "n")
    yield (
        f"positions: {where['rmse_px']:.2g} px rmse, {where['ratio']:.3g} times the bound; "
        f"{where['missed']:.0f} missed, {where['false']:.0f} false, {swaps:.0f} identity swaps"
    )
    yield f"{'':<10}{'tied: rmse':>12}{'/ bound':>9}{'z std':>7}{'free: rmse':>12}{'/ bound':>9}{'z std':>7}"
    for name in SAID:
        _, unit, factor, _ = QUANTITIES[name]
        tied, free = (_figures(score.quantities[f"{name}{kind}"], factor) for kind in ("", "_free"))
        yield f"{f'{name} {unit}':<10}{tied}{free}"
    yield judge(score)


def judge(score: DetectorScore) -> str:
    """Whether these results are good enough, and for what, in a sentence; and another where it stands on few clips."""
    few = f" Fewer than {FEW} clips: the spread of z is uncertain." if score.statuses["n"] < FEW else ""
    return _judge(score) + few


def _judge(score: DetectorScore) -> str:
    where, swaps = score.localisation, score.tracking["swaps"]
    lost = max(where["missed"], where["false"]) / max(where["n"] + where["missed"], 1)
    if lost > LOST or swaps:
        return (
            f"Not good enough to follow these balls: {100 * lost:.2g} % missed or false, {swaps:.0f} swaps; "
            "look at the tracks before the quantities."
        )
    found = {n: q for n in SAID if (q := score.quantities[n])["n"] and np.isfinite(q["z_std"])}
    if not found:
        return "Good enough to follow these balls; no collision was measured with an error that a truth can be held to."
    off = {n: float(np.hypot(q["z_mean"], q["z_std"])) for n, q in found.items()}
    over = {n: z for n, z in off.items() if z > 1 + SAMPLING / np.sqrt(2 * found[n]["n"])}
    if over:
        worst = max(over, key=lambda n: over[n])
        return (
            f"Not good enough for error bars: {worst} is off by {over[worst]:.2g} times what its standard errors say; "
            "the values are right to the rmse above."
        )
    ratio = {n: q["ratio"] for n, q in found.items() if np.isfinite(q["ratio"])}
    far = {n: x for n, x in ratio.items() if x > NEAR * (1 + SAMPLING / np.sqrt(2 * found[n]["n"]))}
    if far:
        worst = max(far, key=lambda n: far[n])
        return (
            f"Good enough to measure with: the standard errors hold; but {worst} is {far[worst]:.2g} times "
            "as far off as the sensor's noise makes necessary."
        )
    good = "Good enough to measure with: the standard errors hold"
    if any(x > NEAR for x in ratio.values()):
        return f"{good}; so few clips do not show whether they could be smaller."
    return f"{good}, and are about as small as the sensor's noise allows."


def _figures(values: Mapping[str, float], factor: float) -> str:
    """rmse, ratio and spread of z of a quantity, in columns."""
    shown = (values["rmse"] * factor, values["ratio"], values["z_std"])
    texts = [f"{x:.2g}" if np.isfinite(x) else "–" for x in shown]
    return f"{texts[0]:>12}{texts[1]:>9}{texts[2]:>7}"
