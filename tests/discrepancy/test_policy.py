"""The numbers that decide a verdict: a case on either side of each, so near that half of it or twice it is wrong."""

import ast
import dataclasses
import itertools
import re
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace as Made

import numpy as np
import pytest
from discrepancy_clips import exact, noisy, only
from discrepancy_selected import selected

from discrepancy import policy
from discrepancy.add import AddedEffect
from discrepancy.fitting import noise_refit
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import Linearisation, ModelFit, WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS, Candidate, list_candidates
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.library import free_laws_over
from discrepancy.free_laws.marginal_likelihood import CurveEvidence
from discrepancy.noise import model as noise
from discrepancy.noise.model import Noise, NoiseComponent, estimate_noise
from discrepancy.outcome import decide_verdict
from discrepancy.policy import SearchPolicy, applied_policy, current_policy, read_policy
from discrepancy.select import free_law_contest, law_fit, library_search
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.free_law_contest import (
    FreeLawFits,
    Opponent,
    explains_all,
    find_better_law,
    find_near_law,
    find_winning_law,
)
from discrepancy.select.law_fit import LawScore
from discrepancy.select.library_search import Selection, choose_simplest, complete_search
from discrepancy.select.score_test import CandidateScore, ScoreTests
from discrepancy.validate import claim_tests
from discrepancy.validate.claim_tests import HeldOutClips, HeldOutTest, Rejection, judge_predictions, validate
from discrepancy.validate.gap import GapPhase, closed_share
from discrepancy.validate.outlier_clips import find_outlier_clips
from discrepancy.validate.residual_map import ClipAmplitudes, combine_clips
from synthcam.library import library
from synthcam.model import Model
from synthcam.settings import InputError

NOISE = Noise(NoiseComponent(1.0))


E = "velocity_restitution.e"
HOP = EffectClaim("hop", {"hop.share": 0.1}, {"hop.share": 0.01}, 10.0, ("hop",))


@pytest.fixture(scope="module")
def sized():
    """From a sigma, clips in which a search of one candidate finds the effect at about that sigma."""
    plain = noisy(exact(Model(), 6, 3), 3)
    bent = [b.xy - a.xy for a, b in zip(exact(Model(), 6, 3), exact(Model().replace({E: 1e-3}), 6, 3), strict=True)]

    def clips(strength):
        return [dataclasses.replace(c, xy=c.xy + strength / 1e-3 * b) for c, b in zip(plain, bent, strict=True)]

    def z(strength):
        fit = fit_model(clips(strength), Model(), (*BASE_PARAMETERS, E), NOISE)
        return fit.model.value(E) / fit.std[E]

    low, high = z(0.0), z(2e-3)
    return lambda sigma: clips((sigma - low) / (high - low) * 2e-3)


@pytest.mark.parametrize(("sigma", "named"), [(3.6, 0), (4.4, 1)])
def test_four_sigma_make_a_claim_however_few_the_candidates(monkeypatch, sized, sigma, named):
    only(monkeypatch, velocity_restitution=library()["velocity_restitution"])
    clips = sized(sigma)
    assert len(selected(clips, fit_model(clips, Model(), BASE_PARAMETERS, NOISE), NOISE)[1].state) == named


def made_laws(monkeypatch, cost, scores):
    """Free laws with these scores, and a library's best model of this cost."""
    base, fit = Made(names=(), model=None, launches=None), Made(added_names=lambda base: {"hop": ["hop.share"]})
    monkeypatch.setattr(free_law_contest, "free_laws_over", lambda *_: (None,))
    monkeypatch.setattr(free_law_contest, "compute_cost", lambda f, base: cost)
    laws = FreeLawFits(Made(clips=()), base)
    laws.fitted = [Made(score=s, fit=fit, significances_of_effects=lambda base: {}) for s in scores]
    return laws, Opponent(fit, (), False)


@pytest.mark.parametrize(("ahead", "declared"), [(4.0, False), (6.0, True)])
def test_a_law_that_nobody_knows_must_be_better_by_five(monkeypatch, ahead, declared):
    laws, opponent = made_laws(monkeypatch, 100.0, [100.0 - ahead])
    assert (find_better_law(laws, opponent) is not None) is declared


@pytest.mark.parametrize(("behind", "near"), [(-3.0, True), (7.0, True), (14.0, False)])
def test_the_noise_is_read_beside_a_free_law_that_is_behind_by_ten_at_most(monkeypatch, behind, near):
    laws, opponent = made_laws(monkeypatch, 100.0, [100.0 + behind, 130.0])
    assert find_near_law(laws, opponent) is (laws.fitted[0] if near else None)


