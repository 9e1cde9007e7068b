"""Free laws: laws left free. Their derivatives against the forward model itself, and ranges against the data's."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import exact
from discrepancy_laws import with_constant

from discrepancy.data.launch import V0, B
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.law_kinds import ImpactLaw, MotionLaw
from discrepancy.free_laws.library import free_laws_over
from discrepancy.free_laws.ranges import Axis
from synthcam.library import library
from synthcam.model import Model
from synthcam_shared.errors import PluginError

CLIPS = exact(Model(), 5, 11)
LAUNCHES = np.array([c.launch for c in CLIPS])
LAWS = {s.name: s for s in free_laws_over(Model(), LAUNCHES, CLIPS)}
STEP = {"rolling": 3e-4, "measure": 1e-2}  # of the others 1e-3
BENT = [name for name, law in LAWS.items() if law.bends]


def moved(model, clips=CLIPS):
    return np.concatenate(predict_tracks(model, LAUNCHES, clips))


@pytest.mark.parametrize("name", BENT)
def test_derivatives_are_those_of_the_forward_model(name):
    law, rng = LAWS[name], np.random.default_rng(1)
    step = STEP.get(LAWS[name].bends[0], 1e-3)
    told = np.concatenate(law.derivatives(Model(), LAUNCHES, CLIPS))
    for _ in range(2):
        way = rng.standard_normal(law.size) / np.sqrt(law.size)
        ahead, behind = (moved(law.add_to(Model(), sign * step * way)) for sign in (1, -1))
        true = (ahead - behind) / (2 * step)
        assert np.linalg.norm(told @ way - true) < 0.02 * np.linalg.norm(true)


@pytest.mark.parametrize("name", ["friction_speed", "friction_heading", "rolling_speed", "force_speed", "force_place"])
def test_strikers_that_slide_are_moved_by_the_law_of_slides(name):
    rng = np.random.default_rng(2)
    spins = [[0.1, -0.1, 0.2], [-0.15, 0.05, 0.0], [0.0, 0.0, 0.3], [0.0, 0.0, 0.0]]
    places = np.concatenate([LAUNCHES, np.resize(spins, (len(LAUNCHES), 3))], axis=1)
    (law,) = (s for s in free_laws_over(Model(), places, CLIPS) if s.name == name)
    step, way = STEP.get(law.bends[0], 1e-3), rng.standard_normal(law.size) / np.sqrt(law.size)
    told = np.concatenate(law.derivatives(Model(), places, CLIPS)) @ way
    ahead, behind = (
        np.concatenate(predict_tracks(law.add_to(Model(), sign * step * way), places, CLIPS)) for sign in (1, -1)
    )
    true = (ahead - behind) / (2 * step)
    assert np.linalg.norm(told - true) < 0.02 * np.linalg.norm(true)


def test_an_empty_free_law_changes_nothing():
    for name in BENT:
        bent = LAWS[name].add_to(Model(), np.zeros(LAWS[name].size))
        assert np.array_equal(moved(bent), moved(Model()))


def test_a_filled_free_law_replaces_an_earlier_one():
    law = LAWS["restitution_speed"]
    one, other = np.eye(law.size)[:2] * 1e-3
    twice = law.add_to(law.add_to(Model(), one), other)
    assert len(twice.effects) == 1
    assert np.array_equal(moved(twice), moved(law.add_to(Model(), other)))


def test_free_laws_are_no_effects():
    assert not [e for e in library() if e in ("series", *LAWS)]


@pytest.mark.parametrize(
    ("kind", "given", "message"),
    [
        (MotionLaw, {}, r"no bends; expected a law, as bends=\("),
        (ImpactLaw, {"at_impact": abs}, "expected one base parameter, as owners="),
        (MotionLaw, {"bends": ("fiction", "slip_speed")}, "bends 'fiction'; expected one of mass, "),
        (MotionLaw, {"bends": ("rolling", "slip_speed")}, "by 'slip_speed'; rolling depends on speed, "),
    ],
)
def test_a_law_that_lacks_something_is_named(kind, given, message):
    with pytest.raises(PluginError, match=rf"^free law my_law: .*{message}"):
        kind("my_law", "A law of mine", "mu", over=lambda covered: (), **given)


def test_a_curve_over_a_vector_is_one_over_its_length():
    speed = Axis("speed", "m/s", 0.0, 1.0, 9)
    law = MotionLaw("my_law", "", "mu", bends=("rolling", "velocity"), over=lambda covered: (speed,), axes=(speed,))
    assert law.coordinates(np.array([[0.3, 0.4]]))[0] == pytest.approx([0.5])


def test_ranges_are_those_of_the_data():
    normal = LAUNCHES[:, V0] * np.sqrt(1 - LAUNCHES[:, B] ** 2)
    axis = LAWS["restitution_speed"].axes[0]
    assert (axis.low, axis.high) == pytest.approx((normal.min(), normal.max()))
    base = Model()  # the target leaves with v = (1 + r)/2 v_n and a backspin of C v0
    fastest = (LAUNCHES[:, V0] * ((1 + base.restitution) / 2 + base.spin_transfer)).max()
    assert LAWS["friction_speed"].axes[0].high == pytest.approx(fastest, rel=0.03)
    ends = np.concatenate([c.xy[c.frame == c.frame.max()] for c in CLIPS])
    x, y = LAWS["force_place"].axes
    assert np.all((ends[:, 0] > x.low - 1e-3) & (ends[:, 0] < x.high + 1e-3))
    assert np.all((ends[:, 1] > y.low - 1e-3) & (ends[:, 1] < y.high + 1e-3))
    assert LAWS["warp_place"].axes[0].unit == "px"


def test_a_warp_is_looked_for_where_balls_were_seen():
    """Their motion goes on where no camera looks."""
    near = [np.abs(c.xy[:, 0]) < 5e-3 for c in CLIPS]
    cut = [
        dataclasses.replace(c, frame=c.frame[k], ball=c.ball[k], xy=c.xy[k], covariance=c.covariance[k])
        for c, k in zip(CLIPS, near, strict=True)
    ]
    x, _ = next(s for s in free_laws_over(Model(), LAUNCHES, cut) if s.name == "warp_place").axes
    xy = np.concatenate([c.xy for c in cut])
    seen = cut[0].camera.project(np.concatenate([xy, np.full((len(xy), 1), cut[0].camera.radius)], axis=1))[:, 0]
    assert (x.low, x.high) == (pytest.approx(seen.min()), pytest.approx(seen.max()))


def test_a_picture_that_lags_is_a_later_contact():
    law, late = with_constant(LAWS["lag_speed"]), 1e-4
    coefs = late * (np.arange(law.size) == 0)  # the first cosine is a constant
    cleaned = law.subtract_from(CLIPS, Model(), LAUNCHES, coefs)
    shift = np.concatenate([c.xy - d.xy for c, d in zip(CLIPS, cleaned, strict=True)])
    later = LAUNCHES + late * (np.arange(6) == 2)
    true = np.concatenate(predict_tracks(Model(), later, CLIPS)) - moved(Model())
    assert np.linalg.norm(shift - true) < 0.02 * np.linalg.norm(true)


@pytest.mark.parametrize("name", ["lag_speed", "warp_place"])
def test_a_law_whose_constant_means_nothing_has_none(name):
    law, one = LAWS[name], LAWS[name].size // LAWS[name].parts
    places = np.stack([p.ravel() for p in np.meshgrid(*(a.grid(200) for a in law.axes))])
    coefs = np.random.default_rng(1).standard_normal(law.size)
    assert np.abs(law.values(coefs, *places).mean(axis=0)).max() < 1e-12
    assert not law.values(1.0 * (np.arange(law.size) % one == 0), *places).any()  # the first cosine is a constant
    parts = [law.basis(*places[:, :9]) @ part for part in coefs.reshape(law.parts, -1)]
    assert law.values(coefs, *places[:, :9]) == pytest.approx(np.squeeze(np.stack(parts, axis=-1)))


@pytest.mark.parametrize("name", ["restitution_clip", "spin_transfer_clip"])
def test_a_number_of_each_clip_moves_that_clip(name):
    law = LAWS[name]
    coefs = 1e-3 * np.arange(5)
    cleaned = law.subtract_from(CLIPS, Model(), LAUNCHES, coefs)
    linear = law.derivatives(Model(), LAUNCHES, CLIPS)
    owner = law.owners[0][0]
    for k, (clip, rest) in enumerate(zip(CLIPS, cleaned, strict=True)):
        own = Model().replace({owner: Model().value(owner) + coefs[k]})
        true = (
            predict_tracks(own, LAUNCHES[k : k + 1], [clip])[0]
            - predict_tracks(Model(), LAUNCHES[k : k + 1], [clip])[0]
        )
        assert np.abs(clip.xy - rest.xy - true).max() < 1e-12
        assert np.linalg.norm(linear[k] @ coefs - true) <= 0.02 * np.linalg.norm(true)


def test_what_an_effect_can_hold_is_not_undone():
    law = LAWS["force_speed"]
    assert law.subtract_from(CLIPS, Model(), LAUNCHES, np.ones(law.size)) == CLIPS


def test_curves_of_an_angle_close():
    axis = Axis("heading", "rad", -np.pi, np.pi, 9, "circle")
    assert axis.basis(np.pi) == pytest.approx(axis.basis(-np.pi))
    th = np.linspace(-np.pi, np.pi, 50)
    wanted = 0.3 + np.cos(3 * th + 0.4)  # sines and cosines up to the fourth hold it exactly
    coefs = np.linalg.lstsq(axis.basis(th), wanted, rcond=None)[0]
    assert axis.basis(th) @ coefs == pytest.approx(wanted, abs=1e-12)


def test_smooth_curves_fit_well_and_values_are_sums_of_the_basis():
    axis = Axis("speed", "m/s", 0.1, 0.6, 20)
    v = np.linspace(0.1, 0.6, 200)
    coefs = np.linalg.lstsq(axis.basis(v), np.sqrt(v), rcond=None)[0]
    assert np.abs(axis.basis(v) @ coefs - np.sqrt(v)).max() < 1e-4
    place = Axis("x", "m", -0.02, 0.02, 4)
    field = dataclasses.replace(LAWS["force_place"], axes=(place, dataclasses.replace(place, name="y")))
    rng = np.random.default_rng(2)
    coefs, x, y = rng.standard_normal(field.size), *rng.uniform(-0.02, 0.02, (2, 7))
    by_hand = np.stack([field.basis(x, y) @ part for part in coefs.reshape(2, -1)], axis=-1)
    assert field.values(coefs, x, y) == pytest.approx(by_hand)
