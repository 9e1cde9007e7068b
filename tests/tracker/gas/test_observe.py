"""The gas of a result: the frame rate, the diameter and the errors of its camera file enter where they belong."""

import numpy as np
import pandas as pd
import pytest

import tracker

FRAMES, DIAMETER, SIDE = 40, 1e-3, 0.1  # SIDE: of the square that the centres can reach, m
STEPS = np.array([[0.3, 0.1], [-0.2, 0.0], [0.0, -0.4]])  # px per frame
CAMERA = {"size": [800, 800], "fps": 250, "scale": 1e-4, "ball_diameter": DIAMETER}


def observe(away=(), **errors):
    """Three balls that move far apart, each at a constant velocity; the last is out of view in the frames `away`."""
    frame = np.arange(FRAMES)
    tables = [
        pd.DataFrame(200 * (k + 1) + frame[:, None] * step, columns=["x", "y"]).assign(frame=frame, particle=k)
        for k, step in enumerate(STEPS)
    ]
    tables[-1] = tables[-1][~tables[-1]["frame"].isin(away)]
    half = SIDE / 2
    return tracker.observe_gas(tracker.measure(pd.concat(tables), CAMERA | errors), area=(-half, -half, half, half))


def test_times_and_expected_contacts_are_those_of_the_frame_rate_and_the_diameter():
    gas = observe()
    temperature = STEPS.var(axis=0, ddof=1).mean() * (250 * 1e-4) ** 2
    np.testing.assert_allclose(gas.time["t_s"], np.arange(FRAMES) / 250)
    np.testing.assert_allclose(gas.time["temperature"], temperature, rtol=1e-6)
    density = 3 / (SIDE + DIAMETER) ** 2
    rate = 2 * density * DIAMETER * np.sqrt(np.pi * temperature)  # of each ball in a dilute gas
    assert gas.values["contacts_theory"] == pytest.approx(3 / 2 * rate * FRAMES / 250, rel=0.01)


def test_a_frame_has_the_time_at_which_its_velocities_hold_the_middle_of_its_exposure():
    np.testing.assert_allclose(observe(exposure=2e-3).time["t_s"], np.arange(FRAMES) / 250 + 1e-3)


@pytest.mark.parametrize(
    ("key", "of_temperature", "of_contacts"),
    [("scale", 2, 1), ("fps", 2, 0), ("ball_diameter", 0, 1)],
)
def test_each_error_of_the_camera_file_goes_where_its_key_does(key, of_temperature, of_contacts):
    """Twice the scale is four times the temperature; twice the frame rate leaves the number of contacts as it is."""
    share = 0.01
    gas, exact = observe(**{f"{key}_std": share * CAMERA[key]}), observe()
    added = np.sqrt(gas.time["temperature_std"] ** 2 - exact.time["temperature_std"] ** 2) / gas.time["temperature"]
    np.testing.assert_allclose(added, of_temperature * share, atol=0.1 * share)
    theory = gas.values["contacts_theory"], gas.values["contacts_theory_std"]
    without = exact.values["contacts_theory_std"]
    added = np.sqrt(max(theory[1] ** 2 - without**2, 0)) / theory[0]
    assert added == pytest.approx(of_contacts * share, abs=0.3 * share)


@pytest.mark.parametrize("away", [range(25, 40), range(12, 24)])
def test_frames_with_two_balls_add_nothing_to_those_with_three(away):
    gas = observe(away)
    assert set(gas.time["frame"]).isdisjoint(away)
    energy = (STEPS**2).sum() / 2 * (250 * 1e-4) ** 2
    np.testing.assert_allclose(gas.time["energy"], energy, rtol=1e-6)


def test_a_note_says_that_contacts_are_too_frequent_to_be_seen():
    """Forty balls of 6 mm in 0.1 m x 0.1 m: at 2 m/s hard discs would meet every other frame.

    Tracks without noise also have kinks beside paths of two positions.
    """
    rng, frame = np.random.default_rng(1), np.arange(30)
    velocity = rng.normal(0, 2 / np.sqrt(2), (40, 2))
    place = (rng.uniform(0, 0.1, (40, 1, 2)) + frame[:, None] / 250 * velocity[:, None]) % 0.2
    folded = (np.minimum(place, 0.2 - place) / 1e-4).reshape(-1, 2)  # by walls that turn them back
    table = pd.DataFrame({"frame": np.tile(frame, 40), "particle": np.repeat(np.arange(40), 30)})
    table = table.assign(x=folded[:, 0], y=folded[:, 1], x_std=0.05, y_std=0.05, cov_xy=0.0)
    camera = {"size": [1001, 1001], "fps": 250, "scale": 1e-4, "ball_diameter": 6e-3}
    fast, slow = tracker.observe_gas(tracker.measure(table, camera)), observe()
    assert any("hard discs of this density" in note for note in fast.notes)
    assert not any("hard discs of this density" in note for note in slow.notes)
