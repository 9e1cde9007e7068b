"""How a box is drawn from a study's seed and the box's number: what is hidden in it, and how large."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from synthcam.effect import Effect
from synthcam.library import library
from synthcam.model import Model

from . import worlds
from .boxes import (
    ALIKE,
    DEFECTS,
    FOREIGN,
    LAMP,
    NOISES,
    SCALE,
    UNDRAWN,
    VIDEO_STD,
    Study,
    Truth,
    base_model,
    fitted,
    model_of,
)
from .fisher import CLASS, FREE, Fisher, Noise
from .integrator import PHYSICS
from .ordinary import UNKNOWN
from .outsiders import OUTSIDERS

LOW = (0.08, 0.2)  # m: so low stands the lamp where glints are to lie far from the centres
SHAPES: dict[str, tuple[float, float]] = {
    "stribeck.slip": (0.03, 0.3),
    "hop.bounce": (0.2, 0.6),
    "plate_waviness.wavelength": (0.01, 0.05),
    "plate_waviness.angle": (0.1, 3.1),
    "ball_friction.mu": (0.1, 0.2),
    "dropped_frame.frame": (30, 60),
    "unknown_lamp.height": LOW,
}
LIT = {"unknown_lamp": "untold", "glint_parallax": "low"}  # the light in which these effects show
LIGHTS = {"usual": 0.8, "untold": 0.1, "low": 0.1}  # and how often others have it, so that it tells nothing
TRIES = 60
STUBBORN = 8  # of them for the effect whose turn it is


def draw(study: Study, box: int, secret: str) -> Truth:
    """The truth of a box, plain enough for JSON."""
    seed = study.seed(secret)
    rng = np.random.default_rng([seed, box])
    kind, noise = _one_of(rng, study.kinds), _one_of(rng, study.noises)
    truth: Truth = {"study": study.name, "box": box, "kind": kind, "seed": int(rng.integers(2**31))}
    truth |= {"noise": "tracker" if study.filmed else noise, "claimed": 1.0, "clips": study.clips}
    truth |= {"frames": study.frames, "size": list(study.size), "exchanged": bool(rng.random() < study.exchanged)}
    truth["exchanged"] |= kind == "ordinary"  # many are of one ball
    truth["base"] = {k: float(getattr(Model(), k) * rng.uniform(0.9, 1.1)) for k in FREE}
    truth |= {"hidden": {}, "effects": [], "source": "video" if study.filmed else "synthcam", "defect": {}}
    truth["lamp"] = list(LAMP)
    integrated = rng.random() < study.integrated
    if kind == "hostile":
        truth["world"] = _world(rng, seed, box)
    if not study.filmed:
        truth["claimed"] = float(np.exp(rng.uniform(np.log(0.8), np.log(1.25))))
    turns = [str(n) for n in np.random.default_rng(seed).permutation(sorted(_candidates(study, kind, integrated)))]
    if kind == "hostile":
        turns = [n for n in turns if _fits(n, truth["world"])]
    if kind != "defect" and not study.filmed:
        truth["lamp"] = _lamp(rng, LIT.get(turns[box % len(turns)]) or _one_of(rng, LIGHTS))
    if kind == "defect":
        truth["defect"] = _defect(rng, study.filmed)
    elif kind == "hostile":
        _hide(truth, rng, study, _in_world(rng, truth["world"], box, turns))
    elif kind != "none":
        _hide(truth, rng, study, [turns] * (2 if kind == "two" else 1))
    if not study.filmed and integrated and set(truth["effects"]) <= set(PHYSICS):
        truth["source"] = "integrator"
    return truth


def _lamp(rng: np.random.Generator, light: str) -> list[float] | None:
    """The lamp's position by camera.json; None if it has none."""
    low = [*(rng.choice([-1, 1], 2) * rng.uniform(0.05, 0.15, 2)), rng.uniform(*LOW)]
    return {"usual": list(LAMP), "untold": None, "low": [float(x) for x in low]}[light]


