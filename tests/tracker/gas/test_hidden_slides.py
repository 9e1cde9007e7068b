"""Slides after contacts against their closed form: friction of the film, velocities, and kinks that were missed."""

import numpy as np
import pytest

from tracker.gas.hidden_slides import MAX_CHI2_PER_DOF, ROWS, PathStarts, PlateFriction, fit_slides, measure_friction

NOISE, FPS, DECEL, SHARE = 5e-6, 250.0, 2.3, 0.33


def make_starts(paths, seed=1, decel=DECEL, share=SHARE, noise=NOISE):
    """Balls that roll into a contact at random speeds, with the velocities just after it.

    Each slides until its lowest point rests, which a sphere does after 2/7 of its slip.
    """
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 2 * np.pi, paths)
    normal = np.column_stack([np.cos(turn), np.sin(turn)])
    before, other = rng.normal(0, 0.2, (2, paths, 2))
    push = 0.95 * ((other - before) * normal).sum(axis=1)
    start = before + push[:, None] * normal
    rolled = before + other
    slip = push[:, None] * normal + share * (rolled * normal).sum(axis=1)[:, None] * normal
    size = np.hypot(*slip.T)
    time = np.tile((np.arange(ROWS) + 0.6) / FPS, (paths, 1))
    rolls = 2 * size / 7 / decel
    way = np.where(time < rolls[:, None], decel * time**2 / 2, (2 * size / 7)[:, None] * (time - rolls[:, None] / 2))
    position = start[:, None] * time[..., None] - way[..., None] * (slip / size[:, None])[:, None]
    position += rng.normal(0, noise, position.shape)
    few, none = np.full(paths, 1e-4), np.zeros((paths, 2))
    return PathStarts(time, position, time > 0, few, before, few, none, rolled, normal), start


def test_a_film_shows_its_friction_and_the_velocities_after_contacts():
    starts, true = make_starts(100)
    friction = measure_friction(starts, NOISE)
    assert friction.decel == pytest.approx(DECEL, rel=3 * friction.decel_std)
    assert friction.decel_std < 0.03
    assert friction.spin_transfer == pytest.approx(SHARE, abs=0.02)
    fits = fit_slides(starts, friction, NOISE)
    z = (fits.start - true) / (NOISE * np.sqrt(fits.gain))[:, None]
    assert 0.8 < np.sqrt((z**2).mean()) < 1.25
    assert np.median(fits.chi2_per_dof) == pytest.approx(1, abs=0.3)
    unlike = fit_slides(starts, PlateFriction(DECEL / 2, 0.01, SHARE), NOISE)
    assert np.median(unlike.chi2_per_dof) > MAX_CHI2_PER_DOF


@pytest.mark.parametrize(("decel", "share", "noise"), [(0.3, 0.33, NOISE), (1.0, 0.0, 5e-5), (6.0, 0.33, NOISE)])
def test_a_friction_far_from_the_usual_one_is_found_too(decel, share, noise):
    """The cost has several minima; that of the true friction is the lowest."""
    friction = measure_friction(make_starts(100, decel=decel, share=share, noise=noise)[0], noise)
    assert friction.decel == pytest.approx(decel, rel=3 * friction.decel_std)
    assert friction.spin_transfer == pytest.approx(share, abs=0.1)


def test_few_paths_show_no_friction_and_nor_do_bodies_that_never_roll():
    assert measure_friction(make_starts(15)[0], NOISE) is None
    starts, true = make_starts(50)
    slow = DECEL * true / np.hypot(*true.T)[:, None]  # friction of a puck, against its velocity
    position = true[:, None] * starts.time[..., None] - slow[:, None] * starts.time[..., None] ** 2 / 2
    assert measure_friction(starts._replace(position=position), NOISE) is None


def test_a_kink_that_was_missed_shows_and_may_be_skipped():
    starts, true = make_starts(40)
    friction, position = PlateFriction(DECEL, 0.01, SHARE), starts.position.copy()
    position[0, :2] += 1e-3
    starts = starts._replace(position=position)
    assert (fit_slides(starts, friction, NOISE).chi2_per_dof > MAX_CHI2_PER_DOF).tolist() == [True] + [False] * 39
    later = fit_slides(starts.skip(3), friction, NOISE)
    assert later.chi2_per_dof[0] < MAX_CHI2_PER_DOF
    assert later.start[0] == pytest.approx(true[0], abs=6 * NOISE * np.sqrt(later.gain[0]))


def test_a_slip_that_is_left_over_decays_until_the_ball_rolls():
    starts, _ = make_starts(10)
    fits = fit_slides(starts, PlateFriction(DECEL, 0.01, SHARE), NOISE)
    lasts = float(fits.duration[0])
    np.testing.assert_allclose(fits.find_left(0, lasts / 4), 0.75 * fits.slip[0])
    assert not fits.find_left(0, 2 * lasts).any()
