"""The drawing of an effect: its tracks are those of the truth, seen by a camera that knows of nothing."""

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from synthcam.cli import app
from synthcam.dataset.effect_drawing import EXAMPLE_FPS, EXAMPLE_FRAMES, EXAMPLE_LAUNCH, draw_effect, simulate_tracks
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effect import with_typical_values
from synthcam.library import library
from synthcam.model import Model


def test_its_tracks_are_the_motion_in_mm():
    model = Model(effects=(with_typical_values(library()["stribeck"]),))
    motion = solve(model, Launch.pair(model.bodies("ab"), **EXAMPLE_LAUNCH), 0.0, EXAMPLE_FRAMES / EXAMPLE_FPS)
    times = (np.arange(EXAMPLE_FRAMES)) / EXAMPLE_FPS + 2.5e-4
    clear = [k for k in range(EXAMPLE_FRAMES) if all(abs(e.t - times[k]) > 3e-4 for e in motion.events)]
    np.testing.assert_allclose(
        simulate_tracks(model)[:, clear], 1e3 * motion.at(times[clear])[..., :2], rtol=0, atol=2e-4
    )


@pytest.mark.parametrize("name", ["hop", "clock_drift", "pixel_locking"])
def test_it_draws(name, tmp_path):
    apart = draw_effect(with_typical_values(library()[name]), tmp_path / "e.png")
    model = Model(effects=(with_typical_values(library()[name]),))
    assert apart == pytest.approx(1e3 * np.abs(simulate_tracks(model) - simulate_tracks(Model())).max())
    assert apart > 1
    drawn = cv2.imread(str(tmp_path / "e.png"))
    assert drawn.shape[0] > 300
    assert 0.02 < (drawn < 250).any(axis=2).mean() < 0.5


def test_no_legend_covers_an_axis(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *path, **settings: drawn.append(figure))
    draw_effect(with_typical_values(library()["plate_tilt"]), tmp_path / "t.png")
    (figure,) = drawn
    figure.draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in figure.get_axes()]
    legends = [legend.get_window_extent() for half in figure.subfigs for legend in half.legends]
    assert (len(boxes), len(legends)) == (2, 2)
    assert not any(legend.overlaps(box) for legend in legends for box in boxes)


def test_the_command(tmp_path):
    run = CliRunner().invoke(app, ["effects", "plate_tilt", "-o", str(tmp_path / "t.png")])
    assert run.exit_code == 0
    assert "shifts the tracks by up to" in run.output
    assert (tmp_path / "t.png").stat().st_size > 5000
    for wrong in (["effects", "-o", "t.png"], ["effects", "hop", "-o", "t.pdf"]):
        said = CliRunner().invoke(app, wrong)
        assert "expected the NAME of one effect" in str(said.exception)
