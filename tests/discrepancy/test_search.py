"""The whole search: what is hidden is named, nothing is not, and what nobody's library holds gets no wrong name."""

import dataclasses
from itertools import islice

import numpy as np
import pytest
from discrepancy_clips import (
    CAMERA,
    EXPOSURE,
    FPS,
    FRAMES,
    HIDDEN,
    STD,
    blank,
    collisions,
    exact,
    launches,
    noisy,
    only,
    searched,
)
from discrepancy_outsiders import BEGUN_AGAIN, OUTSIDERS, each_outsider, outsider

from benchmarks.search.sealed.integrator import Plate, collision, means
from discrepancy.add import add
from discrepancy.data.launch import HEADING, X, Y
from discrepancy.data.study_design import split_held_out
from discrepancy.fitting.predict import predict_tracks
from discrepancy.search import search
from discrepancy.select import free_law_contest
from synthcam.library import library
from synthcam.model import Ball, Model
from synthcam_shared.errors import InputError
from tracker.camera.camera import LampSettings

KEYS = {"verdict", "named", "aliases", "outside", "where", "ranking", "gap", "experiment"}


def integrated(model, tilt, count, seed):
    """Collisions on a tilted plate with white noise, from an integrator that shares no code with synthcam's motion."""
    rng, clips, frames = np.random.default_rng(seed), [], 60
    names = ("gravity", "restitution", "sliding_friction", "spin_transfer", "rolling_drag", "rolling_decel")
    numbers = {n: getattr(model, n) for n in names} | {"diameter": 2 * model.ball.radius, "density": 7800.0}
    plate = Plate(numbers | {"plate_tilt.x": tilt[0], "plate_tilt.y": tilt[1]})
    for number, launch in enumerate(launches(rng, count)):
        paths = collision(plate, launch, False, frames / FPS)
        clip = blank(number, launch, np.array([pieces[1][1] for pieces in paths]), frames)
        xy = means(paths, np.arange(frames) / FPS, EXPOSURE)[clip.ball, clip.frame]
        clips.append(dataclasses.replace(clip, xy=xy + STD * rng.standard_normal(xy.shape)))
    return clips


def names(found):
    return [n.effect for n in found.named]


def within(found, truth, times=3.5):
    """Every named strength is the hidden one to within so many standard deviations, and those are small."""
    for n in found.named:
        for key, value in n.values.items():
            assert abs(value - truth[key]) < times * n.std[key]
            assert n.std[key] < 0.2 * max(abs(v) for v in truth.values())


@pytest.mark.parametrize("hidden", ["velocity_restitution", pytest.param("rolling_quadratic", marks=pytest.mark.gate)])
def test_a_hidden_effect_is_named_with_its_strength(hidden):
    found = searched(hidden)
    assert found.verdict == "named"
    assert names(found) == [hidden]
    within(found, HIDDEN[hidden])
    assert found.model.value(next(iter(HIDDEN[hidden]))) == next(iter(found.named[0].values.values()))


SPUN = [[0.05, -0.06, 0.1], [0.0, 0.0, 0.08], [-0.08, 0.03, -0.05], [0.0, 0.0, 0.0]]  # slide, spin, slide, roll


@pytest.mark.parametrize("strength", [0.0, 0.05])
def test_strikers_that_slide_or_spin_hide_nothing_and_are_nothing(monkeypatch, strength):
    """Each has a spin of its own, that is fitted; without it the hits of the same balls fit nothing."""
    only(monkeypatch)
    clips = noisy(exact(Model().replace({"velocity_restitution.e": strength}), 6, 3, spins=SPUN), 3)
    stages = set()
    found = search(clips, Model(), stages.add)
    assert found.verdict == ("named" if strength else "none")
    assert stages & {"free laws", "only free laws"} == {"free laws" if strength else "only free laws"}
    assert [n.effect for n in found.named] == ["velocity_restitution"] * bool(strength)
    for clip, launch in zip(found.data.clips, found.best_fit.launches, strict=True):
        assert launch[6:] == pytest.approx(SPUN[clip.clip % 4], abs=3e-4)
    if strength:
        within(found, {"velocity_restitution.e": strength})


