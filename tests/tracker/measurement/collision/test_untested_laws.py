"""Errors of the tied fit by laws that few positions do not test."""

from types import SimpleNamespace

import numpy as np
import pytest

import synthcam
import tracker
from benchmarks.regression.error_bars import SHAKEN, follow_centres
from benchmarks.tracker.broken_laws import draw_table
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.model import as_model
from tracker.camera.camera import Camera
from tracker.measurement.collision.collision_model import TIED, mean_positions, tied_to_free
from tracker.measurement.collision.untested_laws import list_broken_laws, weigh_broken_laws
from tracker.measurement.estimate import measure
from tracker.settings import FitSettings

DIAMETER, V0, B, HEADING = 0.06, 1.5, 0.3, 0.7
R, MU, C = 0.9, 0.2, 0.3
SMALL = 1e-3


def simulate(times, effects=None, side=0.0):
    """Centres (2, n, 2) of a hit at the time 0, by the simulation; no loss in rolling."""
    numbers = {"restitution": R, "sliding_friction": MU, "spin_transfer": C, "rolling_drag": 0.0, "rolling_decel": 0.0}
    model = as_model({"ball": {"diameter": DIAMETER}, "model": numbers, "effects": effects or {}})
    launch = Launch.pair(model.bodies("ab"), 0.0, V0, B, HEADING, [0.0, 0.0], [0.0, 0.0, side * V0])
    return solve(model, launch, -0.1, float(times[-1]) + 0.1).at(times)[..., :2]


@pytest.mark.parametrize(
    ("law", "effects"),
    [
        ("friction", {"friction_mismatch": {"excess": SMALL}}),
        ("masses", {"mass_mismatch": {"excess": SMALL}}),
        ("hop", {"hop": {"share": SMALL, "bounce": 0.0}}),
        ("side spin", {}),
    ],
)
def test_a_broken_law_moves_the_balls_as_the_simulation_does(law, effects):
    times = np.linspace(0.02, 1.0, 30)
    by_law = simulate(times, effects, side=SMALL if law == "side spin" else 0.0) - simulate(times)
    tied = np.zeros(len(TIED))
    tied[[TIED.index(name) for name in ("heading", "beta", "v0", "r", "log_mu", "C")]] = (
        *(HEADING, np.arcsin(B), V0),
        *(R, np.log(MU), C),
    )
    pair = SimpleNamespace(spin=0.0, fitted_spin=())
    change, _ = list_broken_laws(SimpleNamespace(parameters=tied, pair=pair))[law]
    free = np.asarray(tied_to_free(tied), dtype=float)
    for ball in (1, 2):
        _, slope = mean_positions(free, ball, times, 0.0, DIAMETER)
        assert slope @ change == pytest.approx(by_law[ball - 1] / SMALL, rel=0.02, abs=0.01 * abs(by_law).max() / SMALL)


def test_breaks_are_weighed_as_by_an_integral_over_all_of_them():
    seen = {"one": (0.4, 0.3, 0.2), "other": (0.02, 0.05, 0.3)}  # value, standard error, typical size
    broken = {name: SimpleNamespace(value=v, std=s, typical=t) for name, (v, s, t) in seen.items()}
    size = np.linspace(-3, 3, 60001)
    evidence, squares = [0.6], []
    for value, std, typical in seen.values():
        prior = np.exp(-0.5 * (size / typical) ** 2) / typical / np.sqrt(2 * np.pi)
        ratio = np.exp(-0.5 * ((value - size) / std) ** 2 + 0.5 * (value / std) ** 2)
        evidence.append(0.2 * np.trapezoid(prior * ratio, size))
        squares.append(0.2 * np.trapezoid(prior * ratio * size**2, size))
    holds, found = weigh_broken_laws(broken, 0.4)
    assert holds == pytest.approx(0.6 / sum(evidence), rel=1e-6)
    assert found == pytest.approx(np.array(squares) / sum(evidence), rel=1e-6)


def test_the_errors_of_short_tables_allow_for_a_hop():
    """Without the allowance v0 and r of tied fits are up to 16 of their errors off."""
    found = {0.0: [], 0.5: []}
    for number in range(8):
        table, camera, truth = draw_table("hop", np.random.default_rng([77, number]))
        for expected, z in found.items():
            settings = {"fit": {"broken_law": expected, "local_window_s": 0}}
            row = tracker.measure(table, camera, unit="m", settings=settings).rows[0]
            z += [abs(row[name] - truth[name]) / row[f"{name}_std"] for name in ("v0", "r") if row["status"] == "ok"]
    alone, allowed = (np.array(z) for z in found.values())
    assert np.isfinite(allowed).sum() >= 7
    assert np.sum(alone > 4.5) >= 3
    assert np.nanmax(allowed) < 4.5


def test_precise_tracks_confirm_the_laws():
    clip = synthcam.Scene.build("confirmed", **SHAKEN).draw(3, 31)
    tracks = follow_centres(clip, np.random.default_rng(3))
    rows = [
        measure(tracks, Camera.of(clip.camera_json), FitSettings(local_window_s=0, broken_law=p))[0] for p in (0, 0.5)
    ]
    assert rows[0]["r_std"] == rows[1]["r_std"]
