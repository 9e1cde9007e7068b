"""Energies of bodies on air: the law of gliding gives the plate's part, and contacts and walls share the rest."""

import numpy as np
import pandas as pd
import pytest

import synthcam
import tracker
from tracker.gas.energy import SINKS
from tracker.gas.loss_on_air import balance_on_air

BODIES, FRAMES, SPEED = 5, 41, 0.4  # number, number, m/s
LAW = {"rolling_speed": 0.3, "rolling_loss": 0.05, "rolling_drag": 0.2, "rolling_loss_std": 0.001}
LAW["rolling_drag_std"] = 0.01
LOST = BODIES * SPEED * (0.05 + 0.2 * 0.1) * 0.4  # m^2/s^2, in 0.4 s


def make_gas(contacts, walls, plate, errors=(0.01, 0.01)):
    """Bodies of one speed, which have lost these energies at the end, as tables by frame and by ball."""
    grow = np.linspace(0.0, 1.0, FRAMES)
    time = pd.DataFrame({"frame": np.arange(FRAMES), "t_s": grow * 0.4, "balls": BODIES - 1, "unknown": 1})
    lost = {"contacts": contacts, "walls": walls, "plate": plate, "unresolved": 0.0}
    for name, column in SINKS.items():
        time[column] = lost[name] * grow
        time[f"{column}_std"] = dict(zip(lost, (*errors, 0.1, 0.1), strict=True))[name] * grow
    time["energy_std"] = 1e-4
    frame = np.repeat(np.arange(FRAMES), BODIES - 1)  # one body has no velocity
    halves = {name: SPEED if name[-1] == "x" else 0.0 for name in ("even_x", "even_y", "odd_x", "odd_y")}
    return time, pd.DataFrame({"frame": frame} | halves)


def test_the_law_gives_the_loss_to_the_plate_and_the_sum_stays():
    time, table = make_gas(0.1, 0.05, LOST)
    found = balance_on_air(time, table, LAW).iloc[-1]
    assert found["lost_to_plate"] == pytest.approx(LOST)
    by_law = BODIES * SPEED * 0.4 * np.hypot(0.001, 0.01 * 0.1)
    assert found["lost_to_plate_std"] == pytest.approx(np.hypot(by_law, 0.005 * LOST))
    assert found["lost_in_contacts"] == pytest.approx(0.1)
    assert found["lost_at_walls"] == pytest.approx(0.05)
    assert found["lost_in_contacts_std"] < 0.01  # their sum is known


@pytest.mark.parametrize("missing", [0.008, 0.3])
def test_energy_of_hits_that_were_not_found_goes_from_the_plate_to_contacts_and_walls(missing):
    time, table = make_gas(0.1, 0.05, LOST + missing, errors=(0.01, 0.001))
    found = balance_on_air(time, table, LAW).iloc[-1]
    assert found[list(SINKS.values())].sum() == pytest.approx(0.15 + LOST + missing)
    contacts, walls = (found[f"lost_{name}"] for name in ("in_contacts", "at_walls"))
    if missing > 0.1:  # of which kind they were is not known
        assert contacts - 0.1 == pytest.approx(missing / 2, rel=0.02)
        assert walls - 0.05 == pytest.approx(missing / 2, rel=0.02)
        assert min(found["lost_in_contacts_std"], found["lost_at_walls_std"]) > missing / 4
    else:  # it is within the error of the contacts
        assert walls == pytest.approx(0.05, abs=2e-4)
        assert contacts > 0.1 + missing / 2


def test_without_a_law_nothing_changes():
    time, table = make_gas(0.1, 0.05, 0.2)
    assert balance_on_air(time, table, LAW | {"rolling_loss": np.nan}) is time


def test_pucks_lose_to_the_air_what_the_simulation_says():
    clip = synthcam.Scene.read("pucks").draw(seed=606)  # without the law it was 0.66 of 0.30 m^2/s^2
    x, y = (clip.tracks[f"{axis}_mean_px"] + 0.05 * np.random.default_rng(1).standard_normal(2000) for axis in "xy")
    table = clip.tracks[["frame", "particle"]].assign(x=x, y=y, x_std=0.05, y_std=0.05, cov_xy=0.0)
    gas = tracker.observe_gas(tracker.measure(table, clip.camera_json))
    speed = np.hypot(clip.tracks["vx"], clip.tracks["vy"]).to_numpy()
    power = pd.Series(speed * (0.02 + 0.05 * speed)).groupby(clip.tracks["frame"].to_numpy()).sum()
    truth = float((power[1:].to_numpy() + power[:-1].to_numpy()).sum() / 2 / 100)
    last = gas.time.iloc[-1]
    assert abs(last["lost_to_plate"] - truth) < 3 * last["lost_to_plate_std"] < 0.05 * truth
