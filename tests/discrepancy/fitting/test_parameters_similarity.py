"""Sizes for balls of another diameter, held to motion itself: similar experiments move alike."""

import numpy as np
import pytest

from discrepancy.fitting.parameters import list_candidates, list_names_to_fit, scale_parameter
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.library import library
from synthcam.model import Ball, Model

LARGER = 1.7  # small enough to stay within every effect's limits
OF_THE_FILM = {"camera", "clock", "exposure", "measure"}
OWN_SPEEDS = {"air_drag", "spin_transfer_velocity", "velocity_restitution"}  # the air's, and 0.3 m/s, do not grow
OF_MOTION = [k for k in library().values() if not OF_THE_FILM & set(k.laws)]


def tracks(kind, larger):
    ball = Ball(diameter=larger * Ball().diameter)
    base = Model(ball=ball, rolling_drag=0.135 / larger**0.5)
    values = {
        f"{kind.name()}.{p.name}": scale_parameter(kind, p.name, ball.diameter).typical for p in kind.parameters()
    }
    model = base.replace(values)
    speed, time = 0.3 * larger**0.5, larger**0.5
    launch = Launch.pair(model.bodies("ba"), 0.1 * time, speed, 0.4, 0.3, (0.01 * larger, 0.02 * larger))
    found = solve(model, launch, 0.0, 0.3 * time)
    return np.array([found.at(t * time)[..., :2] for t in np.linspace(0, 0.3, 31)]) / larger


@pytest.mark.parametrize("kind", [k for k in OF_MOTION if k.name() not in OWN_SPEEDS], ids=lambda k: k.name())
def test_similar_experiments_move_alike(kind):
    assert np.abs(tracks(kind, 1.0) - tracks(kind, LARGER)).max() < 2e-9


def test_what_the_camera_does_does_not_grow_with_the_ball():
    films = [k for k in library().values() if OF_THE_FILM & set(k.laws)]
    assert films
    for kind in films:
        for p in kind.parameters():
            assert scale_parameter(kind, p.name, 0.0615) == p


def test_waves_of_a_billiard_table_are_longer_than_those_of_a_plate_for_beads():
    table = Model(ball=Ball(diameter=0.0615))
    waves = next(c for c in list_candidates(table, list_names_to_fit(table)) if c.name == "plate_waviness")
    lengths = {shapes["plate_waviness.wavelength"] for shapes in waves.grid(table)}
    assert min(lengths) > 0.1
    assert len(lengths) == 12
