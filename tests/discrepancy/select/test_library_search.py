"""The search: effects added, dropped and exchanged; shapes; what each may be confused with; parameters held at zero."""

import dataclasses
from functools import cache
from types import SimpleNamespace as Made

import numpy as np
import pytest
from discrepancy_clips import EFFECTS, STD, collisions, design, exact, noise_of_pair, nulls, only
from discrepancy_selected import claimed, library_fits, selected
from scipy.stats import chi2 as chi2_law
from scipy.stats import kstest

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.parameters import BASE_PARAMETERS, list_candidates, list_names_to_fit
from discrepancy.noise.model import estimate_noise
from discrepancy.policy import SearchPolicy, applied_policy, current_policy
from discrepancy.select.free_law_contest import select_effects_and_law
from discrepancy.select.library_search import (
    choose_first_effects,
    choose_simplest,
    complete_search,
    describe_claims,
    find_undetectable,
    fit_effects_from,
    improve_once,
    iterate_models,
    make_selection,
    search_from,
    search_from_other_effects,
)
from synthcam.library import library
from synthcam.model import Model

FEW = ("velocity_restitution", "spin_transfer_velocity", "rolling_quadratic", "mass_mismatch", "hop")
SLIDING = ("stribeck", "viscous_friction", "drilling_spin", "rolling_quadratic")


def few(monkeypatch, names=FEW):
    only(monkeypatch, **{n: library()[n] for n in names})


@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("rho", [0.0, pytest.param(0.5, marks=pytest.mark.gate)])
def test_with_nothing_hidden_the_score_is_a_standard_normal(effect, rho):
    z = nulls(8, 24, rho)[effect]
    assert kstest(z, "norm").pvalue > 1e-3
    assert np.abs(z).max() < current_policy().min_claim_sigma
    low, high = chi2_law.ppf([1e-3, 1 - 1e-3], len(z))
    assert low < z @ z < 1.2 * high  # the noise itself is estimated too


@pytest.mark.gate
def test_noise_that_remembers_raises_no_false_alarm_but_would_without_whitening():
    z = nulls(16, 8, 0.9)["velocity_restitution"]  # so slow a noise is hard to read off: its scale is known to 20 %
    assert np.abs(z).max() < current_policy().min_claim_sigma
    assert z @ z < 1.5 * chi2_law.ppf(1 - 1e-3, len(z))
    wolf = np.abs(nulls(8, 60, 0.9, whitened=False)["velocity_restitution"])
    assert np.mean(wolf > current_policy().min_claim_sigma) > 0.2


@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("expected", [2.0, 5.0, 20.0])
def test_a_hidden_effect_scores_what_its_strength_is_worth(effect, expected):
    clean = design()
    rng = np.random.default_rng(3)
    errors = [noise_of_pair(rng, 0.0) for _ in clean.clips]
    signature = np.linalg.norm(clean.scores(errors)[effect][0])
    name = {"velocity_restitution": "velocity_restitution.e", "rolling_quadratic": "rolling_quadratic.K"}[effect]
    bent = exact(Model().replace({name: expected / signature}), 8, 5)
    moved = [e + b.xy - c.xy for e, b, c in zip(errors, bent, clean.clips, strict=True)]
    gained = clean.z(moved, effect) - clean.z(errors, effect)
    assert gained == pytest.approx(expected, rel=0.05)
    assert clean.z(moved, effect) == pytest.approx(expected, abs=3.5)


def started(truth, base=None, count=6, seed=9):
    base = base or Model()
    clips = collisions(truth, count, seed)
    noise = estimate_noise(clips)
    return clips, fit_model(clips, base, list_names_to_fit(base), noise), noise


def standing(truth, *state):
    """Steps that stand at a model with these candidates."""
    clips, base, noise = started(truth)
    steps = library_fits(clips, base, noise)
    known = {s.name: s for s in list_candidates(base.model, base.names)}
    chosen = tuple(known[n] for n in state)
    strengths = [s for k in chosen for s in k.strengths]
    steps.fits[frozenset(chosen)] = fit_model(clips, base.model, [*base.names, *strengths], noise)
    return steps, chosen


