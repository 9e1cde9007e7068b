"""Judges the answer of an opened box: whether it is right, and how far off."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from synthcam.library import library

from .boxes import DEFECTS, FOREIGN
from .worlds import LAWS, UNDETECTABLE

INSIDE = 0.9  # of a true curve's places must lie in the 95 % band
OWNERS = {"friction": "sliding_friction", "restitution": "restitution", "spin_transfer": "spin_transfer"}
CENTRED = ("lag_speed", "warp_place")
NAMES = ("none", "one", "two", "outside", "ordinary", "defect", "hostile")
STRANGE = ("outside", "ordinary")  # kinds that no library holds
WIDEST = 6  # names: a larger class says nothing, and counts as the first name alone
OUTSIDE, INADEQUATE = "outside the library", "inadequate"


@dataclass(frozen=True)
class Row:
    """One opened box, judged. A claim is true when it, or its reported alias class, holds what is hidden.

    called: the claims, OUTSIDE and INADEQUATE among them. name, kin: all names right, all classes right, none too many.
    classes: as reported, however wide. z: errors of the rightly named strengths over their claimed standard deviations.
    """

    kind: str
    filmed: bool
    study: str
    hidden: tuple[str, ...]
    ratio: float
    naming: float
    nearest: float
    verdict: str
    called: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    false: tuple[str, ...]
    name: bool
    right_class: bool
    noise: str
    source: str
    free_law: bool = False
    curve: bool | None = None
    z: tuple[float, ...] = ()
    gap: dict[str, float] = field(default_factory=dict)
    seconds: float = math.nan
    cpu: float = math.nan
    box: int = -1
    withdrawn: tuple[str, ...] = ()  # claims that the answer takes back: none of its claims
    code: str = ""  # a fingerprint of what made the box and answered it
    world: str = ""  # of a hostile box
    in_model: bool = False  # does the answer's model hold the free law that was found?
    closes: tuple[bool, ...] = ()  # of each claim that stands: does it close part of the gap on clips kept out?

    @property
    def worked(self) -> bool:
        return self.verdict not in ("refused", "crashed")

    @property
    def detected(self) -> bool:
        """True if the search found something; `inadequate` is a miss where the library has the effect."""
        return self.worked and self.verdict != "none" and (self.kind in STRANGE or self.verdict != "inadequate")

    @property
    def right(self) -> bool:
        """By name; of an outsider: declared, with no name of the library beside it; of a defect: no false claim."""
        if self.kind in STRANGE:
            return self.declared and not self.false
        if self.kind == "hostile":
            return self.worked and not self.false and self._answered
        return self.worked and (not self.false if self.kind == "defect" else self.name)

    @property
    def nameable(self) -> bool:
        """Does a hostile box hide an effect of the library that its tracks can tell?"""
        return self.world not in UNDETECTABLE and any(h not in FOREIGN for h in self.hidden)

    @property
    def lawless(self) -> bool:
        """Is a hostile world one of laws that no library has?"""
        return self.world in LAWS

    @property
    def _answered(self) -> bool:
        """Is a hostile box answered as far as can be? Effects of the library by class, other laws by a declaration."""
        if self.nameable and not self.right_class:
            return False
        return self.declared if self.lawless else self.nameable or not self.called or self.declared

    @property
    def declared(self) -> bool:
        """Said to lie outside the library, or that something is missing which nothing tried explains."""
        return OUTSIDE in self.called or INADEQUATE in self.called

    @property
    def has_false_name(self) -> bool:
        """A false name of the library, whatever else was said."""
        return bool(set(self.false) - {OUTSIDE, INADEQUATE})

    @property
    def closure(self) -> float:
        """(base - augmented)/(base - oracle) on the clips kept out."""
        g = self.gap
        return (g["base"] - g["augmented"]) / (g["base"] - g["oracle"]) if g else math.nan

    @property
    def chi2_ratio(self) -> float:
        """augmented / oracle."""
        return self.gap["augmented"] / self.gap["oracle"] if self.gap else math.nan


def judge(line: dict[str, Any]) -> Row:
    """A line of NAME.jsonl, judged."""
    truth, answer = _resolve_outsider(line["truth"]), line["answer"]
    hidden, about = tuple(truth["effects"]), truth.get("about", [])
    named = [n["effect"] for n in answer.get("named", [])]
    classes = [next((tuple(a) for a in answer.get("aliases", []) if n in a), (n,)) for n in named]
    kins = [kin if len(kin) <= WIDEST else (n,) for n, kin in zip(named, classes, strict=True)]
    said = [word for word, verdict in WORDS.items() if answer["verdict"] == verdict]
    allowed = {*hidden, *_grid_effects(truth), *(n for d in truth["defect"] for n in DEFECTS[d])}
    false = [n for n, kin in zip(named, kins, strict=True) if not allowed & {n, *kin}]
    false += [word for word in said if truth["kind"] in FALSE[word]]
    world = truth.get("world", {}).get("name", "")
    if world and world not in LAWS and OUTSIDE in said:
        false.append(OUTSIDE)
    ours = [h for h in hidden if h not in FOREIGN]
    ratio = min((a["ratio"] for a in about), default=0.0)
    nearest = max((a["nearest"] for a in about), default=0.0)
    free_law, curve = _outside(truth, answer)
    return Row(
        kind=truth["kind"],
        filmed=truth["source"] == "video",
        study=truth["study"],
        hidden=hidden,
        ratio=ratio,
        naming=ratio * math.sqrt(max(1 - nearest**2, 0.0)),
        nearest=nearest,
        verdict=answer["verdict"],
        called=(*named, *said),
        classes=tuple(classes),
        false=tuple(false),
        name=not said and sorted(named) == sorted(ours) and len(ours) == len(hidden),
        right_class=_match_claims(ours, *_without_grid_effects(truth, named, kins))
        and ("gap" in answer if world else not said and len(ours) == len(hidden)),
        noise=truth["noise"],
        source=truth["source"],
        free_law=free_law,
        curve=curve,
        z=tuple(_errors(truth, answer)),
        gap=line.get("gap", {}),
        seconds=answer.get("seconds", math.nan),
        cpu=answer.get("cpu", math.nan),
        box=truth["box"],
        withdrawn=tuple(w["claim"] for w in answer.get("withdrawn", [])),
        code=answer.get("code", ""),
        world=world,
        in_model=any(entry.get("in_model", False) for entry in answer.get("outside") or []),
        closes=tuple(_closes(answer)),
    )


def _grid_effects(truth: dict[str, Any]) -> tuple[str, ...]:
    """Return the library's effect for a grid of whole pixels, if the world has one."""
    return ("pixel_locking",) if truth.get("world", {}).get("step", 0.0) >= 1 else ()