def test_two_effects_are_claimed_beside_a_free_law_however_many_more_would_be_better(monkeypatch):
    laws, opponent = made_laws(monkeypatch, 1000.0, [])
    scores, begun = iter((400.0, 300.0, 200.0, 100.0)), flat([1.0])

    def law(score):
        return Made(
            score=score, fit=begun, model_without_law=Model(), law=None, significances_of_effects=lambda base: {}
        )

    laws.fitted = [law(500.0)]
    monkeypatch.setattr(free_law_contest, "fit_law_with_effect", lambda *_: (9.0, law(next(scores))))
    monkeypatch.setattr(laws, "find_missing_effect", lambda law: Made(shapes={}, strengths=("hop.share",)))
    assert find_winning_law(laws, opponent).score == 300.0


def test_four_effects_are_named_at_most(monkeypatch):
    """Each in its turn better by far."""
    library = Made(cost_of=lambda state: -50.0 * len(state))
    monkeypatch.setattr(library_search, "choose_addition", lambda library, state: f"effect {len(state)}")
    monkeypatch.setattr(library_search, "improve_until_stable", lambda library, state: state)
    assert complete_search(library, ()) == tuple(f"effect {k}" for k in range(4))


@pytest.mark.parametrize(("cosine", "rival"), [(0.85, False), (0.94, True), (-0.94, True)])
def test_what_looks_like_the_leader_by_nine_tenths_is_fitted_too(cosine, rival):
    """Though it explains only half as much, to first order."""
    one, other = np.eye(20)[:, :1], np.eye(20)[:, 1:2]
    kind = library()["velocity_restitution"]

    def of(name, gain, signature):
        return CandidateScore(Candidate(name, (f"{name}.e",), (), kind), {}, gain**0.5, gain, 1.0, True, signature, ())

    ranking = [of("leader", 400.0, one), of("rival", 200.0, cosine * one + (1 - cosine**2) ** 0.5 * other)]
    steps = Made(evidence=None, required_sigma=4.0)
    found = library_search._choose_contenders(steps, Made(sharper=lambda evidence, c: c), ranking)
    assert [c.effect for c in found] == ["leader", "rival"][: 1 + rival]


@pytest.mark.parametrize(
    ("effect", "sizes", "told"),
    [
        ("rolling_quadratic", 7.0, True),
        ("rolling_quadratic", 14.0, False),
        ("velocity_restitution", 4.0, True),
        ("velocity_restitution", 7.0, False),  # of 0.2, where 1 is allowed
    ],
)
def test_what_only_shows_beyond_ten_realistic_sizes_or_what_is_allowed_is_not_told(monkeypatch, effect, sizes, told):
    only(monkeypatch, **{effect: library()[effect]})
    clips = noisy(exact(Model(), 4, 3), 3)
    tests = ScoreTests.of(WhitenedClips.of(clips, NOISE), fit_model(clips, Model(), BASE_PARAMETERS, NOISE))
    (trial,) = tests.trials
    (seen,) = tests.ranking()
    weaker = dataclasses.replace(trial, columns=tuple(c * seen.limit / sizes for c in trial.columns))
    (found,) = ScoreTests(tests.fit, (weaker,)).ranking()
    assert found.limit == pytest.approx(sizes)
    assert found.identifiable == told


@pytest.mark.parametrize(("sigma", "shared"), [(3.0, False), (6.0, True)])
def test_noise_is_shared_beyond_four_sigma(monkeypatch, sigma, shared):
    both = Noise(NoiseComponent(1.0), (NoiseComponent(1.0), NoiseComponent(1.0)))
    monkeypatch.setattr(noise.BallPairs, "common_mode_score", lambda self, own: sigma)
    monkeypatch.setattr(noise.BallPairs, "noise", lambda self: both)
    assert (estimate_noise(noisy(exact(Model(), 2, 3), 3)) == both) is shared
    assert bool(read_again(monkeypatch, gain=99.0, worse=0.0, sigma=sigma).shared) is shared


def read_again(monkeypatch, gain, worse, sigma=0.0, explained=True):
    """The noise of residuals that prefer another by `gain`, where the phases make that one worse."""
    left = Made(clips=[Made(claimed_std=lambda: np.ones(3))], common_mode_score=lambda noise: (sigma, 0.9))
    left.cost = lambda noise: gain * (noise == NOISE)
    left.best = lambda start: (0.0, dataclasses.replace(start, own=NoiseComponent(2.0)))
    within = Made(pairs=[None], own=lambda: NoiseComponent(1.0), cost=lambda noise: worse * (noise != NOISE))
    monkeypatch.setattr(noise_refit.RestrictedResiduals, "of", lambda *_: left)
    monkeypatch.setattr(noise_refit, "BallPairs", lambda pairs: within)
    return noise_refit.refit_noise((), None, NOISE, explained)


