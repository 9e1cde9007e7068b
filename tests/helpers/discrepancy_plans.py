"""Experiments for the tests of planning."""

from functools import cache

from discrepancy.planning.of_scene import experiment_of
from synthcam.scene.scene import Scene

SMALL = {"timing": {"frames": 60, "contact_frame": 20.0}}


def scene(name="oblique", **sections):
    return Scene.read(name, **(SMALL | sections))


@cache
def small(noise_px=None):
    """Eight collisions, of which six are fitted."""
    return experiment_of(scene(), 8, noise_px).fitted