@pytest.mark.gate
def test_a_tilt_hidden_by_another_integrator_is_named(monkeypatch):
    known = ("plate_tilt", "velocity_restitution", "friction_anisotropy", "camera_tilt")
    only(monkeypatch, ("force_place", "friction_heading"), **{name: library()[name] for name in known})
    found = search(integrated(Model(), np.array([8e-4, -5e-4]), 6, 21), Model())
    assert found.verdict == "named"
    assert names(found) == ["plate_tilt"]
    within(found, {"plate_tilt.x": 8e-4, "plate_tilt.y": -5e-4})
    best = found.best_fit
    assert abs(best.chi2 / (best.points - best.parameters) - 1) < 0.15


@pytest.mark.parametrize("rho", [0.0, pytest.param(0.9, marks=pytest.mark.gate)])
def test_nothing_hidden_is_nothing_found(rho):
    found = searched("nothing", rho)
    assert found.verdict == "none"
    assert names(found) == []
    assert found.model.effects == ()
    assert found.data.noise.correlation == pytest.approx(rho, abs=0.1)


@pytest.mark.parametrize("hidden", ["nothing", "velocity_restitution"])
def test_the_document_has_every_key(hidden):
    document = searched(hidden).document()
    assert document.keys() >= KEYS
    assert document["gap"].keys() >= {"before", "after", "floor", "closure", "before_um", "after_um", "floor_um"}
    assert {r["effect"] for r in document["ranking"]} == set(library())
    assert all(n.keys() >= {"effect", "parameters", "std", "sigma"} for n in document["named"])


@pytest.mark.gate
def test_two_hidden_effects_are_both_named_with_the_strengths_of_the_last_fit(monkeypatch):
    only(monkeypatch)
    truth = HIDDEN["velocity_restitution"] | {"rolling_quadratic.K": 0.3}
    found = search(collisions(Model().replace(truth), 6, 3), Model())
    assert found.verdict == "named"
    assert sorted(names(found)) == ["rolling_quadratic", "velocity_restitution"]
    within(found, truth)
    assert all(found.model.value(k) == v for n in found.named for k, v in n.values.items())


@pytest.mark.gate
def test_the_library_is_asked_again_for_what_stands_in_place_of_a_free_law(monkeypatch):
    """Its own search stopped too early here; the free law is then no effect that it lacks."""
    only(monkeypatch)
    truth = {"velocity_restitution.e": 0.05, "rolling_quadratic.K": 0.3}
    begin, go_on, again = free_law_contest.iterate_models, free_law_contest.search_from, []

    def counted(*words):
        again.append(go_on(*words))
        return again[-1]

    monkeypatch.setattr(free_law_contest, "iterate_models", lambda library: islice(begin(library), 1))
    monkeypatch.setattr(free_law_contest, "search_from", counted)
    found = search(collisions(Model().replace(truth), 6, 3), Model())
    assert found.verdict == "named"
    assert sorted(names(found)) == ["rolling_quadratic", "velocity_restitution"]
    within(found, truth)
    assert any(again)  # it is this search that found them


@pytest.mark.gate
def test_an_effect_that_needs_friction_may_be_an_alias_in_a_textbook_collision(monkeypatch):
    known = ("stribeck", "viscous_friction")
    only(monkeypatch, ("friction_speed",), **{n: library()[n] for n in known})
    clips = collisions(Model().replace({"stribeck.rise": 0.004, "stribeck.slip": 0.3}), 6, 4)
    found = search(clips, Model(sliding_friction=0.0))
    assert "sliding_friction" in names(found)
    assert found.verdict == "ambiguous"
    assert "stribeck" in found.experiment