@pytest.mark.parametrize(("gain", "new"), [(7.0, False), (13.0, True)])
def test_noise_is_read_anew_for_a_gain_of_nine(monkeypatch, gain, new):
    assert (read_again(monkeypatch, gain, worse=0.0) is not None) is new
    assert read_again(monkeypatch, gain, worse=0.0, explained=False) is not None  # the first reading: always


@pytest.mark.parametrize(("worse", "new"), [(15.0, True), (28.0, False)])
def test_noise_that_the_phases_exclude_by_twenty_is_refused(monkeypatch, worse, new):
    assert (read_again(monkeypatch, 99.0, worse) is not None) is new


@pytest.mark.parametrize(("sigma", "declared"), [(4.0, False), (5.0, True)])
def test_a_free_law_needs_four_and_a_half_sigma(monkeypatch, sigma, declared):
    laws, opponent = made_laws(monkeypatch, 100.0, [])
    monkeypatch.setattr(free_law_contest, "whiten_law_columns", lambda *_: ())
    scored = {"sigma": sigma, "score": lambda base: 0.0}
    monkeypatch.setattr(free_law_contest, "score_law", lambda evidence, law, fit, moves: Made(fit=fit, **scored))
    monkeypatch.setattr(free_law_contest, "fit_law", lambda *_: Made(score=0.0))
    assert laws.challenge(opponent.fit).is_refuted is declared
    assert len(laws.fitted) == declared


@pytest.mark.parametrize(("share", "better"), [(0.95, False), (1.05, True)])
def test_one_of_so_many_free_laws_costs_its_choice(monkeypatch, share, better):
    """As likely as each other beforehand, one of n costs 2 ln n."""
    clips = exact(Model(), 4, 3)
    every = free_laws_over(Model(), np.array([c.launch for c in clips]), clips)
    monkeypatch.setattr(law_fit, "compute_cost", lambda fit, base: 100.0)
    weight = CurveEvidence(share * 2 * np.log(len(every)), None, np.zeros(0))
    monkeypatch.setattr(law_fit, "maximise_evidence", lambda law, information, pull: weight)
    look = LawScore(every[0], None, 9.0, np.zeros((0, 0)), np.zeros(0))
    assert (look.score(None) < 100.0) == better


@pytest.mark.parametrize(("worse", "chosen"), [(7.0, "rolling_quadratic"), (12.0, "stribeck")])
def test_the_simpler_of_two_may_be_worse_by_nine_and_a_half(worse, chosen):
    known = {
        s.name: frozenset({s})
        for s in list_candidates(Model(), BASE_PARAMETERS)
        if s.name in ("rolling_quadratic", "stribeck")
    }
    cost_of = {known["rolling_quadratic"]: 100 + worse, known["stribeck"]: 100.0}
    assert choose_simplest(Made(cost_of=cost_of.__getitem__), list(cost_of)) == known[chosen]


def flat(chi2, pulls=None, points=200):
    """A fit of clips with this chi^2 a point each; pulls: sigma by which each asks for another shared parameter."""
    names = () if pulls is None else ("restitution",)
    axes = np.linalg.qr(np.random.default_rng(1).standard_normal((points, 3)))[0]
    own, shared, noise = axes[:, :1], axes[:, 1:2], axes[:, 2]
    pulls = [0.0] * len(chi2) if pulls is None else pulls
    left = tuple(np.sqrt(c * points) * noise + p * shared[:, 0] for c, p in zip(chi2, pulls, strict=True))
    every = len(chi2)
    launches = np.zeros((every, 6))
    linearisation = Linearisation(Model(), names, launches, (shared[:, : len(names)],) * every, (own,) * every)
    return ModelFit(Model(), names, launches, left, linearisation)


def numbered(count):
    return [Made(clip=k) for k in range(count)]


@pytest.mark.parametrize(("spreads", "gone"), [(6.0, []), (10.0, [3])])
def test_eight_spreads_make_a_clip_odd(spreads, gone):
    """Spreads of the logarithm of chi^2: a third of the clips lie at either side of the median by a known length."""
    logs = 0.3 * np.tile([-1.0, 0.0, 1.0], 4)
    logs[3] = spreads * 1.4826 * 0.3
    fit = flat(np.exp(logs))
    assert list(find_outlier_clips(numbered(12), fit, fit)) == gone


@pytest.mark.parametrize(("sigma", "gone"), [(4.0, []), (6.0, [5])])
def test_five_sigma_from_all_others_make_a_clip_odd(sigma, gone):
    pulls = np.zeros(12)
    pulls[5] = sigma / np.sqrt(11 / 12)  # of what it says itself, less its own part in all
    fit = flat(np.ones(12), pulls)
    assert list(find_outlier_clips(numbered(12), fit, fit)) == gone


