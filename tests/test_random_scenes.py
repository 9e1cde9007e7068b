"""The worst of ten thousand random runs, and some new ones; benchmarks/random_scenes.py makes and judges them."""

import importlib.util
from pathlib import Path

import pytest


@pytest.mark.parametrize("seed", [320, 395, 1114, 1485, 1778, 1841, 3879, 4192, 6531])
def test_the_worst_of_the_random_runs(seed, random_scenes):
    """Each went wrong once: balls that attract each other from rest, flights met in the air, C beyond 5/7, grazes."""
    row = random_scenes.one(seed)
    assert not random_scenes.wrong(row), row


@pytest.mark.parametrize("start", [20_000, 20_030])
def test_random_runs(start, random_scenes):
    for seed in range(start, start + 30):
        row = random_scenes.one(seed)
        assert not random_scenes.wrong(row), row


@pytest.fixture(scope="module")
def random_scenes():
    path = Path(__file__).parent.parent / "benchmarks" / "random_scenes.py"
    spec = importlib.util.spec_from_file_location("random_scenes", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.LONGEST = 3600  # no test asserts a time
    return module