def test_a_wrong_effect_is_exchanged_for_the_right_one(monkeypatch):
    few(monkeypatch)
    steps, state = standing(Model().replace({"velocity_restitution.e": 0.01}), "spin_transfer_velocity")
    better = improve_once(steps, state)
    assert [s.name for s in better] == ["velocity_restitution"]
    assert improve_once(steps, better) is None


def test_an_effect_that_is_not_needed_is_dropped(monkeypatch):
    few(monkeypatch)
    steps, state = standing(
        Model().replace({"velocity_restitution.e": 0.01}), "rolling_quadratic", "velocity_restitution"
    )
    better = improve_once(steps, state)
    assert [s.name for s in better] == ["velocity_restitution"]


@pytest.mark.parametrize(("size", "names"), [(0.0, ["rolling_quadratic"]), (10.0, [])])
def test_an_effect_is_not_added_where_far_more_is_missing(size, names, monkeypatch):
    """An effect that closes less than a tenth of the gap could not be claimed later. Each clip sways differently."""
    few(monkeypatch, ["rolling_quadratic"])
    clips, _, noise = started(Model().replace({"rolling_quadratic.K": 0.02}))
    rng = np.random.default_rng(4)
    turns = [np.sin(clip.frame / 6 + rng.uniform(0, 2 * np.pi)) for clip in clips]
    sway = [size * STD * turn[:, None] * rng.standard_normal(2) for turn in turns]
    clips = [dataclasses.replace(clip, xy=clip.xy + off) for clip, off in zip(clips, sway, strict=True)]
    steps = library_fits(clips, fit_model(clips, Model(), list_names_to_fit(Model()), noise), noise)
    assert steps.ranking[0].sigma > steps.required_sigma
    assert [s.name for s in next(iterate_models(steps), ())] == names


def test_a_search_goes_on_from_other_effects(monkeypatch):
    few(monkeypatch)
    truth = Model().replace({"velocity_restitution.e": 0.05, "rolling_quadratic.K": 0.1})
    clips, base, noise = started(truth)
    steps = library_fits(clips, base, noise)
    found = make_selection(steps, next(iterate_models(steps)))  # stopped at the first
    assert [s.name for s in found.state] == ["velocity_restitution"]
    again = search_from(steps, found, ["rolling_quadratic"], truth)
    assert [s.name for s in again.state] == ["rolling_quadratic", "velocity_restitution"]
    assert again.best.chi2 < found.best.chi2 - 50
    assert search_from(steps, again, ["velocity_restitution"], truth) is None  # comes to the same


@cache
def lens_beyond_realistic_sizes():
    """A lens term that shows only at sizes that count as unrealistic, beside a tilt that explains 0.5 % of it."""
    with pytest.MonkeyPatch.context() as patch, applied_policy(SearchPolicy(max_detection_limit=0.05)):
        only(patch, ["force_place"], **{n: library()[n] for n in ("plate_tilt", "lens_distortion")})
        clips, base, noise = started(Model().replace({"lens_distortion.k1": 1.0}))
        steps = library_fits(clips, base, noise)
        return steps, [(), *iterate_models(steps)][-1], select_effects_and_law(steps), choose_first_effects(steps)


def test_a_search_that_explains_too_little_begins_again_from_other_effects():
    steps, stopped, found, starts = lens_beyond_realistic_sizes()
    assert stopped == ()  # forward selection alone ends here
    assert steps.ranking[0].effect == "plate_tilt"
    assert [s.name for s in starts] == ["lens_distortion", "plate_tilt"]  # by the cost of their fits
    assert [s.name for s in found.state] == ["lens_distortion"]
    assert found.free_law is None
    assert found.best.model.value("lens_distortion.k1") == pytest.approx(
        1.0, abs=4 * found.best.std["lens_distortion.k1"]
    )