@pytest.mark.gate
@pytest.mark.parametrize(
    ("hidden", "bent"),
    [
        ({"stribeck.rise": 0.03}, ("friction_speed", "friction_heading")),
        ({"plate_tilt.x": 1e-3}, ("force_place", "force_velocity")),
    ],
)
def test_what_the_library_holds_is_not_called_outside_it(monkeypatch, hidden, bent):
    """Friction with a shape of its own, or one strength of two, which a free law could bend to."""
    known = ("velocity_restitution", "stribeck", "friction_anisotropy", "plate_tilt")
    only(monkeypatch, bent, **{name: library()[name] for name in known})
    found = search(collisions(Model().replace(hidden), 6, 4), Model())
    assert found.free_law is None
    assert found.verdict == "named"
    assert set(names(found)) == {k.partition(".")[0] for k in hidden}


@each_outsider
def test_an_effect_outside_the_library_gets_its_free_law_and_no_name(law):
    found = outsider(law)
    assert found.verdict == "outside_library"
    assert names(found) == []
    assert [e.name() for e in found.model.effects] == [found.free_law.law.name] == [law]
    assert found.scores[0].sigma > found.required_sigma  # the nearest of the library would have been claimed
    gap, points = found.gap, found.gap_fits.after.points
    chance = 4 * np.sqrt(2 / points) / (gap.before - gap.floor)  # in chi^2 a point of so few clips kept out
    assert gap.closure > (0.7 if law == "friction_place" else 0.95) - chance  # other clips see other places of a map
    assert chance < 0.2


def test_no_search_begins_again_where_a_free_law_leaves_only_noise():
    """Without the law chi^2 per point is over 2, which makes a search begin again from other effects."""
    found = outsider("restitution_speed")
    assert found.base_fit.chi2 / found.base_fit.points > found.policy.poor_chi2_per_point
    assert "restitution_speed" not in BEGUN_AGAIN


@each_outsider
def test_its_curve_is_the_truth_within_the_band(law):
    """At nine of ten places; and the band is no cloak, but narrower than the change it shows."""
    said = outsider(law).document()["outside"][0]
    x, low, high = np.array(said["x"]), *np.array(said["band"]).T
    true = OUTSIDERS[law]._law(*(x.T if x.ndim == 2 else (x,)))
    assert np.mean((true > low) & (true < high)) >= 0.9
    assert np.median(high - low) < 0.5 * np.ptp(true)


def test_the_document_tells_the_free_law():
    said = outsider("restitution_speed").document()["outside"]
    assert len(said) == 1
    assert said[0].keys() >= {"slot", "x", "curve", "band", "band68", "formula", "unit", "axes", "sigma"}
    assert len(said[0]["x"]) == len(said[0]["curve"]) == len(said[0]["band"]) == len(said[0]["band68"])
    assert "restitution" not in [n["effect"] for n in outsider("restitution_speed").document()["named"]]


class Twin(library()["velocity_restitution"]):
    """The same law under another name: nothing can tell the two apart."""

    @classmethod
    def name(cls):
        return "twin"


def test_exact_aliases_are_reported_as_a_class(monkeypatch):
    effect = library()["velocity_restitution"]
    Twin.laws = effect.laws
    only(monkeypatch, ("restitution_speed",), velocity_restitution=effect, twin=Twin)
    found = search(collisions(Model().replace({"velocity_restitution.e": 0.02}), 6, 4), Model())
    assert found.verdict == "ambiguous"
    assert len(found.named) == 1
    assert [set(a) for a in found.document()["aliases"]] == [{"twin", "velocity_restitution"}]
    assert found.document()["experiment"]


@pytest.mark.gate
def test_the_order_of_the_clips_does_not_matter(monkeypatch):
    only(monkeypatch)
    clips = collisions(Model().replace(HIDDEN["velocity_restitution"]), 6, 3)
    one, other = (search(c, Model()).document() for c in (clips, clips[::-1]))
    assert one["verdict"] == other["verdict"] == "named"
    assert one["named"][0]["parameters"] == pytest.approx(other["named"][0]["parameters"], rel=1e-4)
    for gap in (one["gap"], other["gap"]):
        gap.pop("by_phase")
        gap.pop("by_claim")
    assert one["gap"] == pytest.approx(other["gap"], rel=1e-4)