def _one_of(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    shares = np.array(list(weights.values()))
    return str(rng.choice(list(weights), p=shares / shares.sum()))


def _candidates(study: Study, kind: str, integrated: bool) -> list[str]:
    known = [n for n, e in library().items() if n not in UNDRAWN and not (study.filmed and "measure" in e.laws)]
    if kind in ("outside", "ordinary"):
        kinds = OUTSIDERS if kind == "outside" else UNKNOWN
        known = [n for n in kinds if FOREIGN[n].VIDEO or not study.filmed]
    known = [n for n in known if n in (study.effects or known)]
    ours = [n for n in known if n in PHYSICS]
    return ours if integrated and ours and not study.filmed and not study.all else known


def _defect(rng: np.random.Generator, filmed: bool) -> dict[str, float]:
    """A tracker or an experimenter at fault, in sizes that happen."""
    which = str(rng.choice(["glint", "lamp", "scale"] if filmed else list(DEFECTS)))
    sign = float(rng.choice([-1, 1]))
    size = {
        "pixel_locking": sign * np.exp(rng.uniform(np.log(0.003), np.log(0.03))),  # px
        "glint": 1.0,  # mistaken for the centre
        "lamp": sign * rng.uniform(0.002, 0.01),  # m, each way
        "scale": sign * np.exp(rng.uniform(np.log(1e-4), np.log(2e-3))),
    }
    return {which: float(size[which])}


def _world(rng: np.random.Generator, seed: int, box: int) -> worlds.World:
    """The worlds take turns."""
    order = np.random.default_rng([seed, 1]).permutation(sorted(worlds.WORLDS))
    name = str(order[box % len(order)])
    return {"name": name} | worlds.WORLDS[name](rng)


def _fits(effect: str, world: worlds.World) -> bool:
    """Can this effect of the library be drawn, and told, in this world?"""
    return not {effect, *library()[effect].laws} & set(worlds.UNFIT.get(world["name"], ()))


def _in_world(rng: np.random.Generator, world: worlds.World, box: int, turns: list[str]) -> list[list[str]]:
    """Return the names to draw from in a hostile world: nothing or one effect, and the laws of the world.

    An effect is hidden in every other turn of a world, as one of the two laws of two.
    """
    pools = [turns] if box // len(worlds.WORLDS) % 2 else []
    if world["name"] == "friction_of_clip":
        pools += [["friction_of_clip"]]
    if world["name"] == "two_laws":
        laws = [str(n) for n in rng.permutation([*OUTSIDERS, *UNKNOWN])]
        pools += [laws] * (2 - len(pools))
    return pools


def _designs(truth: Truth, study: Study) -> Callable[[str], Fisher]:
    """Return the Fisher information of the tracks of a box about an effect, by its name."""
    noise = Noise(VIDEO_STD) if study.filmed else NOISES[truth["noise"]]
    world = truth.get("world", {})
    noise = dataclasses.replace(noise, std=worlds.scale_noise(world, noise.std, SCALE))
    plain = Fisher(base_model(truth), fitted(truth), noise)
    if world.get("name") != "friction_of_clip":
        return lambda name: plain
    own = Fisher(base_model(truth), fitted(truth), noise, ("sliding_friction",))
    return lambda name: plain if name in FOREIGN else own


def _hide(truth: Truth, rng: np.random.Generator, study: Study, pools: Sequence[list[str]]) -> None:
    """Draw an effect of each pool, and their strengths as ratios to the detection limits of this box's own design.

    The first is the one whose turn it is, unless this design cannot show it.
    """
    if not pools:
        return
    design = _designs(truth, study)
    entries: list[dict[str, Any]] = []
    for attempt in range(TRIES):
        turns = pools[len(entries)]
        name = turns[truth["box"] % len(turns)]
        if entries or attempt >= STUBBORN:
            name = str(rng.choice([c for c in turns if c not in [e["effect"] for e in entries]]))
        kind = library().get(name) or FOREIGN[name]
        shapes, way = _shapes(kind, rng), _way(kind, rng)
        ratio = float(rng.choice(study.ratios)) if study.ratios else float(np.exp(rng.uniform(*np.log(study.within))))
        entry = _entry(design(name), kind, shapes, way, ratio, study.naming)
        if entry is not None:
            entries.append(entry)
        if len(entries) == len(pools):
            if len(pools) == 1 or _moves(truth, design(""), entries):
                break
            entries.clear()  # together they leave no motion
    else:
        raise ValueError(f"{truth['study']}, box {truth['box']}: no effect can be seen in it")
    _write(truth, entries)


def _write(truth: Truth, entries: list[dict[str, Any]]) -> None:
    for entry in entries:
        truth["hidden"] |= entry.pop("values")
    truth["effects"] = [e["effect"] for e in entries]
    truth["about"] = entries


def _moves(truth: Truth, fisher: Fisher, entries: list[dict[str, Any]]) -> bool:
    """Has the experiment a motion with all these effects?"""
    whole = truth | {"hidden": {}}
    _write(whole, [dict(e) for e in entries])
    try:
        fisher.signature(model_of(whole))
    except ValueError:
        return False
    return True


def _shapes(kind: type[Effect], rng: np.random.Generator) -> dict[str, float]:
    out = {}
    for p in kind.parameters():
        if p.fixed and not p.given:
            low, high = SHAPES.get(f"{kind.name()}.{p.name}") or (0.8 * p.typical, 1.25 * p.typical)
            out[p.name] = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return out


def _way(kind: type[Effect], rng: np.random.Generator) -> dict[str, float]:
    """A direction among the effect's strengths, in realistic sizes; within the signs they may have."""
    parts = rng.standard_normal(len(kind.strengths()))
    way = parts / np.linalg.norm(parts)
    return {
        p.name: float(p.typical * (abs(w) if p.low >= 0 else w)) for p, w in zip(kind.strengths(), way, strict=True)
    }


def _entry(
    fisher: Fisher, kind: type[Effect], shapes: dict[str, float], way: dict[str, float], ratio: float, naming: bool
) -> dict[str, Any] | None:
    """One hidden effect, its limit and its likenesses; None where the experiment could not show it at this size."""

    def hidden(strength: float) -> Model:
        effect = kind(**shapes, **{k: strength * w for k, w in way.items()})
        return dataclasses.replace(fisher.model, effects=(*fisher.model.effects, effect))

    bounds = {p.name: p for p in kind.strengths()}
    most = min((bounds[k].high if w > 0 else -bounds[k].low) / abs(w) for k, w in way.items() if w)
    limit = fisher.limit(hidden, 0.01, most / ratio)
    if limit is None:
        return None
    signature, name = fisher.signature(hidden(limit)), kind.name()
    dotted = {f"{name}.{k}": v for k, v in shapes.items()}
    like = fisher.likeness(signature, name, dotted)
    nearest = max(like.values())
    if naming:
        ratio /= math.sqrt(max(1 - nearest**2, 1e-12))
        if nearest > ALIKE or limit * ratio > most:
            return None
    truth, camera = hidden(limit * ratio), fisher.rows[0].camera
    shutter = truth.laws("exposure", camera.exposure, {"fps": camera.fps})
    if not 0 < shutter <= 1 / camera.fps:  # the exposure must be positive and end before the next frame
        return None
    try:
        fisher.signature(truth)
    except ValueError:
        return None
    return {
        "effect": name,
        "values": dotted | {f"{name}.{k}": limit * ratio * w for k, w in way.items()},
        "ratio": ratio,
        "limit": limit,
        "nearest": nearest,
        "class": sorted(n for n, cosine in like.items() if cosine > CLASS),
    }
