"""Cases of films in colour: shadows, hands and cues, balls of several colours, and hints of the user."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.tracker.ordinary.case import Case, Words
from benchmarks.tracker.ordinary.judges import Found, Said
from benchmarks.tracker.ordinary.sources import discs, film_discs, track, write_camera

colour: Any = importlib.import_module("tracker_colours")
CREAM, PAPER = (225.0, 200.0, 150.0), (205.0, 210.0, 200.0)
PAIR = discs.apart(colour.FRAMES)
MIDDLE = int(PAIR[:, :, 1].mean())  # the row between two balls
BLUE, DARK_GREEN, CRIMSON = (30.0, 60.0, 110.0), (20.0, 120.0, 60.0), (190.0, 40.0, 60.0)


def track_pictures(draw: Callable[[], NDArray[Any]], *options: str) -> Callable[[Path], Words]:
    """Pictures in colour, a file for each frame, and `tracker track` of their folder."""

    def make(folder: Path) -> Words:
        (folder / "film").mkdir()
        for k, picture in enumerate(draw()):
            cv2.imwrite(str(folder / f"film/{k:03d}.png"), picture[..., ::-1])
        write_camera(folder, discs.CAMERA)
        return ["tracker", "track", "film", "--camera", "camera.json", "-o", "new", "--no-pages", *options]

    return make


def track_grey(*options: str) -> Callable[[Path], Words]:
    """A grey film of two balls that move side by side; a mask that shows the lower half; and `tracker track`."""

    def make(folder: Path) -> Words:
        words = track_pictures(lambda: film_pair()[..., None].repeat(3, axis=3), *options)(folder)
        mask = np.zeros(discs.SIZE, np.uint8)
        mask[MIDDLE:] = 255
        cv2.imwrite(str(folder / "mask.png"), mask)
        return words

    return make


def film_pair() -> NDArray[Any]:
    """Grey frames of two balls side by side, one above the row MIDDLE and one below it."""
    frames: NDArray[Any] = discs.film(np.random.default_rng(3), PAIR, ground=np.full(discs.SIZE, 70.0))
    return frames


def draw_bar(folder: Path) -> Path:
    """A film of a bar, which is no ball."""
    (folder / "film").mkdir()
    rng = np.random.default_rng(0)
    for k in range(12):
        picture = 80 + rng.normal(0, 1, (180, 240))
        picture[70:76, 20 + 5 * k : 90 + 5 * k] = 200
        cv2.imwrite(str(folder / f"film/{k:03d}.png"), np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return folder / "film"


def list_cases() -> list[Case]:
    """Cases of colours, hints, and of a film that shows no ball."""
    one = PAIR[:1] + np.array([25.0, -5.0])
    two = np.stack([PAIR[0] + [10.0, -10.0], PAIR[1] + [10.0, -15.0]])
    people = ((colour.hand, colour.SKIN), (colour.cue, colour.WOOD))
    halves = ((DARK_GREEN, CREAM), (BLUE, CREAM))
    x, y = one[0, 10]
    cases = {
        "an orange ball on green cloth, a moving shadow": (
            track_pictures(lambda: colour.draw(one, [colour.ORANGE])), Found(one, ("channel: ",), near_px=1.5),
        ),
        "the same with a hand and a cue": (
            track_pictures(lambda: colour.draw(one, [colour.ORANGE], people=people)), Found(one, near_px=1.5),
        ),
        "balls of two colours on one cloth": (
            track_pictures(lambda: colour.draw(two, [colour.ORANGE, CREAM])), Found(two, near_px=1.5),
        ),
        "discs of two colours each": (
            track_pictures(lambda: colour.draw(two, halves, PAPER, shadow=False)), Found(two, near_px=2.0, share=0.95),
        ),
        "hint --ball": (
            track_pictures(lambda: colour.draw(one, [colour.ORANGE]), "--ball", f"{x:.0f},{y:.0f}@10"),
            Found(one, near_px=1.5),
        ),
        "hint --colour": (
            track_pictures(lambda: colour.draw(two, [colour.ORANGE, (60.0, 60.0, 190.0)]), "--colour", "#eb961e"),
            Found(two[:1], near_px=1.5, share=0.9),
        ),
    }  # fmt: skip
    low = PAIR[PAIR[:, :, 1].mean(axis=1).argmax()][None]
    width, height = discs.SIZE[1], discs.SIZE[0]
    hints = {
        "hint --frames 6:20": (("--frames", "6:20"), Found(PAIR[:, 6:20], first=6)),
        "hint --region": (("--region", f"0,{MIDDLE},{width},{height}"), Found(low)),
        "hint --mask": (("--mask", "mask.png"), Found(low)),
    }
    return [
        *(Case("colour", kind, make, judge) for kind, (make, judge) in cases.items()),
        *(Case("colour", kind, track_grey(*options), judge)
          for kind, (options, judge) in hints.items()),
        Case("colour", "a film that fails has a picture of what was refused", track(draw_bar, film_discs),
             Said(("refused.png", "--ball X,Y@"), files=("new/**/refused.png",))),
    ]  # fmt: skip