@pytest.mark.parametrize("truth", [0.05, pytest.param(0.0, marks=pytest.mark.gate)])
def test_an_effect_in_the_model_with_a_wrong_strength_is_named_again(monkeypatch, truth):
    only(monkeypatch)
    wrong = Model().replace({"velocity_restitution.e": 0.03})
    found = search(collisions(Model().replace({"velocity_restitution.e": truth}), 8, 3), wrong)
    assert found.verdict == "named"
    (named,) = found.named
    assert named.effect == "velocity_restitution"
    assert abs(named.values["velocity_restitution.e"] - truth) < 3.5 * 2.4e-4
    assert named.std["velocity_restitution.e"] == pytest.approx(2.3e-4, rel=0.1)
    assert found.sentence().startswith("Wrong value: velocity_restitution.e is ")
    assert ", not 0.03," in found.sentence()
    assert "Missing" not in found.sentence()


def test_a_model_without_rolling_loss_is_searched_too(monkeypatch):
    only(monkeypatch)
    slippery = Model().replace({"rolling_decel": 0.0})
    assert search(collisions(slippery, 6, 5), slippery).verdict == "none"


def test_too_few_collisions():
    with pytest.raises(InputError, match="5 measured collisions: expected 6"):
        search(collisions(Model(), 5, 6), Model())


def test_clips_too_short_to_read_noise_from():
    clips = collisions(Model(), 6, 7)
    every = [c.frame % 8 == 0 for c in clips]
    cut = [
        dataclasses.replace(c, frame=c.frame[e], ball=c.ball[e], xy=c.xy[e], covariance=c.covariance[e])
        for c, e in zip(clips, every, strict=True)
    ]
    with pytest.raises(InputError, match="too few consecutive frames to estimate the noise"):
        search(cut, Model())


def one_way(clip):
    """The collision turned until the striker goes along x."""
    c, s = np.cos(clip.launch[HEADING]), np.sin(clip.launch[HEADING])
    back = np.array([[c, s], [-s, c]])
    launch = clip.launch.copy()
    launch[[X, Y]], launch[HEADING] = back @ launch[[X, Y]], 0.0
    return dataclasses.replace(clip, xy=clip.xy @ back.T, launch=launch)


def test_clips_all_alike_are_said(monkeypatch):
    only(monkeypatch)
    found = search([one_way(c) for c in collisions(Model(), 6, 5)], Model())
    assert found.verdict == "none"
    assert [line.partition(":")[0] for line in found.document()["alike"]] == ["all clips go one way"]


def test_a_bad_recording_does_not_spoil_the_gap(monkeypatch):
    """One clip of those kept out has noise ten times as large."""
    only(monkeypatch)
    clips = collisions(Model(), 12, 3)
    bad = split_held_out(clips)[1][1].clip
    rough = STD * 10 * np.random.default_rng(1).standard_normal(clips[bad].xy.shape)
    clips[bad] = dataclasses.replace(clips[bad], xy=clips[bad].xy + rough)
    found = search(clips, Model())
    assert bad not in [c.clip for c in found.data.held_out]
    assert [note.clip for note in found.data.left_out] == [bad]
    assert [line.partition(":")[0] for line in found.document()["clips"]["left_out"]] == [f"clip {bad}"]
    assert found.gap.before == pytest.approx(found.gap.floor, rel=0.15)


def test_a_model_without_a_motion_is_refused():
    steep = Model().replace({"plate_tilt.x": 5e-3})
    with pytest.raises(InputError, match="no motion for these collisions"):
        search(collisions(Model(), 6, 5), steep)


