"""The models that a search has fitted: shapes that went astray, effects taken away."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import collisions, exact, noisy, only
from discrepancy_selected import library_fits, selected

from discrepancy.data.launch import HEADING
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.parameters import BASE_PARAMETERS, list_candidates
from discrepancy.noise.model import estimate_noise
from discrepancy.policy import SearchPolicy, applied_policy
from discrepancy.select import library_fits as fits_of_library
from discrepancy.select.library_search import describe_claims
from discrepancy.select.model_cost import compute_cost
from discrepancy.select.score_test import ScoreTests
from synthcam.library import library
from synthcam.model import Model


def test_a_shape_that_went_astray_is_found_again():
    truth = {"hop.share": 1.0, "hop.bounce": 0.4}
    clips = collisions(Model().replace(truth), 4, 3)
    noise = estimate_noise(clips)
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    seen, hop = (
        library_fits(clips, base, noise),
        next(s for s in list_candidates(Model(), BASE_PARAMETERS) if s.name == "hop"),
    )
    lost = linearise(
        seen.evidence, Model().replace(truth | {"hop.bounce": 0.0}), (*BASE_PARAMETERS, *truth), base.launches
    )
    blind = np.append(np.ones(len(BASE_PARAMETERS) + 1), 0.0)  # nothing tells that a higher bounce would be better
    lost = dataclasses.replace(
        lost, linearisation=dataclasses.replace(lost.linearisation, slopes=tuple(x * blind for x in lost.slopes))
    )
    found = seen._escape_local_minimum((hop,), lost)
    assert found.model.value("hop.bounce") == pytest.approx(0.4, abs=3.5 * found.std["hop.bounce"])
    assert found.std["hop.bounce"] < 0.1
    assert found.chi2 < lost.chi2 - 100


def test_one_of_two_that_together_hold_the_ball_at_rest_can_be_taken_away(monkeypatch):
    """A tilt too steep for a ball to rest, against the slope of a wave."""
    only(monkeypatch, **{n: library()[n] for n in ("plate_tilt", "plate_waviness")})
    clips = collisions(Model(), 8, 1)
    noise = estimate_noise(clips)
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    seen, names = library_fits(clips, base, noise), (*BASE_PARAMETERS, "plate_tilt.x", "plate_waviness.b")
    values = {"plate_tilt.x": 2e-3, "plate_waviness.b": 3.2e-5, "plate_waviness.wavelength": 0.1}
    both = linearise(seen.evidence, base.model.replace(values), names, base.launches)
    (wave,) = (s for s in list_candidates(Model(), BASE_PARAMETERS) if s.name == "plate_waviness")
    with pytest.raises(ValueError, match="rest"):
        seen.evidence.whitened_residuals(wave.remove_from(both.model), both.launches)
    left = seen.remove(both, wave)
    assert left.names == (*BASE_PARAMETERS, "plate_tilt.x")
    assert left.chi2 == pytest.approx(base.chi2)


def test_errors_are_those_of_the_whole_motion_where_balls_push_each_other(monkeypatch):
    """A strong pull: derivatives without it would give an error a tenth too large."""
    only(monkeypatch, magnetic_attraction=library()["magnetic_attraction"])
    clips = collisions(Model().replace({"magnetic_attraction.pull": 0.4}), 4, 3)
    noise = estimate_noise(clips)
    steps, found = selected(clips, fit_model(clips, Model(), BASE_PARAMETERS, noise), noise)
    (named,) = describe_claims(steps, found.state)
    step, best = 0.5 * named.std["magnetic_attraction.pull"], found.best
    chi2 = []
    for value in (best.model.value("magnetic_attraction.pull") + k * step for k in (-1, 0, 1)):
        held = best.model.replace({"magnetic_attraction.pull": value})
        chi2.append(fit_model(clips, held, BASE_PARAMETERS, noise, best.launches).chi2)
    curved = (chi2[0] - 2 * chi2[1] + chi2[2]) / step**2
    assert named.std["magnetic_attraction.pull"] == pytest.approx(np.sqrt(2 / curved), rel=0.03)


def test_a_fit_that_is_offered_is_held_against_the_one_known():
    clips = collisions(Model(), 6, 3)
    noise, key = (
        estimate_noise(clips),
        frozenset(s for s in list_candidates(Model(), BASE_PARAMETERS) if s.name == "air_drag"),
    )
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    store = library_fits(clips, base, noise)
    store.fit(())
    store.fits[key] = known = fit_model(clips, Model(), [*BASE_PARAMETERS, "air_drag.share"], noise)
    store.done.add(key)
    poor = linearise(
        store.evidence, Model().replace({"air_drag.share": 5.0}), (*BASE_PARAMETERS, "air_drag.share"), base.launches
    )
    store.offer(key, poor)
    assert store.fits[key] is known
    assert key in store.done
    better = dataclasses.replace(poor, residuals=tuple(0 * r for r in poor.residuals))
    store.offer(key, better)
    assert store.fits[key] is better
    assert key not in store.done


def test_score_tests_are_those_of_the_fit_that_is_kept(monkeypatch):
    only(monkeypatch, **{n: library()[n] for n in ("air_drag", "velocity_restitution")})
    clips = collisions(Model(), 4, 3)
    noise = estimate_noise(clips)
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    store = library_fits(clips, base, noise)
    before = store.score_tests(())
    assert store.score_tests(()) is before
    store.offer(frozenset(), dataclasses.replace(base, residuals=tuple(0.5 * r for r in base.residuals)))
    after = store.score_tests(())
    assert after.fit.chi2 == store.fit(()).chi2 < 0.3 * before.fit.chi2
    assert after.ranking()[0].sigma < before.ranking()[0].sigma


def test_a_fit_that_cannot_reach_a_model_that_it_contains_begins_again_there(monkeypatch):
    """Strikers that come from the wrong side: no step from there leads back."""
    only(monkeypatch, air_drag=library()["air_drag"])
    clips = collisions(Model(), 2, 3)
    noise = estimate_noise(clips)
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    store = library_fits(clips, base, noise)
    (drag,) = list_candidates(Model(), BASE_PARAMETERS)
    turned, names = base.launches.copy(), (*BASE_PARAMETERS, "air_drag.share")
    turned[:, HEADING] += 3.0
    store.offer(frozenset({drag}), linearise(store.evidence, Model().replace({names[-1]: 3.0}), names, turned))
    found = store.fit((drag,))
    assert found.chi2 < base.chi2 + fits_of_library.MIN_USEFUL_CHI2
    assert found.names == names


@pytest.mark.gate
def test_starts_of_a_real_size_are_tried_at_the_likeliest_shapes_only(monkeypatch):
    """A dropped frame has 499 shapes. The true one is among the few that are tried."""
    clips = noisy(exact(Model().replace({"dropped_frame.lost": 1.0, "dropped_frame.frame": 40.0}), 4, 3), 3)
    noise = estimate_noise(clips)
    seen = library_fits(clips, fit_model(clips, Model(), BASE_PARAMETERS, noise), noise)
    (dropped,) = (s for s in list_candidates(Model(), BASE_PARAMETERS) if s.name == "dropped_frame")
    (scored,) = ScoreTests.of(seen.evidence, seen.base, only=[dropped]).ranking()
    tried, step = set(), fits_of_library.take_one_step

    def spy(evidence, fit, model):
        tried.add(model.value("dropped_frame.frame"))
        return step(evidence, fit, model)

    monkeypatch.setattr(fits_of_library, "take_one_step", spy)
    with applied_policy(SearchPolicy(max_linear_shapes_tried=4)):
        best = fits_of_library._realistic_starts(seen.evidence, seen.base, scored)[0].model
    assert len(tried) == 4
    assert (best.value("dropped_frame.frame"), best.value("dropped_frame.lost")) == (40.0, 1.0)


def test_a_candidate_whose_freedom_costs_too_much_is_given_up_sooner(monkeypatch):
    """Waves have two strengths and two shapes. Their chi^2 must be lower by as much as these cost more than a drag."""
    only(monkeypatch, **{n: library()[n] for n in ("air_drag", "plate_waviness")})
    clips = collisions(Model().replace({"air_drag.share": 3.0}), 4, 3)
    noise = estimate_noise(clips)
    store = library_fits(clips, fit_model(clips, Model(), BASE_PARAMETERS, noise), noise)
    scored = {c.effect: c for c in store.score_tests(()).ranking()}
    drag, waves = (frozenset({scored[name].candidate}) for name in ("air_drag", "plate_waviness"))
    store.extend(drag, store.base, scored["air_drag"])
    asked, inner = [], fits_of_library.minimise_chi2

    def minimise(evidence, start, *args, useful_chi2=np.inf, **options):
        asked.append((start, useful_chi2))
        return inner(evidence, start, *args, useful_chi2=useful_chi2, **options)

    monkeypatch.setattr(fits_of_library, "minimise_chi2", minimise)
    store.extend(waves, store.base, scored["plate_waviness"])
    start, useful_chi2 = next(one for one in asked if "plate_waviness.wavelength" in one[0].names)
    price = compute_cost(start, store.base) - start.chi2
    assert price > store.cost_of(drag) - store.fits[drag].chi2 > 0
    assert useful_chi2 + price == pytest.approx(store.cost_of(drag) + fits_of_library.SCORE_ERROR_CHI2)
    assert useful_chi2 < store.fits[drag].chi2 + 30
