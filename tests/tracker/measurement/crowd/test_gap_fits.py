"""Fits of contacts between two frames against paths in closed form: hits of discs on air, and a ball that slides."""

from dataclasses import replace

import numpy as np
import pytest

from tracker.measurement.crowd.gap_fits import ConsecutivePositions, ContactFinderSettings, fit_gaps, gather_gaps

FRAME_S, DIAMETER, NOISE = 4e-3, 2e-3, 1e-7
FRAME = np.arange(12)
GLIDES = ContactFinderSettings(curvature=0.1)


def make_rows(particle, place, before, after, instant, decel=0.0):
    """A ball that is at a place at an instant, with velocities before and after; decel: against the latter."""
    since = FRAME * FRAME_S - instant
    pull = -decel * np.asarray(after) / max(np.hypot(*after), 1e-12)
    late = np.maximum(since, 0)[:, None]
    way = np.where(since[:, None] < 0, since[:, None] * before, late * after + late**2 / 2 * pull)
    return ConsecutivePositions(particle, FRAME, FRAME * FRAME_S, place + way, np.full(12, NOISE**2))


def fit(candidates, gaps, settings=GLIDES, decel=0.0, slides=None):
    slides = [[None] * len(parts) for parts in candidates] if slides is None else slides
    gathered = gather_gaps(candidates, gaps, slides, decel, FRAME_S)
    return fit_gaps(gathered, replace(settings, distance_share=0.01), DIAMETER, 0.0)


def make_hit(instant):
    """A disc hits a resting one at an angle of 30 degrees: along the line of centres they exchange velocities."""
    normal, speed = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)]), np.array([0.3, 0.0])
    kick = (speed @ normal) * normal
    one = make_rows(0, np.zeros(2), speed, speed - kick, instant)
    return [one, make_rows(1, DIAMETER * normal, np.zeros(2), kick, instant)], kick


def test_the_instant_and_the_velocities_of_a_hit_are_exact():
    instant = 5.3 * FRAME_S
    parts, kick = make_hit(instant)
    found = fit([parts], [[(4, 5), (5, 6), (6, 7)]])
    best = found.take(int(np.argmin(found.chi2)))
    assert best.time == pytest.approx(instant, abs=2e-5)
    assert best.places[1] - best.places[0] == pytest.approx(DIAMETER * kick / np.hypot(*kick), abs=1e-4)
    assert best.after[1] == pytest.approx(kick, abs=1e-4)
    assert best.before[0] == pytest.approx([0.3, 0.0], abs=1e-4)
    assert best.chi2 < 1e-2 * best.smooth
    assert (best.slips == 0).all()


def test_gaps_of_several_candidates_are_fitted_as_each_alone():
    """Also where the second ball has more positions, and where the first lacks some."""
    (one, other), _ = make_hit(5.3 * FRAME_S)
    candidates = [[one.between(1, 9), other], [one, other.between(3.5, 20)], make_hit(6.6 * FRAME_S)[0]]
    gaps = [[(4, 5), (5, 6)], [(5, 6)], [(6, 7)]]
    together = fit(candidates, gaps)
    assert together.candidate.tolist() == [0, 0, 1, 2]
    alone = [fit([c], [g]) for c, g in zip(candidates, gaps, strict=True)]
    for name, value in together._asdict().items():
        if name != "candidate":
            np.testing.assert_allclose(value, np.concatenate([getattr(a, name) for a in alone]), rtol=1e-6, atol=1e-9)


def test_a_ball_with_too_few_positions_has_no_velocity_there():
    (one, other), _ = make_hit(5.3 * FRAME_S)
    found = fit([[one.between(-1, 6.5), other], [one.between(-1, 6.5), other.between(4.5, 20)]], [[(5, 6)], [(5, 6)]])
    assert found.candidate.tolist() == [0]  # no ball of the other candidate has a path on both sides
    assert np.isnan(found.after[0, 0]).all()
    assert np.isfinite(found.before[0, 0]).all()
    assert np.isnan(found.velocity_std[0]).tolist() == [True, False]
    assert not len(fit([[one.between(-1, 6.5)]], [[(5, 6)]]).time)


def test_an_earlier_slide_bends_the_path_before_a_contact():
    """A ball slides for 12 ms from before its first position on, rolls, and is stopped."""
    start, decel, lasts, instant = -2e-3, 2.0, 12e-3, 5.5 * FRAME_S
    since = np.minimum(FRAME * FRAME_S, instant) - start
    slid = np.minimum(since, lasts)
    x = 0.4 * since - decel * slid * (since - slid / 2)
    ball = ConsecutivePositions(0, FRAME, FRAME * FRAME_S, np.column_stack([x, 0 * x]), np.full(12, NOISE**2))
    slide = (start, np.array([7 * decel * lasts / 2, 0.0]))
    (with_slide,) = fit([[ball]], [[(5, 6)]], GLIDES, decel, [[slide]]).before[:, 0, 0]
    (without,) = fit([[ball]], [[(5, 6)]], GLIDES, decel).before[:, 0, 0]
    true = 0.4 - decel * lasts
    assert with_slide == pytest.approx(true, abs=1e-4)
    assert abs(without - true) > 20 * abs(with_slide - true)


def test_paths_that_no_contact_explains_have_an_instant_as_uncertain_as_the_gap():
    """Balls that jump about by a diameter: chi^2 of 1e8 and more, and in some gaps without a least inside."""
    rng = np.random.default_rng(1)
    jumps = [make_rows(k, DIAMETER * rng.normal(size=(12, 2)), (0.0, 0.0), (0.0, 0.0), 0.0) for k in range(40)]
    pairs = [list(pair) for pair in zip(jumps[::2], jumps[1::2], strict=True)]
    found = fit(pairs, [[(4, 5), (5, 6), (6, 7)]] * len(pairs))
    assert found.excess.min() > 1e6
    assert (found.time_std <= FRAME_S).all()
    assert (found.time_std > 0.99 * FRAME_S).any()
