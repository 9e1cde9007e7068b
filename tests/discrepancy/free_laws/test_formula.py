"""Short formulas: what was put in comes back, with its numbers."""

import dataclasses
import re

import numpy as np
import pytest
from discrepancy_clips import exact, noisy
from discrepancy_laws import with_constant
from discrepancy_outsiders import outsider
from discrepancy_selected import challenged

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.free_laws.formula import _ShapeFitter, _write_sum, iterate_shapes, propose_formula
from discrepancy.free_laws.library import free_laws_over
from discrepancy.noise.model import Noise, NoiseComponent
from synthcam.model import Model


def numbers(text):
    return [float(x) for x in re.findall(r"(?<![\w.])\d+\.?\d*(?:e-?\d+)?", text)]


@pytest.mark.gate
def test_waves_of_friction():
    """0.232 (1 + 0.02 sin(x / 3 mm))"""
    formula = outsider("friction_place").law_summary.formula
    mean, one, depth, length, phase = numbers(formula)[:5]
    assert formula.startswith("mu = ")
    assert "sin(x / " in formula
    assert (mean, one) == (pytest.approx(0.232, abs=1e-3), 1)
    assert (depth, length) == (pytest.approx(0.02, rel=0.05), pytest.approx(3, rel=0.02))
    assert phase < 0.1


def test_a_sine_and_a_cosine_are_one_sine_of_a_field_too():
    """3 sin w + 4 cos w = 5 sin(w + atan(4/3))"""
    for way in ("", " ex"):
        words = [f"sin(x / 3){way}", f"cos(x / 3){way}"]
        assert _write_sum(words, np.array([3.0, 4.0]), relative=False) == f"5 sin(x / 3 + 0.93){way}"


@pytest.mark.gate
def test_a_step():
    """0.903 - 0.004 (1 + tanh((v - 0.2) / 0.03)) / 2"""
    formula = outsider("restitution_speed").law_summary.formula
    found = re.fullmatch(r"r = (.+) \(1 - (.+) \(1 \+ tanh\(\(v_n - (.+)\) / (.+)\)\) / 2\), v_n in m/s", formula)
    mean, drop, at, width = map(float, found.groups())
    assert mean == pytest.approx(0.903, abs=1e-3)
    assert drop * mean == pytest.approx(0.004, rel=0.2)
    assert (at, width) == (pytest.approx(0.2, abs=0.02), pytest.approx(0.03, rel=0.6))


@pytest.mark.gate
def test_a_resonance():
    formula = outsider("spin_transfer_speed").law_summary.formula
    mean, one, size, at, *_, width, _ = numbers(formula)
    assert "exp(-(v - " in formula
    assert mean * size == pytest.approx(0.01, rel=0.1)
    assert (mean, at) == (pytest.approx(0.347, abs=2e-3), pytest.approx(0.3, abs=0.02))
    assert (one, width) == (1, pytest.approx(0.06, rel=0.3))


@pytest.mark.gate
def test_a_power():
    """-0.015 v^0.5"""
    formula = outsider("force_speed").law_summary.formula
    size, power = numbers(formula)[:2]
    assert "= - " in formula
    assert "m/s^2" in formula
    assert (size, power) == (pytest.approx(0.015, rel=0.1), pytest.approx(0.5, abs=0.1))


def test_a_lag_is_told_but_for_a_constant():
    """2e-4 v^2"""
    clips = exact(Model(), 8, 6)
    launches = np.array([c.launch for c in clips])
    late = with_constant(next(s for s in free_laws_over(Model(), launches, clips) if s.name == "lag_speed"))
    x = late.axes[0].grid(200)
    moves = late.derivatives(Model(), launches, clips)
    coefs = np.linalg.lstsq(late.basis(x), 2e-4 * x**2, rcond=None)[0]
    seen = noisy([dataclasses.replace(c, xy=c.xy + m @ coefs) for c, m in zip(clips, moves, strict=True)], 6)
    noise = Noise(NoiseComponent(1.0))
    base = fit_model(seen, Model(), BASE_PARAMETERS, noise)
    found = min(challenged(seen, base, noise), key=lambda f: f.score)
    formula = propose_formula(found)
    assert (found.law.name, formula.is_rejected) == ("lag_speed", False)
    factor = float(re.fullmatch(r"lag of the picture = (\S+) v\^2 s, v in m/s", formula.text).group(1))
    assert factor == pytest.approx(2e-4, rel=0.1)
    drawn = _ShapeFitter(found)
    assert "" not in {
        t.text for s in iterate_shapes(found.law, drawn.x) for t in drawn.terms(s, *(t[0] for t in s.tries))
    }


def test_a_formula_that_suffices_is_not_refused():
    proposed = propose_formula(outsider("restitution_speed").free_law)
    assert not proposed.is_rejected
    assert proposed.parameters == 4
    assert np.isfinite(proposed.chi2)
