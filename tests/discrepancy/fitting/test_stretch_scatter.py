"""Scatter from stretch to stretch: the sizes with which stretches were drawn are recovered."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import CAMERA, FPS, STD, WAY, scattering_stretches

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import MEETS_NOTHING
from discrepancy.fitting import stretch_scatter
from discrepancy.fitting.air_scatter import AirScatterFits, ScatterForm
from discrepancy.fitting.base_fit import CLAIMED_NOISE, fit_base_model
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import list_candidates
from discrepancy.fitting.scatter_tails import FREEDOMS, TailLikelihood
from discrepancy.fitting.stretch_moves import AirMoves, ScatterSizes, StretchScatter, add_moves, find_moves
from discrepancy.fitting.stretch_scatter import add_scatter, fit_scatter
from discrepancy.policy import current_policy
from discrepancy.preparation import SearchData
from discrepancy.select.library_fits import LibraryFits
from discrepancy.select.score_test import ScoreTests
from discrepancy.validate.gap import measure_gap
from synthcam.model import Model

COUNT = 6


def draw(scatter=0.0, warp=0.0, same=True):
    cut = scattering_stretches(Model(), COUNT, scatter=scatter, warp=warp, same=same)
    return cut, fit_base_model(cut, Model(), CLAIMED_NOISE)


def test_none_where_nothing_differs():
    assert fit_scatter(*draw(), CLAIMED_NOISE).is_none


def test_a_size_at_the_largest_value_of_the_fit_is_named(monkeypatch):
    """A descent that ends beyond this value; one that ends at a smaller one names nothing."""
    clips, fit = draw(scatter=0.05)
    for growth, named in ((9.0, ("loss_m_s2",)), (6.0, ())):
        monkeypatch.setattr(stretch_scatter, "minimise_cost", lambda *_, end=growth: np.array([0.0, end, -9.0, 0.0]))
        monkeypatch.setattr(stretch_scatter, "finite_cost", lambda *_: -1e9)
        assert fit_scatter(clips, fit, CLAIMED_NOISE).unlimited == named


def test_the_scatter_of_friction_is_found():
    found = fit_scatter(*draw(scatter=0.05), CLAIMED_NOISE)
    assert found.friction == pytest.approx(0.05, rel=0.4)
    assert found.displacement_m < STD


@pytest.mark.parametrize("same", [True, False])
def test_a_smooth_displacement_is_found_and_whether_it_is_a_map(same):
    found = fit_scatter(*draw(warp=3 * STD, same=same), CLAIMED_NOISE)
    assert found.displacement_m == pytest.approx(3 * STD, rel=0.5)
    assert found.reach_m == pytest.approx(WAY, rel=0.5)
    assert found.map_log_ratio > 12 if same else found.map_log_ratio < -3


# --- Bodies on air ---

ON_AIR = Model().replace({"sliding_friction": 0.0, "rolling_decel": 0.02, "rolling_drag": 0.1})
LASTS = 0.05  # s


def glide(seed, along=0.1, across=0.03, power=1, push=(0.0, 0.0), count=24, frames=30, larger=()):
    """Stretches of bodies on air, by integration: losses and accelerations across, at 0.35 m/s, that come and go.

    larger: the accelerations of the first stretches are larger by these factors.
    """
    rng, step, out = np.random.default_rng(seed), 1e-3, []
    times = np.arange(frames) / FPS
    for number in range(count):
        place, speed, heading = rng.uniform(-0.01, 0.01, 2), rng.uniform(0.1, 0.6), rng.uniform(0, 2 * np.pi)
        launch = np.array([*place, 0.0, speed, heading, MEETS_NOTHING])
        velocity, random, path = speed * np.array([np.cos(heading), np.sin(heading)]), rng.standard_normal(2), [place]
        for _ in range(int(times[-1] / step) + 1):
            now = float(np.hypot(*velocity))
            ahead = velocity / now
            factor = larger[number] if number < len(larger) else 1.0
            pushed = factor * random * [along, across] * (now / 0.35) ** power - [0.02 + 0.1 * now, 0.0]
            change = pushed[0] * ahead + pushed[1] * np.array([-ahead[1], ahead[0]]) + push
            place, velocity = place + step * velocity + step**2 / 2 * change, velocity + step * change
            random = random * np.exp(-step / LASTS) + np.sqrt(1 - np.exp(-2 * step / LASTS)) * rng.standard_normal(2)
            path.append(place)
        fine = step * np.arange(len(path))
        xy = np.stack([np.interp(times, fine, axis) for axis in np.array(path).T], axis=-1)
        claimed, frame = np.tile(STD**2 * np.eye(2), (frames, 1, 1)), np.arange(frames)
        xy = xy + STD * rng.standard_normal(xy.shape)
        one = MeasuredCollision(number, "b", CAMERA, frame, frame * 0 + 1, xy, claimed, launch, np.zeros(2))
        out.append(one)
    return out


def fit_with_scatter(clips):
    """The scatter, the clips with it in their covariance, and the fit of the model to them."""
    first = fit_base_model(clips, ON_AIR, CLAIMED_NOISE)
    scatter = fit_scatter(clips, first, CLAIMED_NOISE)
    clips = add_scatter(clips, first, scatter, CLAIMED_NOISE)
    return scatter, clips, fit_base_model(clips, ON_AIR, CLAIMED_NOISE)


@pytest.mark.gate
@pytest.mark.parametrize("power", [0, 2])
def test_accelerations_on_air_are_found_and_how_they_grow_with_the_speed(power):
    found, _, fit = fit_with_scatter(glide(3, power=power))
    size = (found.speed_m_s / 0.35) ** power
    assert found.loss_m_s2 == pytest.approx(0.1 * size, rel=0.3)
    assert found.across_m_s2 == pytest.approx(0.03 * size, rel=0.3)
    assert found.lasts_s == pytest.approx(LASTS, rel=0.5)
    assert found.speed_power == power
    assert not found.freedom
    assert found.displacement_m < STD
    assert fit.chi2 / (fit.points - fit.parameters) == pytest.approx(1, abs=0.1)


def test_short_displacements_hide_no_accelerations_that_last():
    """Displacements of two errors of a position change within a frame or two, as accelerations within a frame do."""
    rng, size, reach, clips = np.random.default_rng(1), 2, 1e-3, glide(3, count=10)
    for k, clip in enumerate(clips):
        kernel = np.exp(-((clip.xy[:, None] - clip.xy) ** 2).sum(axis=-1) / (2 * reach**2))
        root = np.linalg.cholesky(kernel + 1e-9 * np.eye(len(kernel)))
        clips[k] = dataclasses.replace(clip, xy=clip.xy + size * STD * root @ rng.standard_normal(clip.xy.shape))
    found, _, _ = fit_with_scatter(clips)
    assert found.loss_m_s2 == pytest.approx(0.1, rel=0.4)
    assert found.across_m_s2 == pytest.approx(0.03, rel=0.4)
    assert found.lasts_s == pytest.approx(LASTS, rel=0.6)
    assert found.displacement_m == pytest.approx(size * STD, rel=0.3)


@pytest.mark.gate
def test_two_bodies_that_rub_do_not_decide_the_scatter_of_all():
    """Without long tails they make it nearly 4 times as large, and it changes within 21 ms."""
    found, clips, _ = fit_with_scatter(glide(3, count=20, frames=18, larger=(20.0, 40.0)))
    assert found.freedom
    assert found.loss_m_s2 == pytest.approx(0.1, rel=0.6)
    assert found.across_m_s2 == pytest.approx(0.03, rel=0.6)
    assert found.lasts_s == pytest.approx(LASTS, rel=0.5)
    sizes = [np.trace(clip.scatter.reshape(2 * len(clip.xy), -1)) for clip in clips]
    assert sorted(np.argsort(sizes)[-2:]) == [0, 1]


@pytest.mark.gate
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_candidate_is_significant_beside_long_tails(seed):
    """Accelerations drawn from Student's t with 2 degrees of freedom, and no effect."""
    larger = np.sqrt(np.minimum(1 / np.random.default_rng(1000 + seed).gamma(1, 1, 24), 400))
    found, clips, fit = fit_with_scatter(glide(seed, count=24, frames=18, larger=larger))
    assert found.freedom
    clips = add_scatter(clips, fit, found, CLAIMED_NOISE)
    fit = fit_base_model(clips, ON_AIR, CLAIMED_NOISE)
    assert fit.chi2 / (fit.points - fit.parameters) == pytest.approx(1, abs=0.15)
    library = LibraryFits(WhitenedClips.of(clips, CLAIMED_NOISE), fit)
    assert library.score_tests(()).leaders(library.required_sigma)[0].sigma < library.required_sigma


