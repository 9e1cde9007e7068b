"""What was measured, in words and numbers: for the terminal, a page and a notebook."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from tracker.measurement.collision.adequacy import MEASURED, MISFIT
from tracker.measurement.collision.derived import QUANTITY_NAMES

# name: (symbol, its index after _, unit, how many of it in one SI unit, what it is)
QUANTITIES: dict[str, tuple[str, str, float, str]] = {
    "v0": ("v_0", "cm/s", 1e2, "speed of the striker at contact"),
    "b": ("b/2R", "", 1.0, "impact parameter over the diameter"),
    "t_c": ("t_c", "ms", 1e3, "time of contact"),
    "r": ("r", "", 1.0, "coefficient of restitution"),
    "s": ("s", "", 1.0, "tangential velocity kept, share"),
    "mu_k": ("μ_k", "", 1.0, "kinetic friction on the plate"),
    "C": ("C", "", 1.0, "spin handed over, share"),
    "tau1": ("τ_1", "ms", 1e3, "the struck ball slides"),
    "tau2": ("τ_2", "ms", 1e3, "the striker slides"),
    "v1f": ("v_1f", "cm/s", 1e2, "speed of the struck ball when it rolls"),
    "v2f": ("v_2f", "cm/s", 1e2, "speed of the striker when it rolls"),
    "energy_fraction": ("E/E_0", "", 1.0, "translational energy left when both roll"),
    "momentum_fraction": ("p/p_0", "", 1.0, "momentum left when both roll"),
    "final_angle": ("angle", "deg", 180 / math.pi, "between the final velocities"),
    "drag": ("C_roll", "1/s", 1.0, "rolling loss that grows with speed"),
    "decel": ("D_roll", "cm/s²", 1e2, "rolling loss at any speed"),
    "w1n": ("ω_1n", "rad/s", 1.0, "spin of the struck ball along the line of centres"),
    "w1t": ("ω_1t", "rad/s", 1.0, "spin of the struck ball across it"),
    "w2n": ("ω_2n", "rad/s", 1.0, "spin of the striker along the line of centres"),
    "w2t": ("ω_2t", "rad/s", 1.0, "spin of the striker across it"),
}
PRINTED = ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction", "momentum_fraction")
ROLLING = ("v0", "drag", "decel")
KINDS = {"": "tied fit", "_free": "free fit", "_paper": "finite differences"}
MOST_PRINTED = 6  # collisions, on a terminal
NOT_SEEN = "–"
MET = {
    "ok": "two balls collide; one model of impact, sliding and rolling describes their tracks",
    MISFIT: "two balls collide, and the tracks reject the model of two equal balls that roll, collide and slide",
    "no_collision": "no two balls touch",
}


class QuantityLine(NamedTuple):
    """A quantity: its name, symbol, unit, what it is, and its value with error by each fit, as text."""

    name: str
    symbol: str
    unit: str
    what: str
    values: tuple[str, ...]


def format_with_error(value: float | None, std: float | None) -> str:
    """As 0.9027(12): a value to two digits of its error; without one, to four; a dash for none."""
    if value is None or not math.isfinite(value):
        return NOT_SEEN
    if std is None or not math.isfinite(std) or std <= 0:
        return f"{value:.4g}"
    digits = 1 - math.floor(math.log10(std))
    if digits < 0:
        return f"{value:.0f}({std:.0f})"
    return f"{value:.{digits}f}({std * 10**digits:.0f})"


def rows_as_dicts(estimates: pd.DataFrame) -> list[dict[str, Any]]:
    """A table of estimates as rows by column."""
    return [{str(name): value for name, value in row.items()} for row in estimates.to_dict("records")]


def list_quantities(row: Mapping[str, Any], names: Sequence[str] = QUANTITY_NAMES) -> list[QuantityLine]:
    """The quantities of a collision, or of a ball that rolls alone; those that no fit has are left out."""
    out = []
    for name in names:
        symbol, unit, factor, what = QUANTITIES[name]
        pairs = [(row[f"{name}{kind}"], row[f"{name}{kind}_std"]) for kind in KINDS]
        values = tuple(format_with_error(_times(v, factor), _times(s, factor)) for v, s in pairs)
        if any(v != NOT_SEEN for v in values):
            out.append(QuantityLine(name, symbol, unit, what, values))
    return out


def format_value(row: Mapping[str, Any], name: str) -> str:
    """A quantity by the tied fit with its error, in its unit of QUANTITIES."""
    factor = QUANTITIES[name][2]
    return format_with_error(_times(row[name], factor), _times(row[f"{name}_std"], factor))


def describe_status(row: Mapping[str, Any]) -> str:
    """What a row is of, in a sentence."""
    return MET.get(row["status"], f"not measured: {row['status']}")


def describe_frames(row: Mapping[str, Any]) -> str:
    """The stretch of the recording that a collision is measured from; '' where there is none."""
    return f", frames {row['frame_first']:.0f} to {row['frame_last']:.0f}" if row.get("frame_last", -1) >= 0 else ""


def describe_fit(row: Mapping[str, Any]) -> str:
    """How well the tied fit describes the tracks; '' where there is none."""
    if row["status"] not in MEASURED or not row["dof"]:
        return ""
    return f"χ²/dof {row['chi2'] / row['dof']:.3g}, dof {int(row['dof'])}, p {row['adequate']:.2g}"


def format_for_terminal(estimates: pd.DataFrame) -> Iterator[str]:
    """Lines for a terminal: each collision's answer, or of many the medians of those that fit."""
    if len(estimates) <= MOST_PRINTED:
        for row in rows_as_dicts(estimates):
            yield from _format_row(row)
        return
    ok = estimates[estimates["status"] == "ok"]
    if len(ok):
        yield f"{'median of ' + str(len(ok)) + ' ok':<18}{'value':>12}{'error of one':>14}  unit"
    for name in PRINTED if len(ok) else ():
        symbol, unit, factor, _ = QUANTITIES[name]
        value, std = (_times(float(ok[f"{name}{end}"].median()), factor) for end in ("", "_std"))
        if value is not None and math.isfinite(value):
            yield f"  {_plain(symbol):<16}{value:>12.4g}{std:>14.2g}  {unit}".rstrip()


def _format_row(row: Mapping[str, Any]) -> Iterator[str]:
    yield f"clip {row['clip']}, collision {row['collision']}{describe_frames(row)}: {describe_status(row)}"
    found = list_quantities(row, PRINTED if row["status"] in MEASURED else ROLLING)
    if not found:
        return
    if row["status"] in MEASURED:
        kinds = [title for kind, title in KINDS.items() if kind != "_paper"]
        yield f"  {'':<8}{kinds[0]:>16}{kinds[1]:>16}  {describe_fit(row)}".rstrip()
    for line in found:
        shown = line.values[:2] if row["status"] in MEASURED else line.values[:1]
        yield f"  {_plain(line.symbol):<8}{''.join(f' {v:>15}' for v in shown)}  {line.unit:<6}{line.what}".rstrip()


def _times(value: Any, factor: float) -> float | None:
    return None if value is None else float(value) * factor


def _plain(symbol: str) -> str:
    return symbol.replace("_", "")
