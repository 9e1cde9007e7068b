"""The goals of the search, each with the figure reached, the trials it rests on and its sampling error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .boxes import ALIKE
from .judge import OUTSIDE, Row

AT = (0.85, 1.2)  # a ratio within this factor counts as the one asked for
FEW = 10  # trials: fewer decide nothing


@dataclass(frozen=True)
class Goal:
    """text, where ("tracks" or "video"); reached with its error, of n trials; met: yes, no, or too few."""

    text: str
    where: str
    wanted: str
    reached: str
    n: int
    met: str


def near(rows: Iterable[Row], ratio: float, naming: bool = False) -> list[Row]:
    """Those whose strength is about `ratio` times the (naming) limit."""
    values = [(r, r.naming if naming else r.ratio) for r in rows]
    return [r for r, v in values if AT[0] * ratio <= v <= AT[1] * ratio]


def share(hits: Sequence[bool]) -> tuple[float, float]:
    """A share and its binomial error, which is not zero where all or none hit."""
    n, k = len(hits), sum(hits)
    p = (k + 0.5) / (n + 1)
    return (k / n if n else math.nan), math.sqrt(p * (1 - p) / (n + 1))


def at_least(text: str, where: str, wanted: float, hits: Sequence[bool]) -> Goal:
    return _goal(text, where, f"{100 * wanted:g} %", hits, lambda p: p >= wanted)


def at_most(text: str, where: str, wanted: float, hits: Sequence[bool]) -> Goal:
    return _goal(text, where, f"under {100 * wanted:.2g} %", hits, lambda p: p <= wanted)


def _goal(text: str, where: str, wanted: str, hits: Sequence[bool], good: object) -> Goal:
    p, error = share(hits)
    met = "too few" if len(hits) < FEW else "yes" if good(p) else "no"  # type: ignore[operator]
    reached = f"{100 * p:.1f} +- {100 * error:.1f} %" if len(hits) else "-"
    return Goal(text, where, wanted, reached, len(hits), met)


def goals(every: Sequence[Row]) -> list[Goal]:
    """The table of goals, from tracks and from video."""
    out = []
    for where, filmed in (("tracks", False), ("video", True)):
        asked = [r for r in every if r.filmed == filmed]
        rows = [r for r in asked if r.worked]
        if asked:
            out.append(at_least("an answer at all", where, 1.0, [r.worked for r in asked]))
        if rows:
            out += _claims(rows, where) + _names(rows, where) + _outside(rows, where) + _numbers(rows, where)
    return out


def _claims(rows: list[Row], where: str) -> list[Goal]:
    plain = [r for r in rows if r.kind == "none" and r.noise in ("white", "tracker")]
    hard = [r for r in rows if r.kind == "defect" or (r.kind == "none" and r not in plain)]
    one = [r for r in rows if r.kind == "one"]
    limit = 1.5 if where == "video" else 1.0
    blind = [r for r in rows if r.study.partition("-")[0] in ("tracks", "video")]
    claims = [c in r.false for r in blind for c in r.called]
    return [
        at_most("a false claim, nothing hidden", where, 2 / 300, [bool(r.false) for r in plain]),
        at_most(
            "likewise with a tracker's defect, correlated noise or shake", where, 0.02, [bool(r.false) for r in hard]
        ),
        at_least(f"detected at {limit:g} x its limit", where, 0.8, [r.detected for r in near(one, limit)]),
        at_most("false discoveries among the claims of the blind set", where, 0.03, claims),
    ]


def _names(rows: list[Row], where: str) -> list[Goal]:
    one, two = ([r for r in rows if r.kind == kind] for kind in ("one", "two"))
    parted = [r for r in one if r.nearest < ALIKE]
    alike = [r for r in one if r.nearest >= ALIKE and r.ratio >= 2 and r.detected]
    strong = [r for r in two if r.ratio >= 4.9 and r.nearest < ALIKE]
    return [
        at_least("right name at 2 x its naming limit", where, 0.98, [r.name for r in near(parted, 2, naming=True)]),
        at_least("right name from there on", where, 0.98, [r.name for r in parted if r.naming >= 2]),
        at_least("right class at 2 x its limit", where, 0.99, [r.kin for r in near(one, 2)]),
        at_least("right class from there on", where, 0.99, [r.kin for r in one if r.ratio >= 2]),
        at_least(
            "effects that no data part (cos over .98): a class",
            where,
            1.0,
            [r.kin and any(len(c) > 1 for c in r.classes) for r in alike],
        ),
        at_least("two effects, from 5 x their limits: both right", where, 0.95, [r.name for r in strong]),
        at_least("both classes right", where, 0.98, [r.kin for r in two if r.ratio >= 4.9]),
    ]


def _outside(rows: list[Row], where: str) -> list[Goal]:
    out = [r for r in rows if r.kind == "outside"]
    strong = [r for r in out if r.ratio >= 4.9]
    at_two = near(out, 2)
    return [
        at_least("outside the library, from 5 x: declared", where, 0.98, [r.declared for r in strong]),
        at_least("the right slot", where, 0.95, [r.slot for r in strong]),
        at_least("the curve in its band", where, 0.9, [bool(r.curve) for r in strong if r.curve is not None]),
        at_most(
            "at 2 x: called by a name of the library", where, 0.1, [set(r.called) - {OUTSIDE} != set() for r in at_two]
        ),
    ]


def _numbers(rows: list[Row], where: str) -> list[Goal]:
    right = [r for r in rows if r.kind in ("one", "two") and r.kin and r.gap]
    out = []
    if right:
        base, augmented, oracle = (sum(r.gap[k] for r in right) for k in ("base", "augmented", "oracle"))
        closed, left = (base - augmented) / (base - oracle), np.array([r.left for r in right])
        error = float(left.std() / math.sqrt(len(left)))
        far = float(np.mean(np.abs(left - 1) < 0.01))
        met = "too few" if len(right) < FEW else "yes"
        out.append(
            Goal(
                "gap closed on clips kept out, all together",
                where,
                ".99",
                f"{closed:.4f}",
                len(right),
                met if closed > 0.99 else "no",
            )
        )
        out.append(
            Goal(
                "augmented / oracle",
                where,
                "1.00 +- .01",
                f"{left.mean():.4f} +- {error:.4f}; {100 * far:.0f} % within",
                len(right),
                met if abs(left.mean() - 1) < 0.01 else "no",
            )
        )
    z = np.array([x for r in rows for x in r.z])
    for level, wanted in ((1.0, 0.6827), (1.96, 0.95)):
        p, _ = share(list(np.abs(z) < level))
        error = math.sqrt(wanted * (1 - wanted) / max(len(z), 1))
        met = "too few" if len(z) < 5 * FEW else "yes" if abs(p - wanted) < 3.5 * error else "no"
        text = f"coverage of the {100 * wanted:.0f} % interval, right names"
        out.append(
            Goal(text, where, f"within {350 * error:.1f} %", f"{100 * p:.1f} +- {100 * error:.1f} %", len(z), met)
        )
    cpu = np.array([r.cpu for r in rows if math.isfinite(r.cpu)])
    if len(cpu):
        text = f"{np.median(cpu):.0f} s median, {np.quantile(cpu, 0.95):.0f} s for 95 %, {cpu.max():.0f} s at most"
        met = "yes" if cpu.max() < 60 else "no"
        out.append(Goal("CPU of a search, one core", where, "60 s at most", text, len(cpu), met))
    return out