TAILS = StretchScatter(loss_m_s2=0.1, across_m_s2=0.03, lasts_s=LASTS, speed_power=1, speed_m_s=0.35, freedom=2.0)


def test_a_push_that_the_model_lacks_shows_in_held_out_stretches_beside_long_tails():
    """By multiples from their own residuals, chi^2 per point of held-out stretches would be near 1 with any push."""
    clips, gap = tuple(glide(3, count=8, frames=14)), list[float]()
    fit = fit_base_model(clips, ON_AIR, CLAIMED_NOISE)
    for push in (0.0, 1.0, 2.0):  # m/s^2
        held_out = tuple(glide(7, count=6, frames=14, push=(push, 0.0)))
        data = SearchData(clips, held_out, CLAIMED_NOISE, ()).with_scatter(TAILS, fit)
        there = measure_gap(data.held_out, fit, fit, data.noise).before
        gap.append(there.chi2 / there.points)
    assert gap[0] == pytest.approx(1, abs=0.4)
    assert gap[1] > 3 * gap[0]
    assert gap[2] > 2.5 * gap[1]


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_without_tails_accelerations_are_those_of_the_median_stretch(freedom):
    multiples = freedom / np.random.default_rng(1).chisquare(freedom, 200_000)
    plain = dataclasses.replace(TAILS, freedom=freedom).without_tails()
    assert not plain.freedom
    for size, with_tails in ((plain.loss_m_s2, 0.1), (plain.across_m_s2, 0.03)):
        assert size / with_tails == pytest.approx(np.sqrt(np.median(multiples)), rel=0.01)