@pytest.mark.parametrize(("bad", "gone"), [(2, 2), (3, 0)])
def test_one_clip_in_ten_may_be_odd(bad, gone):
    fit = flat(np.where(np.arange(20) < bad, 50.0, 1.0))
    assert len(find_outlier_clips(numbered(20), fit, fit)) == gone


@pytest.mark.parametrize(("sigma", "verdict"), [(4.0, "named"), (6.0, "outside_library")])
def test_five_sigma_left_are_something_more(sigma, verdict):
    left, one = [Made(sigma=sigma)], [Made(aliases=("hop",))]
    assert decide_verdict(one, False, left, (), SearchPolicy()) == verdict
    assert decide_verdict((), False, left, (), SearchPolicy()) == ("none" if verdict == "named" else "inadequate")


@pytest.mark.parametrize(("own", "verdict"), [(4.0, "none"), (6.0, "inadequate")])
def test_a_claim_withdrawn_that_chance_may_have_made_is_no_sign_of_more(own, verdict):
    rejected = [Made(sigma=own, is_free_law=False)]
    assert decide_verdict((), False, [], rejected, SearchPolicy()) == verdict
    assert decide_verdict((), False, [], rejected, SearchPolicy(), is_within_noise=True) == "none"


@pytest.mark.parametrize(("own", "verdict"), [(4.0, "named"), (6.0, "outside_library")])
def test_a_free_law_withdrawn_says_that_the_library_does_not_suffice(own, verdict):
    assert (
        decide_verdict([Made(aliases=("hop",))], False, [], [Made(sigma=own, is_free_law=True)], SearchPolicy())
        == verdict
    )


PASSING = HeldOutTest((1.0, 0.9), 9.0, 9.0)


@pytest.mark.parametrize(("sigma", "passes"), [(1.4, True), (0.6, False)])
def test_held_out_clips_may_fall_short_by_two_sigma_of_what_is_promised(sigma, passes):
    expected = None if passes else Rejection.HELD_OUT_WORSE
    assert judge_predictions(HeldOutTest((1.0, 1.01), sigma, 3.0), PASSING) is expected
    assert judge_predictions(HeldOutTest((1.0, 0.99), sigma, 3.0), PASSING) is None  # predicted better, it passes


@pytest.mark.parametrize(("sigma", "passes"), [(2.4, False), (4.0, True)])
def test_all_clips_must_ask_for_a_claim_by_three_sigma(sigma, passes):
    expected = None if passes else Rejection.LEFT_OUT_NOT_SIGNIFICANT
    assert judge_predictions(PASSING, HeldOutTest((1.0, 0.99), sigma, 9.0)) is expected
    assert judge_predictions(PASSING, HeldOutTest((1.0, 1.01), 9.0, 9.0)) is Rejection.LEFT_OUT_WORSE


def selection(**changes):
    return Selection(**{"state": (), "base": None, "best": None} | changes)


HELD_OUT = HeldOutClips((), NOISE, None)


def beside_law(monkeypatch, sigma=30.0, less=500.0, others=(), from_zero=9.0):
    """The test of an effect beside a free law of score 100, 500 without the effect, and the effects claimed."""
    for name in ("refit_without_effect", "leave_one_out_with_law"):
        monkeypatch.setattr(claim_tests, name, lambda *_: Made(score=less))
    monkeypatch.setattr(claim_tests, "find_replacements", lambda *_: others)
    monkeypatch.setattr(HeldOutClips, "fit_with_law", lambda *_: None)
    for name in ("compare_predictions", "_predict_with_law"):
        monkeypatch.setattr(claim_tests, name, lambda *_: (PASSING, PASSING))
    base, whole = Made(model=Model(), names=BASE_PARAMETERS), Made(model=Model(), std={})
    monkeypatch.setattr(claim_tests.Jackknife, "of", lambda *_: Made(distance_from_zero=lambda values: from_zero))
    law = Made(
        score=100.0,
        prior=Made(precision=None),
        model_without_law=Model(),
        joint_fit=whole,
        sigma=30.0,
        law=Made(name="law"),
        significances_of_effects=lambda base: {"rolling_quadratic": sigma},
    )
    library = Made(absorbed=(), evidence=None, required_sigma=4.0, correct_for_trials=lambda effect, sigma: sigma)
    level = SearchPolicy().beside_free_law_sigma
    selected = selection(base=base, free_law=law)
    (test, _), without, claims = claim_tests._test_beside_law(selected, library, HELD_OUT, level)
    return test, without["rolling_quadratic"].free_law, claims[0].aliases


