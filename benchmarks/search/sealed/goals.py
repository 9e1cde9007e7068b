"""The goals of the search, each with the figure reached, the trials it rests on and its sampling error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import beta

from .boxes import ALIKE, AT
from .judge import Row

SURE = 0.95  # of a bound on one side
FEW = 10  # boxes: the scatter of fewer says nothing of a mean
AGAIN = 2000  # draws of the bootstrap
Z = 1.645  # errors to a bound
WORSE = 0.1  # of chi^2: a law in a model may leave so much more than the true law
FITS = 500  # whose coverage is asked for
FROM = 0.999  # of a ratio: from there on it is "from that on", however it is rounded


@dataclass(frozen=True)
class Goal:
    """text, where ("tracks" or "video"); reached of n trials, with its bounds; met: yes, no, or not shown.

    beside: what must be known to read it, as the sizes of the classes that counted.
    """

    text: str
    where: str
    wanted: str
    reached: str
    n: int
    met: str
    bounds: str = ""
    beside: str = ""


def near(rows: Iterable[Row], ratio: float, naming: bool = False) -> list[Row]:
    """Those whose strength is .85 to 1.2 times `ratio` times the (naming) limit."""
    values = [(r, r.naming if naming else r.ratio) for r in rows]
    return [r for r, v in values if AT[0] * ratio <= v <= AT[1] * ratio]


def share(hits: Sequence[bool]) -> tuple[float, float]:
    """A share and its binomial error, which is not zero where all or none hit."""
    n, k = len(hits), sum(hits)
    p = (k + 0.5) / (n + 1)
    return (k / n if n else math.nan), math.sqrt(p * (1 - p) / (n + 1))


def bounds(hits: Sequence[bool]) -> tuple[float, float]:
    """Clopper and Pearson's lower and upper bound of a share, each alone with 95 %."""
    n, k = len(hits), sum(hits)
    low = float(beta.ppf(1 - SURE, k, n - k + 1)) if k else 0.0
    return low, float(beta.ppf(SURE, k + 1, n - k)) if k < n else 1.0


def verdict(yes: bool, no: bool) -> str:
    return "yes" if yes else "no" if no else "not shown"


def at_least(text: str, where: str, wanted: float, hits: Sequence[bool], beside: str = "") -> Goal:
    low, high = bounds(hits)
    return _share(text, where, f"{100 * wanted:g} %", hits, verdict(low >= wanted, high < wanted), beside)


def at_most(text: str, where: str, wanted: float, hits: Sequence[bool]) -> Goal:
    low, high = bounds(hits)
    return _share(text, where, f"under {100 * wanted:g} %", hits, verdict(high <= wanted, low > wanted))


def at_most_count(text: str, where: str, most: int, of: int, hits: Sequence[bool]) -> Goal:
    """A goal that is itself a count: at most so many in so many."""
    part = sum(hits) / most * of
    met = verdict(part <= len(hits) >= of, part > max(len(hits), of))
    return _share(text, where, f"at most {most} in {of}", hits, met)


def _share(text: str, where: str, wanted: str, hits: Sequence[bool], met: str, beside: str = "") -> Goal:
    if not hits:
        return Goal(text, where, wanted, "-", 0, "not shown")
    p, error = share(hits)
    low, high = bounds(hits)
    reached = f"{sum(hits)} of {len(hits)}, {100 * p:.1f} +- {100 * error:.1f} %"
    return Goal(text, where, wanted, reached, len(hits), met, f"{100 * low:.1f} to {100 * high:.1f} %", beside)


def sizes(rows: Iterable[Row]) -> str:
    """How many names the reported classes hold, where a class counted: a class of everything would always be right."""
    many = [len(c) for r in rows if r.right_class for c in r.classes]
    return f"classes of {np.mean(many):.1f} names, {max(many)} at most" if many else ""


def goals(every: Sequence[Row]) -> list[Goal]:
    """The table of goals, from tracks and from video."""
    out = []
    for where, filmed in (("tracks", False), ("video", True)):
        asked = [r for r in every if r.filmed == filmed]
        rows = [r for r in asked if r.worked and r.kind != "hostile"]
        if asked:
            out.append(at_least("an answer at all", where, 1.0, [r.worked for r in asked if r.kind != "hostile"]))
            out += _hostile([r for r in asked if r.kind == "hostile"], where)
        if rows:
            out += _claims(rows, where) + _names(rows, where) + _outside(rows, where)
            out += _ordinary(rows, where) + _numbers(rows, where)
    return out


