"""A sealed box: a truth drawn from the seed of the study and the number of the box, and its experiment."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from discrepancy.data.study_design import split_held_out
from synthcam.library import library
from synthcam.model import Model
from synthcam.scene.clip import CONTACT_UPSTREAM_S, Clip
from synthcam.scene.scene import Scene, check_scene
from tracker.camera.camera import Camera

from . import worlds
from .fisher import Fisher, Noise, Rows
from .ordinary import ORDINARY
from .outsiders import OUTSIDERS, Outsider, in_clip

Truth = dict[str, Any]
FOREIGN = OUTSIDERS | ORDINARY | {"friction_of_clip": worlds.FrictionOfClip}

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
STRONGEST = 20.0  # times its limit
ALIKE = 0.98  # of the cosine: beyond it no data of this size part two effects


@dataclass(frozen=True)
class Study:
    """The distributions from which the boxes of a study are drawn.

    Weights by name. ratios: of strength to limit; none: drawn from `within`.

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
        """Return the seed of the boxes, which nobody can know without the secret."""
        return int(hashlib.sha256(f"{secret}/{self.name}".encode()).hexdigest(), 16)


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
    launch |= worlds.launch(truth.get("world", {}))
    timing: dict[str, Any] = {"frames": truth["frames"], "contact_frame": {"uniform": [20.0, 30.0]}}
    plain = {"name": "box", "model": truth["base"], "effects": hidden, "launch": launch, "timing": timing}
    plain |= {"camera": {"size": truth["size"]}, "lamp": {"position": list(truth.get("lamp") or LAMP)}}
    return check_scene(plain, "box")


def clips_of(truth: Truth) -> list[Clip]:
    """The clips as they were, outsiders and all."""
    scene, foreign = scene_of(truth), _foreign(truth)
    clips = [scene.draw(k, truth["seed"]) for k in range(truth["clips"])]
    bent = [dataclasses.replace(c.model, effects=(*c.model.effects, *foreign)) for c in clips]
    own = [in_clip(m, k, striker_is_a(c), launch_of(c)) for k, (c, m) in enumerate(zip(clips, bent, strict=True))]
    return [dataclasses.replace(c, model=m) for c, m in zip(clips, own, strict=True)]


def striker_is_a(clip: Clip) -> bool:
    return bool(clip.drawn["launch"]["striker"] == "a")


def launch_of(clip: Clip) -> Any:
    """x, y, t_c, v0, heading, b; and how the striker spins, where it does not roll."""
    launch = clip.drawn["launch"]
    place = -CONTACT_UPSTREAM_S * launch["v0"] * np.array([np.cos(launch["heading"]), np.sin(launch["heading"])])
    return np.array([*place, clip.launch.time, launch["v0"], launch["heading"], launch["b"], *worlds.spins(launch)])


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
    if world := truth.get("world"):
        paths = [xy.reshape(2, -1, 2) / SCALE for xy in places]
        there = [worlds.kept(world, k, p, truth["seed"]).ravel() for k, p in enumerate(paths)]
        seen = [s & t for s, t in zip(seen, there, strict=True)]
    cut = [dataclasses.replace(r, frame=frame[s], ball=ball[s]) for r, s in zip(every, seen, strict=True)]
    return list(split_held_out(cut)[0])  # type: ignore[arg-type]