def test_other_starts_are_tried_only_where_much_is_missing(monkeypatch):
    few(monkeypatch)
    clips, base, noise = started(Model().replace({"velocity_restitution.e": 0.01}))
    steps, found = selected(clips, base, noise)
    monkeypatch.setattr(
        "discrepancy.select.library_search.choose_first_effects", lambda library: pytest.fail("not needed")
    )
    assert search_from_other_effects(steps, found.state) is found.state


def test_a_wrong_beginning_is_shed_and_what_is_not_claimed_dropped(monkeypatch):
    few(monkeypatch, (*FEW, "stribeck"))
    truth = Model().replace({"stribeck.rise": 0.1, "stribeck.slip": 0.07})
    clips, base, noise = started(truth)
    steps, found = selected(clips, base, noise)
    assert [s.name for s in complete_search(steps, fit_effects_from(steps, ["rolling_quadratic"], Model()))] == [
        "stribeck"
    ]
    (own,) = fit_effects_from(steps, ["stribeck"], Model().replace({"stribeck.rise": 0.1, "stribeck.slip": 0.2}))
    fitted = steps.fits[frozenset([own])]
    assert "stribeck.slip" in fitted.names
    assert fitted.chi2 == pytest.approx(found.best.chi2, abs=0.1)
    clips, base, noise = started(Model())
    steps, _ = selected(clips, base, noise)
    assert complete_search(steps, fit_effects_from(steps, ["velocity_restitution"], Model())) == ()


def test_the_best_fit_holds_the_named_effects_and_no_other(monkeypatch):
    few(monkeypatch)
    clips, base, noise = started(Model().replace({"velocity_restitution.e": 0.02, "rolling_quadratic.K": 0.3}))
    steps, found = selected(clips, base, noise)
    assert {n.effect for n in describe_claims(steps, found.state)} == {"velocity_restitution", "rolling_quadratic"}
    assert found.base.model.effects == ()
    assert {e.name() for e in found.best.model.effects} == {n.effect for n in describe_claims(steps, found.state)}
    assert found.base.chi2 > found.best.chi2 + 48


@cache
def stribeck():
    """Ten times its limit, as far from linear as it gets in this many clips."""
    truth = Model().replace({"stribeck.rise": 0.1, "stribeck.slip": 0.07})
    with pytest.MonkeyPatch.context() as patch:
        few(patch, SLIDING)
        clips, base, noise = started(truth, count=8)
        return clips, noise, *selected(clips, base, noise)


def test_a_shape_is_fitted_so_that_nothing_is_left_for_a_second_effect():
    _, _, steps, found = stribeck()
    assert [n.effect for n in describe_claims(steps, found.state)] == ["stribeck"]
    (named,) = describe_claims(steps, found.state)
    assert abs(named.shapes["stribeck.slip"] - 0.07) < 3.5 * named.shape_std["stribeck.slip"] < 0.07
    assert abs(named.values["stribeck.rise"] - 0.1) < 3.5 * named.std["stribeck.rise"]


def test_the_strengths_error_includes_the_shapes_freedom():
    clips, noise, steps, found = stribeck()
    alone = fit_model(clips, found.best.model, [*BASE_PARAMETERS, "stribeck.rise"], noise)
    assert describe_claims(steps, found.state)[0].std["stribeck.rise"] > 1.05 * alone.std["stribeck.rise"]
    assert found.best.chi2 == pytest.approx(alone.chi2, abs=0.1)


def test_the_simpler_of_two_that_fit_as_well_is_named(monkeypatch):
    """Stribeck's law with a large slip speed is the viscous one."""
    few(monkeypatch, SLIDING)
    clips, base, noise = started(Model().replace({"viscous_friction.k": 0.03}))
    (named,) = claimed(clips, base, noise)
    assert named.aliases == ("viscous_friction", "stribeck")