def _claims(rows: list[Row], where: str) -> list[Goal]:
    plain = [r for r in rows if r.kind == "none" and r.noise in ("white", "tracker")]
    hard = [r for r in rows if r.kind == "none" and r not in plain]
    defects = [r for r in rows if r.kind == "defect"]
    one = [r for r in rows if r.kind == "one"]
    limit = 1.5 if where == "video" else 1.0
    claims = [c in r.false for r in rows for c in r.called]
    seen = [r.detected for r in near(one, limit)]
    return [
        at_most_count("a false claim, nothing hidden", where, 2, 300, [bool(r.false) for r in plain]),
        at_most("likewise with correlated noise or shake", where, 0.02, [bool(r.false) for r in hard]),
        at_most("likewise with a tracker's defect", where, 0.02, [bool(r.false) for r in defects]),
        at_least(f"detected at {limit:g} x its limit (.85 to 1.2 of that)", where, 0.8, seen),
        at_most("false discoveries among all claims", where, 0.03, claims),
    ]


def _names(rows: list[Row], where: str) -> list[Goal]:
    one, two = ([r for r in rows if r.kind == kind] for kind in ("one", "two"))
    parted = [r for r in one if r.nearest < ALIKE]
    alike = [r for r in one if r.nearest >= ALIKE and r.ratio >= 2 * FROM and r.detected]
    pairs = [r for r in two if r.ratio >= 5 * FROM]
    strong = [r for r in pairs if r.nearest < ALIKE]
    at_two, beyond = near(one, 2), [r for r in one if r.ratio >= 2 * FROM]
    return [
        at_least("right name at 2 x its naming limit", where, 0.98, [r.name for r in near(parted, 2, naming=True)]),
        at_least("right name from there on", where, 0.98, [r.name for r in parted if r.naming >= 2 * FROM]),
        at_least("right class at 2 x its limit", where, 0.99, [r.right_class for r in at_two], sizes(at_two)),
        at_least("right class from there on", where, 0.99, [r.right_class for r in beyond], sizes(beyond)),
        at_least(
            "aliases (cos over .98): always a class",
            where,
            1.0,
            [r.right_class and any(len(c) > 1 for c in r.classes) for r in alike],
            sizes(alike),
        ),
        at_least("two effects, from 5 x their limits: both right", where, 0.95, [r.name for r in strong]),
        at_least("both classes right", where, 0.98, [r.right_class for r in pairs], sizes(pairs)),
    ]


def _outside(rows: list[Row], where: str) -> list[Goal]:
    out = [r for r in rows if r.kind == "outside"]
    strong = [r for r in out if r.ratio >= 5 * FROM]
    curves = [bool(r.curve) for r in strong if r.curve is not None]
    near_truth = [r.chi2_ratio < 1 + WORSE for r in strong if r.in_model and r.gap]
    text = "outside the library, from 5 x: declared, with no false name"
    return [
        at_least(text, where, 0.98, [r.right for r in strong], split(strong)),
        at_least("the right free law", where, 0.95, [r.free_law for r in strong]),
        at_least("the curve in its band", where, 0.9, curves),
        at_least("the law in the model: gap on clips kept out within 10 % of the true law's", where, 0.9, near_truth),
        at_most("at 2 x: called by a name of the library", where, 0.1, [r.has_false_name for r in near(out, 2)]),
    ]


def _ordinary(rows: list[Row], where: str) -> list[Goal]:
    out = [r for r in rows if r.kind == "ordinary"]
    strong = [r for r in out if r.ratio >= 5 * FROM]
    weak = [r.has_false_name for r in near(out, 2)]
    text = "an ordinary fault without a free law, from 5 x: declared, with no false name"
    return [
        at_least(text, where, 0.95, [r.right for r in strong], split(strong)),
        at_most("an ordinary fault at 2 x: called by a name of the library", where, 0.1, weak),
    ]


