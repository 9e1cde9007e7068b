"""The worst of ten thousand random runs, and some new ones; the benchmark random_scenes.py makes and judges them."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.simulation import random_scenes as scenes
from synthcam.dynamics.launch import Launch
from synthcam.effects.air_drag import AirDrag
from synthcam.model import Model

WORST = json.loads((Path(__file__).parent / "worst_scenes.json").read_text())


SLOWEST = 119635


@pytest.mark.parametrize(
    "scene",
    [pytest.param(s, marks=[pytest.mark.gate] * (s["seed"] == SLOWEST)) for s in WORST],
    ids=lambda scene: str(scene["seed"]),
)
def test_the_worst_of_the_random_runs(scene, random_scenes):
    """Each went wrong once: balls that attract each other from rest, flights met in the air, C beyond 5/7, grazes."""
    effects = {f"{name}.{p}": value for name, own in scene["effects"].items() for p, value in own.items()}
    model = Model().replace(scene["model"] | effects)
    launch = Launch(scene["time"], np.array(scene["states"]), model.bodies(scene["labels"]))
    row = random_scenes.run(model, launch, scene["end"])
    assert not random_scenes.wrong(row), row
    assert row.get("refused", "").startswith(scene["refused"])
    assert bool(scene["refused"]) == ("refused" in row), row


class Wind(AirDrag):
    """Air that gives."""

    def push(self, acceleration, velocity):
        return acceleration + velocity


@pytest.mark.parametrize(("effect", "wrong"), [(AirDrag(), False), (Wind(), True)])
def test_the_book_of_energy_is_kept_with_air_too(effect, wrong, random_scenes):
    model = Model(effects=(effect,))
    launch = Launch.pair(model.bodies("ab"), 0.01, 0.3, 0.0, 0.0, (0, 0))
    assert random_scenes.wrong(random_scenes.run(model, launch, 0.3)) == wrong


@pytest.mark.parametrize("start", [20_000, pytest.param(20_030, marks=pytest.mark.gate)])
def test_random_runs(start, random_scenes):
    for seed in range(start, start + 30):
        row = random_scenes.one(seed)
        assert not random_scenes.wrong(row), row


@pytest.fixture(scope="module")
def random_scenes():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenes, "LONGEST", 3600)  # no test asserts a time
        yield scenes