@pytest.mark.parametrize(("sigma", "passes"), [(18.0, False), (24.0, True)])
def test_beside_an_unknown_law_a_name_needs_twenty_sigma(monkeypatch, sigma, passes):
    assert (beside_law(monkeypatch, sigma)[0].rejection is None) is passes


@pytest.mark.parametrize(
    ("score", "aliases", "rejection"),
    [(88.0, 2, Rejection.REPLACED), (92.0, 2, None), (108.0, 2, None), (112.0, 1, None)],
)
def test_beside_an_unknown_law_what_fits_as_well_is_an_alias_and_what_fits_better_by_nine_is_taken(
    monkeypatch, score, aliases, rejection
):
    other = Made(score=score)
    test, without, names = beside_law(monkeypatch, others=[("stribeck", other)])
    assert (test.rejection, len(names)) == (rejection, aliases)
    assert (without is other) is (rejection is Rejection.REPLACED)


def test_an_effect_without_which_all_else_explains_as_much_leaves_nothing_missing(monkeypatch):
    test, _, _ = beside_law(monkeypatch, less=90.0)
    assert test.rejection is Rejection.ABSORBED
    assert test.rejection.leaves_nothing_missing


def claim_alone(
    monkeypatch,
    end=None,
    from_zero=9.0,
    is_stretch=False,
    level=4.2,
    beside=None,
    strength=None,
    aliases=("hop",),
    by_noise=9.0,
):
    """The test of an effect, of which everything else passes; beside: its sigma, beside another effect of 30 sigma."""
    limits = {"shape_at_limit": lambda: end, "strength_at_limit": lambda: strength}
    claims = [Made(sigma=sigma, aliases=aliases, values={}, **limits) for sigma in (beside or 30, 30)]
    claims, names = (claims, ("hop", "bounce")) if beside else (claims[:1], ("hop",))
    distances = {"distance_from_zero": lambda _: from_zero, "distance_from_zero_by_noise": lambda _: by_noise}
    monkeypatch.setattr(claim_tests.Jackknife, "of", lambda *_: Made(**distances))
    monkeypatch.setattr(claim_tests, "describe_claims", lambda *_: claims)
    monkeypatch.setattr(claim_tests, "make_selection", lambda *_: Made(best=None))
    monkeypatch.setattr(claim_tests, "compare_models", lambda *_: (PASSING, PASSING))
    monkeypatch.setattr(claim_tests, "find_strength_variation", lambda *_: Made(rejects=lambda sigma: False))
    selected = selection(state=tuple(Made(name=name, strengths=()) for name in names))
    library = Made(evidence=Made(clips=[Made(is_stretch=is_stretch)]), required_sigma=4.2)
    (test, *_), *_ = claim_tests._test_effects(selected, library, HELD_OUT, level)
    return test


@pytest.mark.parametrize(("end", "passes"), [(None, True), (("hop.bounce", 0.9), False)])
def test_an_effect_whose_shape_is_at_an_end_of_its_range_is_not_claimed(monkeypatch, end, passes):
    test = claim_alone(monkeypatch, end)
    assert (test.rejection, test.shape_at_limit) == (None if passes else Rejection.SHAPE_AT_LIMIT, end)


@pytest.mark.parametrize(("from_zero", "passes"), [(2.4, False), (4.0, True)])
def test_a_size_that_agrees_with_zero_by_its_scatter_is_not_claimed(monkeypatch, from_zero, passes):
    """Of stretches, beside a free law, and where more is missing; else errors from noise are right."""
    expected = None if passes else Rejection.AGREES_WITH_ZERO
    for cases in ({"is_stretch": True}, {"level": 20.0}):
        test = claim_alone(monkeypatch, from_zero=from_zero, **cases)
        assert (test.rejection, test.from_zero) == (expected, from_zero)
    assert claim_alone(monkeypatch, from_zero=from_zero).rejection is None
    assert beside_law(monkeypatch, from_zero=from_zero)[0].rejection is expected


def test_a_weaker_effect_of_stretches_must_differ_from_zero_by_the_level_for_all_candidates(monkeypatch):
    """The stronger one needs 3 sigma by the scatter of the stretches, and so do both in whole collisions."""
    for own_sigma, is_stretch, expected in ((5.0, True, True), (60.0, True, False), (5.0, False, False)):
        test = claim_alone(monkeypatch, from_zero=3.5, is_stretch=is_stretch, level=4.2, beside=own_sigma)
        assert (test.rejection is Rejection.AGREES_WITH_ZERO) is expected
    assert claim_alone(monkeypatch, from_zero=4.4, is_stretch=True, beside=5.0).rejection is None