def test_a_slightly_better_fit_is_no_reason_for_more_parameters():
    """A wave of 1 m is a tilt: which of the two fits better is chance."""
    tilt, wave = (
        frozenset({s}) for s in list_candidates(Model(), BASE_PARAMETERS) if s.name in ("plate_tilt", "plate_waviness")
    )
    for better, simplest in ((-5.0, tilt), (5.0, tilt), (20.0, wave)):
        library = Made(cost_of=lambda key, b=better: 100.0 - b * (key == wave))
        assert choose_simplest(library, [wave, tilt]) == simplest


def test_a_shape_that_says_nothing_is_undetermined(monkeypatch):
    few(monkeypatch)
    clips, base, noise = started(Model().replace({"hop.share": 0.012, "hop.bounce": 0.4}))
    steps, found = selected(clips, base, noise)
    assert [n.effect for n in describe_claims(steps, found.state)] == ["hop"]
    assert describe_claims(steps, found.state)[0].shape_std == {"hop.bounce": np.inf}


def test_limits_are_the_strengths_that_are_seen_at_five_sigma(monkeypatch):
    few(monkeypatch)
    clips, base, noise = started(Model().replace({"velocity_restitution.e": 0.02}))
    (named,) = claimed(clips, base, noise)
    limit = named.limit["velocity_restitution.e"]
    assert named.sigma == pytest.approx(5 * named.values["velocity_restitution.e"] / limit, rel=0.1)
    assert named.naming["velocity_restitution.e"] > limit


def test_what_cannot_be_told_apart_is_a_class(monkeypatch):
    few(monkeypatch, ("mass_mismatch", "diameter_mismatch", "rolling_quadratic"))
    clips, base, noise = started(Model().replace({"mass_mismatch.excess": 0.0004}))
    (named,) = claimed(clips, base, noise)
    assert named.effect in ("mass_mismatch", "diameter_mismatch")
    assert set(named.aliases) == {"mass_mismatch", "diameter_mismatch"}
    (((rival,), cosine),) = named.alike
    assert {rival, named.effect} == set(named.aliases)
    assert cosine > 0.9


def test_friction_and_spin_are_found_one_after_the_other_in_a_textbook_collision(monkeypatch):
    """The discovery of Behringer and Painter: balls that collide also slide, and turn each other."""
    few(monkeypatch, ("velocity_restitution", "rolling_quadratic", "ball_friction", "stribeck"))
    textbook = Model().replace({"sliding_friction": 0.0, "spin_transfer": 0.0})
    clips, base, noise = started(Model(), textbook)
    steps, found = selected(clips, base, noise)
    assert [n.effect for n in describe_claims(steps, found.state)] == ["sliding_friction", "spin_transfer"]
    assert all(n.aliases == (n.effect,) for n in describe_claims(steps, found.state))
    for n in describe_claims(steps, found.state):
        assert abs(n.values[n.effect] - getattr(Model(), n.effect)) < 3.5 * n.std[n.effect]
    best = found.best
    assert base.chi2 > 1e4 * best.chi2
    assert abs(best.chi2 / (best.points - best.parameters) - 1) < 0.1
    assert dataclasses.replace(best.model, **{k: getattr(Model(), k) for k in BASE_PARAMETERS}) == Model()


def test_a_search_is_as_strict_as_its_library_is_large(monkeypatch):
    clips, base, noise = started(Model())
    steps, whole = selected(clips, base, noise)
    assert describe_claims(steps, whole.state) == ()
    assert steps.required_sigma > current_policy().min_claim_sigma
    assert {"clock_error", "adhesion"} <= set(find_undetectable(steps, whole.state))
    few(monkeypatch, EFFECTS)
    assert library_fits(clips, base, noise).required_sigma == current_policy().min_claim_sigma


def test_the_error_of_a_law_with_a_kink_reaches_to_its_other_minima(monkeypatch):
    """If all impacts slip, only share times mu is known; chi^2 still bends sharply at a kink."""
    few(monkeypatch, ("ball_friction", "velocity_restitution"))
    truth = {"ball_friction.share": 0.18, "ball_friction.mu": 0.105}
    clips, base, noise = started(Model().replace(truth), count=16, seed=22)
    steps, found = selected(clips, base, noise)
    (named,) = describe_claims(steps, found.state)
    off = abs(named.values["ball_friction.share"] - truth["ball_friction.share"])
    assert off > 10 * found.best.std["ball_friction.share"]
    assert off < 2 * named.std["ball_friction.share"]


