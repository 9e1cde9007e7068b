"""The gate knows every quantity, fails on what has grown and nothing else, and accepts with a reason on record."""

import importlib
import json
import math
import sys

import numpy as np
import pandas as pd
import pytest

from benchmarks.regression import gate as regression_gate
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.scoring.error_bars import compute_error_statistics


@pytest.fixture
def gate(tmp_path, monkeypatch):
    module = importlib.reload(regression_gate)  # its state is its own in each test
    accepted = json.loads(module.BASELINE.read_text())
    module.accepted = accepted
    for name in ("BASELINE", "CHANGELOG"):
        copy = tmp_path / getattr(module, name).name
        copy.write_text(getattr(module, name).read_text())
        monkeypatch.setattr(module, name, copy)
    return module


def test_every_quantity_of_both_fits_is_watched(gate):
    assert set(gate.QUANTITIES) == set(QUANTITY_NAMES)
    for name in QUANTITY_NAMES:
        for fit in ("", "_free"):
            watched = {key.rpartition(".")[2] for key in gate.accepted if key.rpartition(".")[0] == name + fit}
            assert watched == ({"n"} if name + fit == "w1n" else {"n", "z_mean", "z_std", "std"})


HONEST = {"tied.spread": 1.0, "tied.errors": 1600.0, "free.spread": 1.0, "free.errors": 1800.0}


def test_what_grows_fails_and_what_shrinks_does_not(gate):
    accepted = {name: value["mean"] for name, value in gate.accepted.items()} | HONEST
    assert gate.check(accepted) == []
    for name, value in gate.accepted.items():
        much = 1.01 * gate.LIMIT * value["scatter"] + 1e-12
        up, down = (gate.check(accepted | {name: value["mean"] + sign * much}) for sign in (1, -1))
        wrong = down if name.endswith(".n") else up
        assert len(wrong) == 1
        assert wrong[0].startswith(f"{name} = ")
        assert bool(up and down) == name.endswith((".z_mean", ".z_std"))
    assert gate.check({k: v for k, v in accepted.items() if k != "r.z_std"}) == ["r.z_std: no longer measured"]
    assert gate.check({k: v for k, v in accepted.items() if k != "free.spread"}) == ["free.spread: not measured"]


def drawn(gate, seed):
    """Estimates off by what correlated errors make them, with their covariance, and the truth."""
    rng, n = np.random.default_rng(seed), len(QUANTITY_NAMES)
    root = np.tril(rng.normal(0, 0.3, (n, n)), -1) + np.diag(rng.uniform(0.5, 2, n))
    cov, truth = root @ root.T, rng.uniform(1, 2, (gate.TRACKS, n))
    values = {
        "": truth + rng.standard_normal(truth.shape) @ root.T,
        "_free": truth + rng.standard_normal(truth.shape) @ root.T,
    }
    block = json.dumps({"names": list(QUANTITY_NAMES), "tied": cov.tolist(), "free": cov.tolist()})
    claims = pd.DataFrame({"clip": range(gate.TRACKS), "cov": block})
    for suffix, value in values.items():
        claims = claims.assign(**{f"{q}{suffix}": value[:, i] for i, q in enumerate(QUANTITY_NAMES)})
        claims = claims.assign(**{f"{q}{suffix}_std": np.sqrt(cov[i, i]) for i, q in enumerate(QUANTITY_NAMES)})
    return claims, pd.DataFrame(truth, columns=list(QUANTITY_NAMES)).assign(clip=range(gate.TRACKS))


def watched(gate, claims, truth):
    """The gate's figures of error bars."""
    out = gate.spreads(claims, truth)
    for q in QUANTITY_NAMES:
        for suffix in ("", "_free"):
            got = compute_error_statistics(
                *(claims[f"{q}{suffix}{end}"].to_numpy() for end in ("", "_std")),
                truth[q].to_numpy(),
                np.ones(gate.TRACKS),
            )
            out |= {f"{q}{suffix}.{kind}": got[kind] for kind in ("n", "z_std", *gate.COVERED)}
    return out


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.gate) for seed in range(1, 5))])
def test_a_covariance_that_is_not_true_fails(gate, seed):
    claims, truth = drawn(gate, seed)
    assert gate.dishonest(watched(gate, claims, truth)) == []
    for scale in (0.64, 0.8, 1.25, 1.5):
        said = {line.partition(" = ")[0] for line in gate.dishonest(watched(gate, gate.scaled(claims, scale), truth))}
        assert {"tied.spread", "free.spread"} <= said
        if scale == 0.64:  # a half more in the squares is seen in single quantities too
            assert len(said) > 2


@pytest.mark.gate
def test_true_error_bars_do_not_fail_by_chance(gate):
    """The largest departure of 20 suites' pooled figures, in sampling errors, is what 40 normal draws give."""
    worst = 0.0
    for seed in range(20):
        found = gate.spreads(*drawn(gate, 100 + seed))
        z = [(found[f"{fit}.spread"] - 1) / math.sqrt(2 / found[f"{fit}.errors"]) for fit in gate.TOGETHER]
        worst = max(worst, *map(abs, z))
    assert 1.5 < worst < gate.LIMIT


def test_accepting_is_recorded(gate):
    log = gate.CHANGELOG.read_text()
    gate.CHANGELOG.write_text(log + "\n## 0.1\n\n- first\n")
    seeds = [{"video.missed": 0.0, "r.z_std": 1.0 + 0.1 * k, "r.z_mean": 0.01 * k} | HONEST for k in range(3)]
    gate.accept(seeds, "sharper optics")
    written = json.loads(gate.BASELINE.read_text())
    assert written["r.z_std"] == {"mean": 1.1, "scatter": 0.1}
    assert written["r.z_mean"]["scatter"] == pytest.approx(1 / gate.TRACKS**0.5, rel=0.01)  # the floor
    assert gate.check(seeds[1]) == []
    line = "- **gate**: new figures accepted: sharper optics\n"
    assert gate.CHANGELOG.read_text() == f"{log}{line}\n## 0.1\n\n- first\n"


def test_a_median_of_few_seeds_is_accepted_with_at_least_its_sampling_error(gate):
    seeds = [{"r.std": 1.0, "r.std_error": 0.03}, {"r.std": 1.001, "r.std_error": 0.05}]
    gate.accept(seeds, "ten seeds may agree by chance")
    assert json.loads(gate.BASELINE.read_text()) == {"r.std": {"mean": 1.0005, "scatter": 0.04}}


def test_the_error_of_a_median_is_its_scatter(gate):
    rng = np.random.default_rng(5)
    draws = rng.lognormal(size=(4000, 200))
    claimed = np.mean([gate.error_of_median(draw) for draw in draws[:400]])
    assert claimed == pytest.approx(np.std(np.median(draws, axis=1)), rel=0.1)


def test_no_reason_no_acceptance(gate, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["gate.py", "--accept", " "])
    with pytest.raises(SystemExit) as stop:
        gate.main()
    assert stop.value.code == 2
    assert "expected the reason" in capsys.readouterr().err
