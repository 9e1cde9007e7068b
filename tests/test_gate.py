"""The gate knows every quantity, fails on what has grown and nothing else, and accepts with a reason on record."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

from tracker.quantities import NAMES


@pytest.fixture
def gate(tmp_path, monkeypatch):
    path = Path(__file__).parent.parent / "benchmarks" / "gate.py"
    spec = importlib.util.spec_from_file_location("gate", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    accepted = json.loads(module.BASELINE.read_text())
    module.accepted = accepted
    for name in ("BASELINE", "CHANGELOG"):
        copy = tmp_path / getattr(module, name).name
        copy.write_text(getattr(module, name).read_text())
        monkeypatch.setattr(module, name, copy)
    return module


def test_every_quantity_of_both_fits_is_watched(gate):
    assert set(gate.QUANTITIES) == set(NAMES)
    for name in NAMES:
        for fit in ("", "_free"):
            watched = {key.rpartition(".")[2] for key in gate.accepted if key.rpartition(".")[0] == name + fit}
            assert watched == ({"n"} if name + fit == "w1n" else {"n", "z_mean", "z_std", "std"})


def test_what_grows_fails_and_what_shrinks_does_not(gate):
    figures = {name: value["mean"] for name, value in gate.accepted.items()}
    assert gate.check(figures) == []
    for name, value in gate.accepted.items():
        much = 1.01 * gate.LIMIT * value["scatter"] + 1e-12
        up, down = (gate.check(figures | {name: value["mean"] + sign * much}) for sign in (1, -1))
        wrong = down if name.endswith(".n") else up
        assert len(wrong) == 1
        assert wrong[0].startswith(f"{name} = ")
        assert bool(up and down) == name.endswith(".z_mean")
    assert gate.check({k: v for k, v in figures.items() if k != "r.z_std"}) == ["r.z_std: no longer measured"]


def test_accepting_is_recorded(gate):
    log = gate.CHANGELOG.read_text()
    gate.CHANGELOG.write_text(log + "\n## 0.1\n\n- first\n")
    seeds = [{"video.missed": 0.0, "r.z_std": 1.0 + 0.1 * k, "r.z_mean": 0.01 * k} for k in range(3)]
    gate.accept(seeds, "sharper optics")
    written = json.loads(gate.BASELINE.read_text())
    assert written["r.z_std"] == {"mean": 1.1, "scatter": 0.1}
    assert written["r.z_mean"]["scatter"] == pytest.approx(1 / gate.TRACKS**0.5, rel=0.01)  # the floor
    assert gate.check(seeds[1]) == []
    line = "- **gate**: new figures accepted: sharper optics\n"
    assert gate.CHANGELOG.read_text() == f"{log}{line}\n## 0.1\n\n- first\n"


def test_no_reason_no_acceptance(gate, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["gate.py", "--accept", " "])
    with pytest.raises(SystemExit) as stop:
        gate.main()
    assert stop.value.code == 2
    assert "expected the reason" in capsys.readouterr().err