def test_a_weaker_effect_of_stretches_at_an_end_of_its_range_is_not_claimed(monkeypatch):
    at_end = {"strength": ("hop.bounce", 1.0), "from_zero": np.inf}
    test = claim_alone(monkeypatch, is_stretch=True, beside=5.0, **at_end)
    assert (test.rejection, test.shape_at_limit) == (Rejection.SHAPE_AT_LIMIT, ("hop.bounce", 1.0))
    assert claim_alone(monkeypatch, is_stretch=True, beside=60.0, **at_end).rejection is None


def test_a_weaker_effect_of_stretches_whose_size_agrees_with_zero_by_its_own_error_is_not_claimed(monkeypatch):
    """Such as one of 7 sigma by chi^2 with a size of -0.007(19), with which one ball slips at ten times its speed."""
    of_stretches = {"is_stretch": True, "from_zero": np.inf}
    for by_noise, expected in ((0.4, Rejection.SIZE_UNKNOWN), (4.0, None)):
        assert claim_alone(monkeypatch, beside=5.0, by_noise=by_noise, **of_stretches).rejection is expected
    assert claim_alone(monkeypatch, beside=60.0, by_noise=0.4, **of_stretches).rejection is None
    assert claim_alone(monkeypatch, beside=5.0, by_noise=0.4).rejection is None


def test_no_alias_takes_the_place_of_a_weaker_effect_that_scatters(monkeypatch):
    monkeypatch.setattr(claim_tests, "exchange_effect", lambda *_: Made(best=None))
    for own_sigma, expected in ((5.0, Rejection.AGREES_WITH_ZERO), (60.0, Rejection.REPLACED)):
        test = claim_alone(monkeypatch, from_zero=2.0, is_stretch=True, beside=own_sigma, aliases=("hop", "scale"))
        assert test.rejection is expected


def test_two_aliases_that_fail_the_same_test_do_not_replace_one_another_without_end(monkeypatch):
    """Both have a shape at an end of its range, and each could stand for the other."""
    effects = {name: selection(state=(Made(name=name, strengths=()),), best=None) for name in ("hop", "bounce")}
    nothing, turns = selection(state=(), best=None), []

    def describe(_, state):
        turns.append([effect.name for effect in state])
        assert len(turns) < 9
        return tuple(
            Made(sigma=30.0, aliases=(e.name, *effects.keys() - {e.name}), values={}, shape_at_limit=lambda: ("b", 1.0))
            for e in state
        )

    monkeypatch.setattr(claim_tests, "find_disagreements", lambda *_: (Made(sigma=0.0),))
    monkeypatch.setattr(claim_tests, "describe_claims", describe)
    monkeypatch.setattr(claim_tests, "make_selection", lambda *_: nothing)
    monkeypatch.setattr(claim_tests, "compare_models", lambda *_: (PASSING, PASSING))
    monkeypatch.setattr(claim_tests, "exchange_effect", lambda *arguments: effects[arguments[-1]])
    validated = validate(effects["hop"], LIBRARY, HELD_OUT)
    assert turns == [["hop"], ["bounce"], []]
    assert [(t.name, t.rejection) for t in validated.rejected] == [("bounce", Rejection.SHAPE_AT_LIMIT)]


WORSE = Rejection.HELD_OUT_WORSE
LIBRARY = Made(evidence=Made(clips=()), required_sigma=4.2)


def made_test(name, rejection=None, is_free_law=False, leave_one_out=PASSING):
    return Made(name=name, is_free_law=is_free_law, leave_one_out=leave_one_out, rejection=rejection)


@pytest.mark.parametrize(
    ("law", "free", "left", "levels"),
    [
        (None, False, 4.5, [4.2, 4.2]),
        (None, False, 5.5, [20.0, 20.0]),
        ("law", False, 0.0, [20.0, 4.2]),
        ("law", True, 0.0, [20.0, 20.0]),
    ],
)
def test_twenty_sigma_are_asked_beside_what_is_unknown_and_where_a_law_was_rejected(
    monkeypatch, law, free, left, levels
):
    asked = []
    monkeypatch.setattr(claim_tests, "find_disagreements", lambda *_: (Made(sigma=left),))

    def tests(*arguments):
        selected, level = arguments[0], arguments[3]
        asked.append(level)
        again = len(asked) > 1
        test = made_test("y" if again else "x", None if again else WORSE, free)
        return [test], {"x": dataclasses.replace(selected, free_law=None)}, ()

    for name in ("_test_effects", "_test_beside_law"):
        monkeypatch.setattr(claim_tests, name, tests)
    validated = validate(selection(state=("effect",), free_law=law), LIBRARY, HELD_OUT)
    assert asked == levels
    assert len(validated.rejected) == 1


