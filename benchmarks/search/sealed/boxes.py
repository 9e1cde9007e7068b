"""What a box holds: a truth drawn from the study's seed and the box's number, and the experiment it hides in."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from discrepancy.data.collisions import split
from synthcam.effect import Effect
from synthcam.library import library
from synthcam.model import Model
from synthcam.scene.clip import UPSTREAM, Clip
from synthcam.scene.scene import Scene, check_scene
from tracker.camera.camera import Camera

from .fisher import CLASS, FREE, Fisher, Noise, Rows
from .integrator import PHYSICS
from .ordinary import ORDINARY, UNKNOWN
from .outsiders import OUTSIDERS, Outsider, in_clip

Truth = dict[str, Any]
FOREIGN = OUTSIDERS | ORDINARY

STD = 5e-6  # m, of the tracks' noise
VIDEO_STD = 1.5e-6  # m, .009 px: what the tracker reaches
SCALE, SIZE = 1.6e-4, (640, 480)
AT = (0.85, 1.2)  # a strength within this factor of another counts as that one, here and in every goal
NOISES = {
    "white": Noise(STD),
    "correlated .5": Noise(STD, rho=0.5),
    "correlated .9": Noise(STD, rho=0.9),
    "shake": Noise(STD, shake=0.6 * STD),
}
LAMP = (0.05, 0.0, 0.45)  # m, the scene's own
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
DEFECTS = {
    "pixel_locking": ("pixel_locking", "aspect_error"),  # what the library may call it; or nothing at all
    # a slanting lamp's glints stretch the picture, and by 1.6e-5 more along one axis
    "glint": ("unknown_lamp", "glint_parallax", "scale_error", "aspect_error", "lens_distortion"),
    "lamp": ("glint_parallax", "scale_error", "lens_distortion"),
    "scale": ("scale_error", "glint_parallax", "lens_distortion"),
}
UNDRAWN = {  # effects of the library that no box hides, and why
    "adhesion": "a sliding friction of mu (1 + pull) makes the same tracks",
    "clock_error": "v0 and drag times f, mu and decel times f^2 make the same tracks",
}
LIT = {"unknown_lamp": "untold", "glint_parallax": "low"}  # the light in which these effects show
LIGHTS = {"usual": 0.8, "untold": 0.1, "low": 0.1}  # and how often others have it, so that it tells nothing
STRONGEST = 20.0  # times its limit
ALIKE = 0.98  # of the cosine: beyond it no data of this size part two effects
TRIES = 60
STUBBORN = 8  # of them for the effect whose turn it is


@dataclass(frozen=True)
class Study:
    """What the boxes of a study are drawn from. Weights by name; ratios: of strength to limit, none: `within`.

    naming: ratios are of the naming limit, where the nearest rival would be 5 sigma off. filmed: through the tracker.
    The effects take turns: box k of a study hides the k-th of them first, in an order that its seed makes.
    """

    name: str
    kinds: Mapping[str, float]
    boxes: int
    ratios: tuple[float, ...] = ()
    within: tuple[float, float] = (AT[0], STRONGEST)
    noises: Mapping[str, float] = field(
        default_factory=lambda: {"white": 0.4, "correlated .5": 0.2, "correlated .9": 0.2, "shake": 0.2}
    )
    integrated: float = 0.3  # share of the boxes whose tracks come from the integrator, where it knows the effects
    exchanged: float = 0.5  # share of the boxes in which either ball is launched
    clips: int = 30
    frames: int = 90
    size: tuple[int, int] = SIZE  # px
    naming: bool = False
    filmed: bool = False
    effects: tuple[str, ...] = ()  # to hide; none: all that the search could find
    all: bool = False  # each of them: the integrator makes the tracks only where it knows the effect

    def seed(self, secret: str) -> int:
        """What its boxes are drawn with: nobody who lacks the secret can know them."""
        return int(hashlib.sha256(f"{secret}/{self.name}".encode()).hexdigest(), 16)


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
    if not study.filmed:
        truth["claimed"] = float(np.exp(rng.uniform(np.log(0.8), np.log(1.25))))
    turns = [str(n) for n in np.random.default_rng(seed).permutation(sorted(_candidates(study, kind, integrated)))]
    if kind != "defect" and not study.filmed:
        truth["lamp"] = _lamp(rng, LIT.get(turns[box % len(turns)]) or _one_of(rng, LIGHTS))
    if kind == "defect":
        truth["defect"] = _defect(rng, study.filmed)
    elif kind != "none":
        _hide(truth, rng, study, 2 if kind == "two" else 1, turns)
    if not study.filmed and integrated and set(truth["effects"]) <= set(PHYSICS):
        truth["source"] = "integrator"
    return truth


def _lamp(rng: np.random.Generator, light: str) -> list[float] | None:
    """Where camera.json says the lamp is; None: it does not say."""
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
        "glint": 1.0,  # taken for the centre
        "lamp": sign * rng.uniform(0.002, 0.01),  # m, each way
        "scale": sign * np.exp(rng.uniform(np.log(1e-4), np.log(2e-3))),
    }
    return {which: float(size[which])}


def _hide(truth: Truth, rng: np.random.Generator, study: Study, count: int, turns: list[str]) -> None:
    """Draw `count` effects, and their strengths as ratios to the detection limits of this box's own design.

    The first is the one whose turn it is, unless this design cannot show it.
    """
    noise = Noise(VIDEO_STD) if study.filmed else NOISES[truth["noise"]]
    fisher = Fisher(base_model(truth), fitted(truth), noise)
    entries: list[dict[str, Any]] = []
    for attempt in range(TRIES):
        name = turns[truth["box"] % len(turns)]
        if entries or attempt >= STUBBORN:
            name = str(rng.choice([c for c in turns if c not in [e["effect"] for e in entries]]))
        kind = library().get(name) or FOREIGN[name]
        shapes, way = _shapes(kind, rng), _way(kind, rng)
        ratio = float(rng.choice(study.ratios)) if study.ratios else float(np.exp(rng.uniform(*np.log(study.within))))
        entry = _entry(fisher, kind, shapes, way, ratio, study.naming)
        if entry is not None:
            entries.append(entry)
        if len(entries) == count:
            if count == 1 or _moves(fisher, entries):
                break
            entries.clear()  # together they leave no motion
    else:
        raise ValueError(f"{truth['study']}, box {truth['box']}: no effect can be seen in it")
    for entry in entries:
        truth["hidden"] |= entry.pop("values")
    truth["effects"] = [e["effect"] for e in entries]
    truth["about"] = entries


def _moves(fisher: Fisher, entries: list[dict[str, Any]]) -> bool:
    """Has the experiment a motion with all these effects of the library?"""
    try:
        fisher.signature(fisher.model.replace({k: v for e in entries for k, v in e["values"].items()}))
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
    if not 0 < shutter <= 1 / camera.fps:  # no shutter opens for less than no time, nor into the next frame
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


def base_model(truth: Truth) -> Model:
    return Model().replace(truth["base"])


def model_of(truth: Truth) -> Model:
    """The model that made the tracks."""
    ours = {k: v for k, v in truth["hidden"].items() if k.partition(".")[0] in library()}
    model = base_model(truth).replace(ours)
    return dataclasses.replace(model, effects=(*model.effects, *_foreign(truth)))


def _foreign(truth: Truth) -> list[Outsider]:
    out = []
    for name in truth["effects"]:
        if name in FOREIGN:
            own = {k.partition(".")[2]: v for k, v in truth["hidden"].items() if k.startswith(f"{name}.")}
            out.append(FOREIGN[name](**own))
    return out


def scene_of(truth: Truth, effects: bool = True) -> Scene:
    """The experiment. effects: with those hidden that a scene may have."""
    hidden: dict[str, dict[str, float]] = {}
    for key, value in truth["hidden"].items() if effects else ():
        name, _, parameter = key.partition(".")
        if name in library() and "measure" not in library()[name].laws:
            hidden.setdefault(name, {})[parameter] = value
    launch: dict[str, Any] = {"v0": {"uniform": [0.1, 0.6]}, "b": {"uniform": [-0.6, 0.6]}}
    launch["heading"] = {"uniform": [0.0, 2 * math.pi]}
    launch["striker"] = {"choice": ["a", "b"] if truth["exchanged"] else ["b"]}
    timing = {"frames": truth["frames"], "contact_frame": {"uniform": [20.0, 30.0]}}
    plain = {"name": "box", "model": truth["base"], "effects": hidden, "launch": launch, "timing": timing}
    plain |= {"camera": {"size": truth["size"]}, "lamp": {"position": list(truth.get("lamp") or LAMP)}}
    return check_scene(plain, "box")


def clips_of(truth: Truth) -> list[Clip]:
    """The clips as they were, outsiders and all."""
    scene, foreign = scene_of(truth), _foreign(truth)
    clips = [scene.draw(k, truth["seed"]) for k in range(truth["clips"])]
    bent = [dataclasses.replace(c.model, effects=(*c.model.effects, *foreign)) for c in clips]
    own = [in_clip(m, k, launched_a(c), launch_of(c)) for k, (c, m) in enumerate(zip(clips, bent, strict=True))]
    return [dataclasses.replace(c, model=m) for c, m in zip(clips, own, strict=True)]


def launched_a(clip: Clip) -> bool:
    return bool(clip.drawn["launch"]["striker"] == "a")


def launch_of(clip: Clip) -> Any:
    """x, y, t_c, v0, heading, b."""
    launch = clip.drawn["launch"]
    place = -UPSTREAM * launch["v0"] * np.array([np.cos(launch["heading"]), np.sin(launch["heading"])])
    return np.array([*place, clip.launch.time, launch["v0"], launch["heading"], launch["b"]])


def camera_of(truth: Truth) -> Camera:
    """The camera of a box, as its file has it."""
    return Camera.from_dict(camera_file(truth, scene_of(truth, effects=False).draw(0, truth["seed"])))


def camera_file(truth: Truth, clip: Clip) -> dict[str, Any]:
    """camera.json, which may say nothing of the lamp."""
    known = clip.camera_json
    return known if truth.get("lamp", LAMP) else {k: v for k, v in known.items() if k != "lamp"}


def fitted(truth: Truth) -> list[Rows]:
    """The clips that the search will fit, with the rows in which a ball is in view when nothing is hidden."""
    scene, camera = scene_of(truth, effects=False), camera_of(truth)
    frame, ball = np.tile(np.arange(truth["frames"]), 2), np.repeat([0, 1], truth["frames"])
    every = []
    for k in range(truth["clips"]):
        clip = scene.draw(k, truth["seed"])
        every.append(Rows(clip.drawn["launch"]["striker"], camera, frame, ball, launch_of(clip), k))
    places = Fisher.places(base_model(truth), every)
    half = np.array(truth["size"]) / 2 * SCALE - camera.radius
    seen = [(np.abs(xy) < half).all(axis=1) for xy in places]
    cut = [dataclasses.replace(r, frame=frame[s], ball=ball[s]) for r, s in zip(every, seen, strict=True)]
    return list(split(cut)[0])  # type: ignore[arg-type]
