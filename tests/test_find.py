"""The whole search: what is hidden is named, nothing is not, and what nobody's library holds gets no wrong name."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from discrepancy.find import find
from discrepancy_clips import EXPOSURE, FPS, HIDDEN, STD, blank, collisions, launches, only, searched
from synthcam.effect import Effect, library, parameter
from synthcam.model import Model
from tracker.geometry import InputError

KEYS = {"verdict", "named", "aliases", "outside", "where", "ranking", "gap", "experiment"}
UP = np.array([0.0, 0.0, 1.0])


def rates(ball, model, tilt, sliding):
    """dy/dt of place, velocity and spin (8,) of a ball on a tilted plate; written without a line of synthcam."""
    v, w, radius = ball[2:4], np.array([*ball[4:6], 0.0]), model.ball.radius
    fall = 9.81 * np.sin(tilt)
    if sliding:
        slip = v + np.cross(w, -radius * UP)[:2]
        rub = -model.sliding_friction * 9.81 * slip / np.hypot(*slip)
        return np.array([*v, *(rub + fall), *(np.cross(-radius * UP, [*rub, 0.0])[:2] * 2.5 / radius**2)])
    speed = np.hypot(*v)
    a = 5 / 7 * fall - (model.rolling_drag + model.rolling_decel / speed) * v
    return np.array([*v, *a, -a[1] / radius, a[0] / radius])


def path(start, t0, t1, model, tilt, sliding):
    """Place (2, n) as a function of time; slides until the touching point rests, then rolls. And the slide's end."""

    def slip(t, ball):
        return np.hypot(*(ball[2:4] + np.cross([*ball[4:6], 0.0], -model.ball.radius * UP)[:2])) - 1e-6

    slip.terminal = True
    how = {"rtol": 1e-10, "atol": 1e-13, "dense_output": True}
    if not sliding:
        return solve_ivp(lambda t, y: rates(y, model, tilt, False), (t0, t1), start, **how).sol, t0
    slide = solve_ivp(lambda t, y: rates(y, model, tilt, True), (t0, t1), start, events=slip, **how)
    end = slide.t[-1]
    if end == t1:
        return slide.sol, t1
    roll = solve_ivp(lambda t, y: rates(y, model, tilt, False), (end, t1), slide.y[:, -1], **how)
    return lambda t: np.where(t < end, slide.sol(t), roll.sol(t)), end


def integrated(model, tilt, count, seed):
    """Collisions on a tilted plate with white noise, from an integrator that shares no code with synthcam.dynamics."""
    rng, clips, frames = np.random.default_rng(seed), [], 60
    radius, (nodes, weights) = model.ball.radius, np.polynomial.legendre.leggauss(5)
    for number, launch in enumerate(launches(rng, count)):
        place, t_c, v0, heading, b = launch[:2], *launch[2:]
        d = np.array([np.cos(heading), np.sin(heading), 0.0])
        n = np.sqrt(1 - b * b) * d - b * np.cross(UP, d)
        v, w = v0 * d, np.cross(UP, v0 * d) / radius
        u = v - (v @ n) * n + radius * np.cross(w, n)
        blow = (1 + model.restitution) / 2 * (v @ n) * n + 0.4 * model.spin_transfer * u
        turn = -2.5 / radius * np.cross(n, 0.4 * model.spin_transfer * u)
        starts = [
            np.array([*(place + radius * n[:2]), *blow[:2], *turn[:2]]),
            np.array([*(place - radius * n[:2]), *(v - blow)[:2], *(w + turn)[:2]]),
        ]
        last = frames / FPS
        after = [path(s, t_c, last, model, tilt, True) for s in starts]
        came = np.array([*(place - radius * n[:2]), *v[:2], *w[:2]])
        before = [lambda t, s=starts[0]: np.repeat(s[:, None], len(t), 1), path(came, t_c, 0.0, model, tilt, False)[0]]
        clip = blank(number, launch, np.array([end for _, end in after]), frames)
        xy = np.empty_like(clip.xy)
        for k, (frame, ball) in enumerate(zip(clip.frame, clip.ball, strict=True)):
            cuts = [t for t in (t_c, after[ball][1]) if frame / FPS < t < frame / FPS + EXPOSURE]
            total = np.zeros(2)
            for a, z in itertools.pairwise([frame / FPS, *cuts, frame / FPS + EXPOSURE]):
                t = (a + z) / 2 + (z - a) / 2 * nodes
                where = (before if z <= t_c else [f for f, _ in after])[ball](t)[:2]
                total += where @ weights / 2 * (z - a) / EXPOSURE
            xy[k] = total
        clips.append(dataclasses.replace(clip, xy=xy + STD * rng.standard_normal(xy.shape)))
    return clips


def names(found):
    return [n.effect for n in found.search.named]


def within(found, truth, times=3.5):
    """Every named strength is the hidden one to within so many standard deviations, and those are small."""
    for n in found.search.named:
        for key, value in n.values.items():
            assert abs(value - truth[key]) < times * n.std[key]
            assert n.std[key] < 0.2 * max(abs(v) for v in truth.values())