@pytest.mark.parametrize(
    ("rejection", "rejected"), [(WORSE, ["a"]), (Rejection.ABSORBED, []), (Rejection.REPLACED, [])]
)
def test_what_is_exchanged_or_explained_by_all_else_is_not_rejected(monkeypatch, rejection, rejected):
    validated = validated_of(monkeypatch, iter([[made_test("a", rejection)], []]))
    assert [t.name for t in validated.rejected] == rejected


def test_what_failed_beside_another_and_passes_in_its_place_is_not_rejected(monkeypatch):
    """The one that all else explains as well goes first, though it has more sigma."""
    weak = HeldOutTest((1.0, 0.9), 3.0, 3.0)
    turns = iter(
        [
            [made_test("a", WORSE, leave_one_out=weak), made_test("b", Rejection.ABSORBED)],
            [made_test("a", WORSE, leave_one_out=weak)],
            [made_test("a", leave_one_out=weak)],
        ]
    )
    gone = []
    validated = validated_of(monkeypatch, turns, gone)
    assert gone == ["b", "a"]
    assert validated.rejected == ()


def validated_of(monkeypatch, turns, gone=None):
    """Return what remains of claims that are tested in these turns; `gone` gets the names of those that fail."""

    class Without(dict):
        def __getitem__(self, name):
            if gone is not None:
                gone.append(name)
            return selection(free_law="law")

    monkeypatch.setattr(claim_tests, "_test_beside_law", lambda *_: (next(turns), Without(), ()))
    return validate(selection(free_law="law"), LIBRARY, HELD_OUT)


@pytest.mark.parametrize(("sigma", "told"), [(2.0, False), (4.5, True)])
def test_a_share_is_told_of_a_gap_of_three_sigma(sigma, told):
    whole = GapPhase(1 + sigma * np.sqrt(2 / 5000), 1.0, 1.0, 1.0, 1.0, 1.0)
    assert np.isfinite(closed_share(whole, 5000)) == told


@pytest.mark.parametrize(("times", "told"), [(2.0, True), (4.5, False)])
def test_a_disagreement_far_larger_than_the_residuals_has_no_size(times, told):
    """A push of 5 mm in one frame of one clip, beside terms that take nearly all of it."""
    one, nothing = np.eye(1), np.zeros((1, 0))
    part = ClipAmplitudes(
        pulls=np.array([1e3]),
        per_metre=one * 2e5,
        shared=nothing,
        information=np.zeros((0, 0)),
        pull=np.zeros(0),
        products=one,
        rows=1,
        residual_squares=(5e-3 / times) ** 2,
        features={},
    )
    ((_, _, _, size),) = combine_clips([part])
    assert (size == pytest.approx(5000, rel=1e-3)) if told else np.isnan(size)


@pytest.mark.parametrize(("chi2", "more"), [(1.5, False), (3.0, True)])
def test_twice_the_noise_left_beside_an_effect_that_was_added_is_something_more(chi2, more):
    fits = (Made(chi2=c * 900, points=1000, parameters=100, model=Model()) for c in (9.0, chi2))
    assert ("still lacks something" in AddedEffect(*fits, HOP).sentence()) is more


def test_the_fields_made_here_are_those_of_the_real_ones():
    assert {"score", "fit", "model_without_law", "law"} <= {f.name for f in dataclasses.fields(FittedLaw)}


SOURCE = Path(policy.__file__)
MODULES = sorted(p for p in SOURCE.parent.rglob("*.py") if p != SOURCE)


@pytest.mark.parametrize(("times", "sways", "read"), [(4.0, 3.0, 0.0), (6.0, 3.0, 6.0), (6.0, 0.5, 0.0)])
def test_noise_over_phases_is_held_against_that_of_short_pieces(monkeypatch, times, sways, read):
    """A slow noise of so many times that of the pieces, which is 1; balls sway by so many, which no cubic follows."""
    rng = np.random.default_rng(1)
    sway = sways * np.sin(np.arange(40) / 4)[:, None]
    stretches = [(rng.standard_normal((40, 2)) + sway, np.ones(40), np.arange(40)) for _ in range(30)]
    over_phases = Noise(NoiseComponent(times**2, (0.99,)))
    assert noise._exclude_motion(over_phases, stretches).whole_phase_scale == read


@pytest.mark.parametrize(("times", "kept"), [(1.5, True), (2.2, False)])
def test_a_piece_that_holds_an_event_has_no_part_in_the_noise(times, kept):
    """One piece of eight has so many times the noise of the others, power 2.25 or 4.8 times."""
    rng = np.random.default_rng(2)
    unit = rng.standard_normal((8, 2))
    stretches = [((times if k == 5 else 1.0) * unit, np.ones(8), np.arange(8)) for k in range(8)]
    assert len(noise._cut_pieces(stretches)) == (8 if kept else 7)