def _hostile(rows: list[Row], where: str) -> list[Goal]:
    """A box that is refused makes no false claim and names nothing."""
    if not rows:
        return []
    plain = [r for r in rows if not r.hidden]
    laws = [r for r in rows if r.lawless]
    named = [r.right_class for r in rows if r.nameable]
    return [
        at_least("hostile worlds: an answer at all", where, 1.0, [r.worked for r in rows]),
        at_most("hostile worlds: a box with a false claim", where, 0.02, [bool(r.false) for r in rows]),
        at_least("an effect of the library at 5 to 12 x: named, by its class", where, 0.95, named),
        at_least("a law that no library has: outside_library or inadequate", where, 0.95, [r.declared for r in laws]),
        at_least("nothing missing: none, or inadequate", where, 0.95, [r.right for r in plain]),
        at_least("a claim that stands closes part of the gap", where, 1.0, [c for r in rows for c in r.closes]),
    ]


def split(rows: Sequence[Row]) -> str:
    """How many of these outsiders were declared at all, and how, and how many had a false name."""
    if not rows:
        return ""
    told = sum(r.verdict == "inadequate" for r in rows)
    declared = sum(r.declared for r in rows)
    return f"declared {declared}, {told} of them inadequate; with a false name {sum(r.has_false_name for r in rows)}"


def with_gap(rows: Iterable[Row]) -> list[Row]:
    """Boxes that hide what the library has, in which something was found, right or wrong."""
    return [r for r in rows if r.kind in ("one", "two") and r.detected and r.gap]


def _numbers(rows: list[Row], where: str) -> list[Goal]:
    out = _gap(with_gap(rows), where)
    z = np.array([x for r in rows for x in r.z])
    for level, wanted in ((1.0, 0.6827), (1.96, 0.95)):
        hits = [bool(x) for x in np.abs(z) < level]
        off, error = abs(share(hits)[0] - wanted), math.sqrt(wanted * (1 - wanted) / max(len(z), 1))
        met = verdict(off < 3.5 * error and len(z) >= FITS, off >= 3.5 * error)
        text = f"coverage of the {100 * wanted:.0f} % interval, right names"
        out.append(_share(text, where, f"within {350 * error:.1f} %, {FITS} fits", hits, met))
    cpu = np.array([r.cpu for r in rows if math.isfinite(r.cpu)])
    if len(cpu):
        text = f"{np.median(cpu):.0f} s median, {np.quantile(cpu, 0.95):.0f} s for 95 %, {cpu.max():.0f} s at most"
        met = "yes" if cpu.max() < 60 else "no"
        out.append(Goal("CPU of a search, one core", where, "60 s at most", text, len(cpu), met))
    return out


def _gap(found: list[Row], where: str) -> list[Goal]:
    """Return the share of the held-out gap that the answers close (sum, median), beside that of the true model."""
    if not found:
        return []
    base, augmented, oracle = np.array([[r.gap[k] for k in ("base", "augmented", "oracle")] for r in found]).T
    drawn = np.random.default_rng(0).integers(len(found), size=(AGAIN, len(found)))
    summed = (base - augmented)[drawn].sum(axis=1) / (base - oracle)[drawn].sum(axis=1)
    closed, left = np.array([r.closure for r in found]), np.array([r.chi2_ratio for r in found])
    whole = float((base - augmented).sum() / (base - oracle).sum())
    off, error = abs(float(left.mean()) - 1), float(left.std() / math.sqrt(len(left)))
    far = float(np.mean(np.abs(left - 1) < 0.01))
    met = verdict(len(left) >= FEW and off + Z * error < 0.01, len(left) >= FEW and off - Z * error > 0.01)
    reached, held = f"{left.mean():.4f} +- {error:.4f}; {100 * far:.0f} % within", f"+- {Z * error:.4f}"
    return [
        _closed("gap closed on clips kept out, where something was found: summed", where, len(left), whole, summed),
        _closed("the median box", where, len(left), float(np.median(closed)), np.median(closed[drawn], axis=1)),
        Goal("augmented / oracle", where, "1.00 +- .01", reached, len(left), met, held),
    ]


def _closed(text: str, where: str, n: int, value: float, again: Any) -> Goal:
    low, high = np.quantile(again, [1 - SURE, SURE])
    met = verdict(n >= FEW and low >= 0.99, n >= FEW and high < 0.99)
    return Goal(text, where, ".99", f"{value:.4f}", n, met, f"{low:.4f} to {high:.4f}")
