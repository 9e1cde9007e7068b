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


def few(patch):
    """A library of two effects; what scenes and models may hold is kept, and must first be made of the whole one."""
    scene_file(), model_file()
    only(patch)