def test_an_added_effect_gets_its_shape(monkeypatch):
    only(monkeypatch, stribeck=library()["stribeck"])
    truth = {"stribeck.rise": 0.1, "stribeck.slip": 0.2}
    new = add(collisions(Model().replace(truth), 6, 4), Model(), "stribeck")
    assert {k: new.fit.model.value(k) for k in truth} == pytest.approx(truth, rel=0.1)
    for key, std in (new.named.std | new.named.shape_std).items():
        assert abs(new.fit.model.value(key) - truth[key]) < 3.5 * std
    assert new.named.sigma > 20
    assert new.chi2[0] > 1.2
    assert new.chi2[1] == pytest.approx(1, abs=0.1)


def test_what_cannot_be_told_is_not_added(monkeypatch):
    only(monkeypatch, clock_error=library()["clock_error"])
    clips = collisions(Model(), 6, 4)
    with pytest.raises(InputError, match="clock_error: not identifiable from these collisions"):
        add(clips, Model(), "clock_error")
    with pytest.raises(InputError, match="5 measured collisions: expected 6"):
        add(clips[:5], Model(), "clock_error")


class Narrow(library()["velocity_restitution"]):
    """The same law, its strength allowed in a narrow range only."""

    @classmethod
    def name(cls):
        return "velocity_restitution"

    @classmethod
    def parameters(cls):
        return tuple(dataclasses.replace(p, low=-0.02, high=0.02) for p in super().parameters())


def test_a_strength_at_its_limit_has_no_error(monkeypatch):
    clips, found = collisions(Model().replace(HIDDEN["velocity_restitution"]), 6, 3), searched("velocity_restitution")
    Narrow.laws = library()["velocity_restitution"].laws
    only(monkeypatch, velocity_restitution=Narrow)
    new = add(clips, Model(), "velocity_restitution")
    assert "e +0.02 at its limit (" in new.sentence()
    assert new.document()["std"] == {"e": None}
    named = dataclasses.replace(found, claims=(new.named,))
    (said,) = named.document()["named"]
    assert said["std"] == {"velocity_restitution.e": None}
    assert said["at_limit"] == ["velocity_restitution.e"]
    assert "e +0.02 at its limit (" in named.sentence()
    assert found.document()["named"][0]["at_limit"] == []


@pytest.mark.parametrize("wide", ["camera", "model"])
def test_a_camera_and_a_model_of_different_balls_are_refused(wide):
    clips, model, sizes = collisions(Model(), 6, 5), Model(), ("2.38", "2.5")
    if wide == "camera":
        camera = dataclasses.replace(clips[0].camera, ball_diameter=2.5e-3)
        clips[-1], sizes = dataclasses.replace(clips[-1], camera=camera), sizes[::-1]
    else:
        model = dataclasses.replace(model, ball=Ball(diameter=2.5e-3))
    for asked in (lambda: search(clips, model), lambda: add(clips, model, "hop")):
        with pytest.raises(InputError, match=r"camera.json is {} mm wide .*, that of the model {} mm".format(*sizes)):
            asked()


MOVED = dataclasses.replace(CAMERA, lamp=LampSettings((0.05, 0.01, 0.45), 0.01))
WIDER = dataclasses.replace(CAMERA, K=CAMERA.K * [[1.01, 1, 1], [1, 1.01, 1], [1, 1, 1]])


@pytest.mark.parametrize(("key", "camera"), [("lamp", MOVED), ("K", WIDER)])
def test_clips_of_two_cameras_are_refused(key, camera):
    clips = collisions(Model(), 6, 5)
    clips[4] = dataclasses.replace(clips[4], camera=camera)
    for asked in (lambda: search(clips, Model()), lambda: add(clips, Model(), "hop")):
        with pytest.raises(InputError, match=f"camera.json: {key} of clip 4 is not that of clip 0; expected clips of"):
            asked()


def test_what_is_measured_anew_of_each_clip_makes_no_other_camera(monkeypatch):
    only(monkeypatch)
    clips = collisions(Model(), 6, 5)
    anew = {"psf_sigma": 1.3, "sensor": dataclasses.replace(CAMERA.sensor, gain=3.0), "exposure_from_blur": 6e-4}
    clips[4] = dataclasses.replace(clips[4], camera=dataclasses.replace(CAMERA, **anew))
    assert search(clips, Model()).verdict == "none"