def test_a_ball_whose_place_is_given_once_has_no_noise_to_be_read():
    """Ten pieces of a ball that does not move at all, beside four that move."""
    rng = np.random.default_rng(2)
    unit = rng.standard_normal((8, 2))
    still = [(np.full((8, 2), 0.3), np.ones(8), np.arange(8))] * 10
    moving = [(unit, np.ones(8), np.arange(8))] * 4
    assert len(noise._cut_pieces([*still, *moving])) == 4


FIELDS = list(SearchPolicy.model_fields)


def fields_with_docs():
    (policy_class,) = [n for n in ast.parse(SOURCE.read_text()).body if isinstance(n, ast.ClassDef)]
    body = policy_class.body
    return {
        a.target.id: b.value.value for a, b in itertools.pairwise(body) if isinstance(a, ast.AnnAssign) and is_text(b)
    }


def is_text(node):
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def test_each_field_says_where_its_default_comes_from():
    docs, origin = fields_with_docs(), r"Derived|Chosen|A convention|target|blind rounds|As `|A floor"
    assert [name for name in FIELDS if not re.search(origin, docs[name])] == []


def test_each_field_is_used():
    used = {name for path in MODULES for name in re.findall(r"\.(\w+)", path.read_text())}
    assert set(FIELDS) <= used


def test_no_file_reads_the_policy_when_it_is_imported():
    """A default argument, or a number at the top of a file, would not follow a change."""
    readers = {path: text for path in MODULES if "current_policy()" in (text := path.read_text())}
    assert len(readers) > 10
    for path, text in readers.items():
        tree = ast.parse(text)
        inside = [n for f in ast.walk(tree) if isinstance(f, ast.FunctionDef | ast.Lambda) for n in _body(f)]
        late = {id(n) for part in inside for n in ast.walk(part)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "current_policy":
                assert id(node) in late, f"{path}, line {node.lineno}: the policy is read on import"


def _body(function):
    return function.body if isinstance(function.body, list) else [function.body]


def test_a_policy_holds_within_its_block():
    weak = HeldOutTest((1.0, 0.9), 4.0, 4.0)
    assert judge_predictions(PASSING, weak) is None
    with applied_policy(SearchPolicy(leave_one_out_sigma=5.0)):
        assert judge_predictions(PASSING, weak) is Rejection.LEFT_OUT_NOT_SIGNIFICANT
        with suppress(KeyError), applied_policy(SearchPolicy()):
            raise KeyError
        assert current_policy().changed() == {"leave_one_out_sigma": 5.0}
    assert current_policy() == SearchPolicy()


def test_a_policy_cannot_be_changed():
    with pytest.raises(ValueError, match="frozen"):
        SearchPolicy().max_effects = 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("min_claim_sigmas: 5", "min_claim_sigmas: unknown key; did you mean min_claim_sigma?"),
        ("max_effects: 2.5", "max_effects: expected a whole number"),
        ("alias_cosine: 1.5", "alias_cosine: expected a number of 1 or less, found 1.5"),
        ("significance_level: 0", "significance_level: expected a number above 0, found 0"),
        ("min_claim_sigma: .nan", "min_claim_sigma: expected a finite number, found nan"),
        ("min_claim_sigma: '5'", "min_claim_sigma: expected a number, found '5'"),
    ],
)
def test_a_wrong_policy_file_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "policy.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_policy(path)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert "\n" not in str(caught.value)


def test_a_policy_file_sets_what_it_names(tmp_path):
    (tmp_path / "policy.yaml").write_text("significance_level: 1e-4\nmax_effects: 2\n")
    assert read_policy(tmp_path / "policy.yaml") == SearchPolicy(significance_level=1e-4, max_effects=2)


@pytest.mark.parametrize(("chi2", "explained"), [(106.0, True), (119.0, False)])
def test_a_free_law_leaves_only_noise_up_to_a_chi2_per_point_of_1_1(chi2, explained, monkeypatch):
    law = Made(fit=Made(chi2=chi2, points=100))
    monkeypatch.setattr(free_law_contest, "find_better_law", lambda laws, opponent: law)
    assert explains_all(Made(find_missing_effect=lambda law: None), None) == explained
    assert not explains_all(Made(find_missing_effect=lambda law: "hop"), None)
    monkeypatch.setattr(free_law_contest, "find_better_law", lambda laws, opponent: None)
    assert not explains_all(Made(find_missing_effect=lambda law: None), None)