def _without_grid_effects(
    truth: dict[str, Any], named: list[str], kins: list[tuple[str, ...]]
) -> tuple[list[str], list[tuple[str, ...]]]:
    """Return names and classes without the effect that is true of a grid."""
    kept = [k for k, n in enumerate(named) if n in truth["effects"] or n not in _grid_effects(truth)]
    return [named[k] for k in kept], [kins[k] for k in kept]


def _closes(answer: dict[str, Any]) -> list[bool]:
    """Is the gap on the clips kept out smaller with each claim that stands? By the answer's own document."""
    gaps = answer.get("gap", {}).get("by_claim", {})
    return [g["with"] < g["without"] for g in gaps.values() if g["with"] is not None and g["without"] is not None]


WORDS = {OUTSIDE: "outside_library", INADEQUATE: "inadequate"}
# Kinds of boxes in which a word is a false claim. `inadequate` is a miss if an effect was hidden. It is right for a
# tracker's defect, for which the library has only a nearest name.
FALSE = {OUTSIDE: ("none", "one", "two", "defect"), INADEQUATE: ("none",)}


def _resolve_outsider(truth: dict[str, Any]) -> dict[str, Any]:
    """The truth; an outsider whose law the library has by now is a hidden effect like any other."""
    names = [_same(n) for n in truth["effects"]]
    if names == truth["effects"]:
        return truth
    return truth | {"kind": "one", "effects": names}


def _same(name: str) -> str:
    kind = FOREIGN.get(name)
    return next((n for n in kind.SAME if n in library()), name) if kind else name