def test_what_is_kept_out_has_no_part_in_the_noise(monkeypatch):
    only(monkeypatch)
    clips = collisions(Model(), 8, 3)
    found, kept_out = search(clips, Model()), {c.clip for c in split_held_out(clips)[1]}
    rng = np.random.default_rng(1)
    rough = [
        dataclasses.replace(c, xy=c.xy + 3 * STD * rng.standard_normal(c.xy.shape) * (c.clip in kept_out))
        for c in clips
    ]
    again = search(rough, Model())
    assert again.gap_fits.before.chi2 > 5 * found.gap_fits.before.chi2
    assert again.data.noise == found.data.noise
    assert again.base_fit.chi2 == found.base_fit.chi2


def test_it_is_counted_how_many_clips_are_gone(monkeypatch):
    only(monkeypatch)
    asked = []

    def first(clips, base, best, gone=0, **_):
        asked.append((len(clips), gone))
        return {0: "one"} if (len(clips), gone) == (6, 0) else {}

    monkeypatch.setattr("discrepancy.search.find_outlier_clips", first)
    assert search(collisions(Model(), 8, 3), Model()).data.left_out == ("one",)
    assert asked[:2] == [(6, 0), (5, 1)]


@pytest.mark.parametrize(
    ("after", "said"),
    [(0.9, "falls from 1 to 0.9"), (0.9999, "stays at 1"), (1.2, "does not fall but rises from 1 to 1.2")],
)
def test_how_the_gap_goes_is_said_as_it_is(after, said):
    found = searched("velocity_restitution")
    gap = dataclasses.replace(found.gap, before=1.0, after=after)
    moved = dataclasses.replace(found, gap_fits=dataclasses.replace(found.gap_fits, gap=gap))
    assert f"On held-out collisions chi^2 per point {said}" in moved.sentence()


@pytest.mark.gate
def test_clips_of_two_frame_rates_are_searched_together(monkeypatch):
    only(monkeypatch)
    true = Model().replace({"rolling_quadratic.K": 0.2})
    clips = exact(true, 12, 4)
    slow = dataclasses.replace(clips[0].camera, fps=125.0, exposure=1e-3)
    for k in range(0, len(clips), 2):
        frame = np.tile(np.arange(FRAMES // 2), 2)
        half = dataclasses.replace(clips[k].select(np.flatnonzero(clips[k].frame % 2 == 0)), camera=slow, frame=frame)
        clips[k] = dataclasses.replace(half, xy=predict_tracks(true, half.launch[None], [half])[0])
    found = search(noisy(clips, 4), Model())
    assert (found.verdict, found.named[0].effect) == ("named", "rolling_quadratic")
    value, std = (d["rolling_quadratic.K"] for d in (found.named[0].values, found.named[0].std))
    assert abs(value - 0.2) < 3 * std
    assert found.gap.after < 1.2


@pytest.mark.gate
def test_noise_that_motion_fills_is_read_from_short_pieces_and_it_is_said(monkeypatch):
    """Balls roll where they are said to slide, and each clip sways in its own way: what is missing is no noise."""
    only(monkeypatch, ("restitution_speed",))  # no rolling law: its fit to such a motion takes a minute
    rng, clips = np.random.default_rng(5), []
    for clip in collisions(Model(), 8, 3):
        sway = 300 * STD * np.sin(clip.frame / 20 + rng.uniform(0, 2 * np.pi))[:, None] * rng.standard_normal(2)
        clips.append(dataclasses.replace(clip, xy=clip.xy + sway, slide_ends=clip.slide_ends + 0.1))
    found = search(clips, Model())
    assert found.verdict == "inadequate"
    noise = found.document()["noise"]
    assert noise["scale"] == pytest.approx(1, rel=0.2)
    assert noise["over_phases"] > 10
    said = f"Over whole phases of motion it would be {noise['over_phases']:.3g} times; that is missing physics"
    assert said in found.sentence()