@pytest.mark.parametrize(
    "rise", [pytest.param(0.02, marks=pytest.mark.gate), 0.3, pytest.param(1.5, marks=pytest.mark.gate)]
)
def test_the_error_of_a_law_without_a_kink_is_that_of_its_one_minimum(monkeypatch, rise):
    few(monkeypatch, ("stribeck",))
    clips, base, noise = started(Model().replace({"stribeck.rise": rise, "stribeck.slip": 0.1}), count=12)
    steps, found = selected(clips, base, noise)
    (named,) = describe_claims(steps, found.state)
    for name, std in (named.std | named.shape_std).items():
        assert std == pytest.approx(found.best.std[name], rel=0.1)


@pytest.mark.gate
def test_what_first_order_leaves_over_of_an_absorbed_effect_leads_no_search():
    """A wrong clock is absorbed but for what the step of a derivative leaves; in whitened residuals that may score."""
    clips = collisions(Model().replace({"exposure_blur.longer": 9e-4}), 10, 9, 0.9)
    noise = estimate_noise(clips)
    steps, found = selected(clips, fit_model(clips, Model(), BASE_PARAMETERS, noise), noise)
    assert max(steps.ranking, key=lambda c: c.sigma).effect == "clock_error"
    assert steps.ranking[0].effect == "exposure_blur"
    assert "exposure_blur" in [n.effect for n in describe_claims(steps, found.state)]
    assert "clock_error" in find_undetectable(steps, found.state)


def test_shapes_that_show_only_at_full_strength_are_found(monkeypatch):
    """To first order a hop does not know how high the ball bounces."""
    few(monkeypatch)
    truth = {"hop.share": 1.0, "hop.bounce": 0.4}
    clips, base, noise = started(Model().replace(truth), count=12, seed=3)
    (named,) = claimed(clips, base, noise)
    assert named.shapes["hop.bounce"] == pytest.approx(0.4, abs=3.5 * named.shape_std["hop.bounce"])
    assert named.shape_std["hop.bounce"] < 0.1


def test_a_begun_state_keeps_a_better_fit_that_is_known(monkeypatch):
    few(monkeypatch, ("stribeck", "rolling_quadratic"))
    clips, base, noise = started(Model().replace({"stribeck.rise": 0.1, "stribeck.slip": 0.06}))
    steps, found = selected(clips, base, noise)
    alone = library_fits(clips, base, noise)
    monkeypatch.setattr("discrepancy.select.library_search.minimise_chi2", lambda evidence, fit: fit)  # it stays
    for each in (alone, steps):
        state = fit_effects_from(each, ["stribeck"], Model().replace({"stribeck.rise": 0.01, "stribeck.slip": 0.004}))
    assert alone.fits[frozenset(state)].chi2 > found.best.chi2 + 10
    assert steps.fits[frozenset(state)] is found.best


def test_an_effect_does_not_count_for_what_a_poor_fit_of_the_others_leaves(monkeypatch):
    """A fit of the right effect stopped at a local minimum; beside a needless effect it did not."""
    few(monkeypatch)
    steps, state = standing(
        Model().replace({"velocity_restitution.e": 0.01}), "rolling_quadratic", "velocity_restitution"
    )
    right = state[1:]
    poor = steps.base.model.replace({"velocity_restitution.e": 0.02})
    steps.fits[frozenset(right)] = linearise(
        steps.evidence, poor, (*steps.base.names, "velocity_restitution.e"), steps.base.launches
    )
    steps.done.add(frozenset(right))
    assert steps.fit(right).chi2 > steps.fit(state).chi2 + 100
    assert improve_once(steps, state) == right
    assert steps.fit(right).chi2 == pytest.approx(steps.fit(state).chi2, abs=10)