def fits_of(clips, factor):
    """The fits of the scatter of these clips, from sizes that exceed those of TAILS by a factor."""
    fit = fit_base_model(clips, ON_AIR, CLAIMED_NOISE)
    moves = find_moves(clips, fit.model, fit.launches)
    start = {"loss_m_s2": 0.1 * factor, "across_m_s2": 0.03 * factor, "lasts_s": LASTS}
    sizes = ScatterSizes(start | {"displacement_m": 4 * STD, "reach_m": 1e-3}, 10 * STD, (1e-3, 1e-2), 0.35)
    return AirScatterFits(TailLikelihood.of(clips, fit, CLAIMED_NOISE, moves, range(len(clips))), sizes)


def test_normal_accelerations_have_no_tails_from_sizes_that_are_far_off():
    best = fits_of(glide(3, count=8, frames=14), 5.0).find_best()
    assert not best.form.freedom
    assert not best.form.displaced


def test_a_body_that_rubs_decides_neither_the_form_nor_the_sizes():
    """The scatter that is found is at least as likely as the true one, and is not about the body that rubs."""
    fits = fits_of(glide(3, count=10, frames=14, larger=(60.0,)), 5.0)
    best = fits.find_best()
    assert best.form.freedom
    assert best.cost < fits.tails.cost(TAILS, fits.tails.find_multiples(TAILS)[1])
    assert best.scatter.loss_m_s2 == pytest.approx(0.1, rel=0.7)
    assert best.scatter.across_m_s2 == pytest.approx(0.03, rel=0.7)
    normal = fits.fits[ScatterForm()]
    assert normal.scatter.loss_m_s2 > 5 * best.scatter.loss_m_s2