def _match_claims(hidden: list[str], named: list[str], classes: list[tuple[str, ...]]) -> bool:
    """Is each claim, by its class, another hidden effect, and none left?"""
    if len(hidden) != len(named):
        return False
    if not hidden:
        return True
    first, *rest = hidden
    for k, (n, kin) in enumerate(zip(named, classes, strict=True)):
        if (first == n or first in kin) and _match_claims(
            rest, named[:k] + named[k + 1 :], classes[:k] + classes[k + 1 :]
        ):
            return True
    return False


def _errors(truth: dict[str, Any], answer: dict[str, Any]) -> list[float]:
    """(value - truth)/std of each strength that is named rightly; where all is right."""
    named = answer.get("named", [])
    if sorted(n["effect"] for n in named) != sorted(truth["effects"]):
        return []
    out = []
    for n in named:
        found = {k if "." in k else f"{n['effect']}.{k}": v for k, v in n["parameters"].items()}
        stds = {k if "." in k else f"{n['effect']}.{k}": v for k, v in (n.get("std") or {}).items()}
        hidden = align_conventions(n["effect"], truth["hidden"], found)
        for dotted in found:
            if stds.get(dotted) and dotted in hidden and dotted in strengths_of(n["effect"]):
                out.append((found[dotted] - hidden[dotted]) / stds[dotted])
    return out


def align_conventions(effect: str, hidden: dict[str, float], found: dict[str, float]) -> dict[str, float]:
    """The hidden values written as the found ones are, where two sets of numbers are one law.

    A wave that runs along angle, and one along angle + pi whose sine has the other sign, are the same wave. No other
    effect of the library has such a twin: their directions are pairs of components, their sizes bounded or odd.
    """
    if effect != "plate_waviness" or f"{effect}.angle" not in found:
        return hidden
    turns = round((found[f"{effect}.angle"] - hidden[f"{effect}.angle"]) / math.pi)
    turned = {f"{effect}.angle": hidden[f"{effect}.angle"] + turns * math.pi}
    return hidden | turned | {f"{effect}.b": hidden.get(f"{effect}.b", 0.0) * (-1) ** turns}


def strengths_of(effect: str) -> set[str]:
    """Dotted names; shapes, which mean little near the limit, are not judged."""
    kind = library().get(effect)
    return {f"{effect}.{p.name}" for p in kind.strengths()} if kind else set()


def _outside(truth: dict[str, Any], answer: dict[str, Any]) -> tuple[bool, bool | None]:
    """Is the first free law the right one, and does the true curve lie in its band? None: there is no curve to hold."""
    entries = answer.get("outside") or []
    if truth["kind"] != "outside" or not entries:
        return False, None
    kind = FOREIGN[truth["effects"][0]]
    first = entries[0]
    free_law = first["slot"] == kind.FREE_LAW
    own = {k.partition(".")[2]: v for k, v in truth["hidden"].items()}
    effect = kind(**own)
    if not free_law or not hasattr(effect, "_curve"):
        return free_law, None
    x = np.asarray(first["x"], dtype=float)
    axes = x.T if x.ndim == 2 else (x,)
    law = effect._curve(*axes) + _base_value(kind.FREE_LAW, axes[0], truth["base"])
    curve, band = (np.asarray(first[k], dtype=float) for k in ("curve", "band"))
    return free_law, curve.shape == law.shape and inside(law, band, kind.FREE_LAW in CENTRED)


def _base_value(free_law: str, x: Any, base: dict[str, float]) -> Any:
    """Return the law of the base model alone."""
    if free_law.startswith("rolling"):
        return base["rolling_decel"] + base["rolling_drag"] * x
    name = next((n for start, n in OWNERS.items() if free_law.startswith(start)), None)
    return base[name] if name else 0.0


def inside(law: Any, band: Any, centred: bool) -> bool:
    """Does the true law, of the curve's shape, lie in the band (..., 2)? centred: the launches absorb a constant."""
    if centred:
        law = law - law.mean(axis=0)
    return bool(np.mean((law >= band[..., 0]) & (law <= band[..., 1])) >= INSIDE)
