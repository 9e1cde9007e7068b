"""Experiments for the tests of planning."""

from functools import cache

from discrepancy_clips import only

from discrepancy.planning.experiment import design_experiment
from synthcam.model import model_file
from synthcam.scene.scene import Scene, scene_file

SMALL = {"timing": {"frames": 60, "contact_frame": 20.0}}


def scene(name="oblique", **sections):
    return Scene.read(name, **(SMALL | sections))


@cache
def small(noise_px=None):
    """Eight collisions, of which six are fitted."""
    return design_experiment(scene(), 8, noise_px).experiment


def few(patch, count_draws=lambda _: 2):
    """A library of two effects, and medians over two draws of an experiment, where the program makes up to five.

    What scenes and models may hold is kept, and must first be made of the whole library.
    """
    scene_file(), model_file()
    patch.setattr("discrepancy.plan_experiment.count_draws", count_draws)
    only(patch)