@pytest.mark.parametrize("k1", [2.0, 3.0])
def test_a_strong_distortion_is_fitted_beside_accelerations_of_each_stretch(k1):
    """At 0.15 m from the middle it moves positions by 27 or 41 mm, where noise has 1.6 um.

    The fit reaches the chi^2 that it has from the true distortion.
    """
    rng, focus, clips = np.random.default_rng(1), CAMERA.K[0, 0] * CAMERA.scale, []
    centre = CAMERA.unproject(CAMERA.K[None, :2, 2])[0][0]
    for clip in glide(3, count=10, frames=45):
        start = rng.uniform(-0.15, 0.15, 2)
        off = clip.xy + start - centre
        bent = centre + off * (1 + k1 * (off**2).sum(axis=1) / focus**2)[:, None]
        clips.append(dataclasses.replace(clip, xy=bent, launch=clip.launch + np.r_[start, np.zeros(4)]))
    first = fit_base_model(clips, ON_AIR, CLAIMED_NOISE)
    scatter = dataclasses.replace(TAILS, freedom=0.0)
    clips = add_moves(clips, find_moves(clips, first.model, first.launches), scatter)
    names, begun = ("rolling_drag", "lens_distortion.k1"), {"lens_distortion.k1": 0.01}
    found = fit_model(clips, first.model.replace(begun), names, CLAIMED_NOISE, first.launches)
    there = fit_model(clips, first.model.replace({"lens_distortion.k1": k1}), (), CLAIMED_NOISE, first.launches)
    best = fit_model(clips, there.model, names, CLAIMED_NOISE, there.launches)
    assert found.chi2 == pytest.approx(best.chi2, abs=0.1)
    assert abs(found.model.value("lens_distortion.k1") - k1) < 2 * found.std["lens_distortion.k1"]


def test_a_free_law_absorbs_no_scatter():
    """A coefficient that could take up all residuals: its prior holds it where the fit of the law left it."""
    clips = glide(3, count=4, frames=14)
    fit, every = fit_base_model(clips, ON_AIR, CLAIMED_NOISE), range(len(clips))
    beside = fit.extend(fit.model, ["law 0"], [r[:, None] for r in fit.residuals])
    moves = find_moves(clips, fit.model, fit.launches)
    tails = StretchScatter(loss_m_s2=0.1, across_m_s2=0.03, lasts_s=LASTS, speed_m_s=0.35, freedom=4.0)
    plain, with_law = (
        TailLikelihood.of(clips, one, CLAIMED_NOISE, moves, every).find_multiples(tails)[0] for one in (fit, beside)
    )
    assert with_law == pytest.approx(plain)


def test_a_lens_of_the_model_displaces_what_accelerations_displace():
    """Positions in a picture that is 1.2 times as large: a body on the plate is pushed as before."""
    clip = glide(3, count=1)[0]
    plain = AirMoves.of(clip, np.tile(np.eye(2), (len(clip.xy), 1, 1)))
    larger = AirMoves.of(dataclasses.replace(clip, xy=1.2 * clip.xy), np.tile(1.2 * np.eye(2), (len(clip.xy), 1, 1)))
    assert larger.speeds == pytest.approx(plain.speeds)
    assert larger.along == pytest.approx(1.2 * plain.along, abs=1e-12)
    assert larger.across == pytest.approx(1.2 * plain.across, abs=1e-12)


def test_nothing_differs_between_bodies_that_lose_speed_alike():
    assert fit_with_scatter(glide(4, along=0.0, across=0.0))[0].is_none


@pytest.mark.gate
def test_half_of_all_tilts_at_their_detection_limit_exceed_it():
    """The limit of a tilt of the plate, from tracks without it, is what a tilt needs in tracks that scatter as much."""
    sigma, wanted = [], current_policy().detection_limit_sigma
    candidate = next(c for c in list_candidates(ON_AIR, ()) if c.name == "plate_tilt")
    for seed in range(10, 13):
        _, clips, fit = fit_with_scatter(glide(seed, count=16, frames=18))
        evidence = WhitenedClips.of(clips, CLAIMED_NOISE)
        (scored,) = ScoreTests.of(evidence, fit, only=[candidate]).ranking()
        own = fit.information(scored.columns)[0][0, 0] ** -0.5
        push = wanted * own * 5 / 7 * ON_AIR.gravity  # a body without friction rolls
        _, clips, fit = fit_with_scatter(glide(seed, push=(push, 0.0), count=16, frames=18))
        columns = ScoreTests.of(WhitenedClips.of(clips, CLAIMED_NOISE), fit, only=[candidate]).ranking()[0].columns
        information, pull = fit.information([c[:, :1] for c in columns])
        sigma.append(pull[0] / information[0, 0] ** 0.5)
    assert np.mean(sigma) == pytest.approx(wanted, abs=3 / np.sqrt(len(sigma)))