@pytest.mark.parametrize("hidden", ["velocity_restitution", "rolling_quadratic"])
def test_a_hidden_effect_is_named_with_its_strength(hidden):
    found = searched(hidden)
    assert found.verdict == "named"
    assert names(found) == [hidden]
    within(found, HIDDEN[hidden])
    assert found.model.value(next(iter(HIDDEN[hidden]))) == next(iter(found.search.named[0].values.values()))


def test_a_tilt_hidden_by_another_integrator_is_named():
    found = find(integrated(Model(), np.array([8e-4, -5e-4]), 6, 21), Model())
    assert found.verdict == "named"
    assert names(found) == ["plate_tilt"]
    within(found, {"plate_tilt.x": 8e-4, "plate_tilt.y": -5e-4})
    best = found.search.best
    assert abs(best.chi2 / (best.points - best.parameters) - 1) < 0.15


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_nothing_hidden_is_nothing_found(rho):
    found = searched("nothing", rho)
    assert found.verdict == "none"
    assert names(found) == []
    assert found.model.effects == ()
    assert found.noise.correlation == pytest.approx(rho, abs=0.1)


@pytest.mark.parametrize("hidden", ["nothing", "velocity_restitution"])
def test_the_document_has_every_key(hidden):
    document = searched(hidden).document()
    assert document.keys() >= KEYS
    assert document["gap"].keys() == {"before", "after", "floor", "closure", "before_um", "after_um", "floor_um"}
    assert {r["effect"] for r in document["ranking"]} == set(library())
    assert [set(n) for n in document["named"]] == [{"effect", "parameters", "std", "sigma"}] * len(document["named"])


def test_two_hidden_effects_are_both_named_with_the_strengths_of_the_last_fit(monkeypatch):
    only(monkeypatch)
    truth = HIDDEN["velocity_restitution"] | {"rolling_quadratic.K": 0.3}
    found = find(collisions(Model().replace(truth), 8, 3), Model())
    assert found.verdict == "named"
    assert sorted(names(found)) == ["rolling_quadratic", "velocity_restitution"]
    within(found, truth)
    assert all(found.model.value(k) == v for n in found.search.named for k, v in n.values.items())


@dataclasses.dataclass(frozen=True)
class Streaks(Effect):
    """Friction that depends on the place: in nobody's library."""

    depth: float = parameter("1", scale=0.1)

    def friction(self, mu, position):
        return mu * (1 + self.depth * np.sin(position[..., 0] / 3e-3))


def test_an_effect_outside_the_library_gets_no_wrong_name(monkeypatch):
    only(monkeypatch)
    hidden = dataclasses.replace(Model(), effects=(Streaks(0.02),))
    found = find(collisions(hidden, 6, 3), Model())
    assert found.verdict == "outside_library"
    assert names(found) == []
    assert found.model.effects == ()
    assert found.search.ranking[0].sigma > 4  # the nearest of the library would have been claimed
    assert found.left[0].sigma > 5


class Twin(library()["velocity_restitution"]):
    """The same law under another name: nothing can tell the two apart."""

    @classmethod
    def name(cls):
        return "twin"


def test_exact_aliases_are_reported_as_a_class(monkeypatch):
    effect = library()["velocity_restitution"]
    Twin.laws = effect.laws
    only(monkeypatch, velocity_restitution=effect, twin=Twin)
    found = find(collisions(Model().replace({"velocity_restitution.e": 0.02}), 6, 4), Model())
    assert found.verdict == "ambiguous"
    assert len(found.search.named) == 1
    assert [set(a) for a in found.document()["aliases"]] == [{"twin", "velocity_restitution"}]
    assert found.document()["experiment"]


def test_the_order_of_the_clips_does_not_matter(monkeypatch):
    only(monkeypatch)
    clips = collisions(Model().replace(HIDDEN["velocity_restitution"]), 6, 3)
    one, other = (find(c, Model()).document() for c in (clips, clips[::-1]))
    assert one["verdict"] == other["verdict"] == "named"
    assert one["named"][0]["parameters"] == pytest.approx(other["named"][0]["parameters"], rel=1e-4)
    assert one["gap"] == pytest.approx(other["gap"], rel=1e-4)


def test_an_effect_in_the_model_with_a_wrong_strength_is_named_again(monkeypatch):
    only(monkeypatch)
    wrong = Model().replace({"velocity_restitution.e": 0.03})
    found = find(collisions(Model().replace(HIDDEN["velocity_restitution"]), 8, 3), wrong)
    assert found.verdict == "named"
    assert names(found) == ["velocity_restitution"]
    within(found, HIDDEN["velocity_restitution"])


def test_a_model_without_rolling_loss_is_searched_too():
    slippery = Model().replace({"rolling_decel": 0.0})
    assert find(collisions(slippery, 6, 5), slippery).verdict == "none"


def test_too_few_collisions():
    with pytest.raises(InputError, match="5 measured collisions: expected 6"):
        find(collisions(Model(), 5, 6), Model())


def test_clips_too_short_to_read_noise_from():
    clips = collisions(Model(), 6, 7)
    every = [c.frame % 3 == 0 for c in clips]
    cut = [
        dataclasses.replace(c, frame=c.frame[e], ball=c.ball[e], xy=c.xy[e], covariance=c.covariance[e])
        for c, e in zip(clips, every, strict=True)
    ]
    with pytest.raises(InputError, match="too few unbroken frames"):
        find(cut, Model())
