"""Durations of contacts by the bend of paths, held to forces that are integrated in small steps, and to scenes."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import cumulative_trapezoid, solve_ivp
from tracker_contacts import LAWS, SoftHit

from benchmarks.real.hits import measure_hit
from benchmarks.real.recordings import RecordedHit
from benchmarks.tracker.push_durations import make_camera, slow_down
from synthcam.scene.scene import check_scene
from tracker.camera.camera import Camera
from tracker.measurement.local import push_fit
from tracker.measurement.local.push_fit import integrate_push
from tracker.measurement.positions import to_ball_tracks
from tracker.report.estimates_text import describe_contact
from tracker.tables.read import read_frame
from tracker.tables.table_options import TableOptions

KEYS = {"fps": 250.0, "ball_diameter": 0.05, "size": [1000, 1000], "scale": 1e-3, "exposure": 0.0}


def draw_hit(seed, **changes):
    """A hit of discs that air slows, before and after it: its tracks, the camera file, and how long the force lasts."""
    rng = np.random.default_rng(seed)
    given = {"r": 0.8, "v0": 0.4, "b": 0.3, "fps": 250.0, "before": 62, "after": 62, "noise": 3e-5} | changes
    hit = SoftHit(**given)
    lasts = float(hit.end_of_force()[0])
    return slow_down(hit.tracks(rng), hit, lasts / 2, rng), make_camera(hit), lasts


def measure(tracks, camera, support="air"):
    return measure_hit(RecordedHit("", tracks, camera), support)


def to_tracks(tracks, keys):
    ((table, _),) = read_frame(tracks, keys, TableOptions(unit="m")).clips.values()
    return to_ball_tracks(table, Camera.of(keys))


@pytest.mark.parametrize("exposure", [0.0, 0.004])
def test_a_push_adds_the_way_of_half_a_sine(exposure):
    duration, t = 0.02, np.linspace(-0.03, 0.03, 60001)
    force = np.where(np.abs(t) < duration / 2, np.cos(np.pi * t / duration) * np.pi / (2 * duration), 0.0)
    way = cumulative_trapezoid(cumulative_trapezoid(force, t, initial=0), t, initial=0)
    if exposure:
        whole, side = cumulative_trapezoid(way, t, initial=0), exposure / 2
        inside = np.abs(t) < 0.03 - side
        way = (np.interp(t + side, t, whole) - np.interp(t - side, t, whole))[inside] / exposure
        t = t[inside]
    np.testing.assert_allclose(integrate_push(t, duration, exposure), way, atol=1e-8)


def test_an_instant_turns_the_path_at_once():
    t = np.array([-0.01, 0.0, 0.01])
    np.testing.assert_allclose(integrate_push(t, 0.0), [0, 0, 0.01], atol=1e-9)
    np.testing.assert_allclose(integrate_push(t, 0.0, 0.004), [0, 0.0005, 0.01], atol=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_soft_discs_push_each_other_for_a_time(law):
    tracks, camera, lasts = draw_hit(3, duration=0.02, law=law)
    row = measure(tracks, camera)
    assert abs(row["contact_duration_local"] - lasts) < 3 * row["contact_duration_local_std"]
    assert row["contact_duration_local_std"] < 0.2 * lasts
    assert "push each other for" in describe_contact(row | {"flags": ""})


@pytest.mark.parametrize("seed", range(4))
def test_an_impact_has_no_duration(seed):
    tracks, camera, _ = draw_hit(seed, duration=0.0)
    row = measure(tracks, camera)
    assert np.isfinite(row["r_local"])
    assert np.isnan([row["contact_duration_local"], row["contact_duration_local_std"]]).all()
    assert describe_contact(row | {"flags": ""}) == ""


def test_discs_of_a_scene_touch_as_long_as_their_contact_lasts():
    """Their masses differ, and the air slows both at rates that change at the contact."""
    scene = {
        "launches": [{"position": [0.0, 0.0]}, {"position": [-0.148, -0.015], "velocity": [0.4, 0.0]}],
        "bodies": [{"shape": "disc", "diameter": 0.05, "mass": mass} for mass in (0.015, 0.03)],
        "ball": {"diameter": 0.05},
        "support": {"kind": "air", "drag": 0.5, "decel_range": [0.0, 0.3]},
        "contact_force": {"law": "linear", "duration": 0.02},
        "model": {"restitution": 0.8},
        "timing": {"fps": 250, "frames": 130},
        "camera": {"scale": 1e-3, "height": 2.0},
    }
    motion = check_scene(scene, "scene").draw(seed=4).solve()
    begin, end = (
        float(motion.events["t_s"][motion.events["kind"] == kind].iloc[0]) for kind in ("contact", "contact_end")
    )
    states, rng = motion.at(np.arange(130) / 250), np.random.default_rng(4)
    xy = states[["x", "y"]].to_numpy() + rng.normal(0, 3e-5, (len(states), 2))
    tracks = pd.DataFrame({"frame": np.rint(states["t_s"] * 250).astype(int), "particle": states["particle"]})
    row = measure(tracks.assign(x=xy[:, 0], y=xy[:, 1]), KEYS)
    assert end - begin == pytest.approx(0.02, rel=0.03)
    assert abs(row["contact_duration_local"] - (end - begin)) < 3 * row["contact_duration_local_std"]


def test_only_bodies_that_glide_have_a_duration(monkeypatch):
    """The slide of a ball that ends soon after an impact would look like a push."""
    asked = []
    monkeypatch.setattr("tracker.measurement.local.local_estimate.measure_push", lambda *given: asked.append(given))
    ball = SoftHit(0.0, r=0.8, v0=0.4, b=0.3, friction=0.2, fps=250.0, before=62, after=62, noise=3e-5)
    for support in ("cloth", ""):
        measure(ball.tracks(np.random.default_rng(2)), make_camera(ball), support)
    measure(*draw_hit(2, duration=0.0)[:2], "sliding")
    assert asked == []
    measure(*draw_hit(2, duration=0.0)[:2])
    assert len(asked) == 1


def test_an_exposure_rounds_an_instant():
    fps, exposure, instant = 250.0, 0.0035, 0.241
    rng, start = np.random.default_rng(5), np.arange(120) / fps
    way = integrate_push(start + exposure / 2 - instant, 0.0, exposure)[:, None]
    parts = [
        pd.DataFrame({"frame": np.arange(120), "particle": k, "x": x, "y": y, "x_std": 3e-7, "y_std": 3e-7})
        for k, kick in enumerate(([0.3, 0.05], [-0.3, 0.0]))
        for x, y in [(way * kick + rng.normal(0, 3e-7, (120, 2))).T]
    ]
    squares = []
    for balls in (to_tracks(pd.concat(parts), KEYS | {"exposure": e}) for e in (exposure, 1e-6)):
        paths = [push_fit._cut_path(ball, instant, 0.1, 1 / fps) for ball in balls]
        squares += push_fit._fit_middles(paths, np.zeros(1), np.zeros(1), np.array([2e-3]))[1].tolist()
    assert squares[0] < 300 < 900 < squares[1]


def throw_back_by_hertz(r):
    """The overlap of discs by a Hertz spring that pulls at the end, as a function of the time over its duration."""
    loss = -np.log(r)
    damping = np.sqrt(5) * loss / np.hypot(np.pi, loss)

    def accelerate(t, y):
        deep = max(y[0], 0.0)
        return [y[1], -(deep**1.5) - damping * deep**0.25 * y[1]]

    def part(t, y):
        return y[0] if t > 0.1 else 1.0

    part.terminal = True
    found = solve_ivp(accelerate, (0, 20), [0.0, 1.0], rtol=1e-8, atol=1e-10, events=part, dense_output=True)
    lasts, parting = found.t[-1], -found.y[1, -1]
    assert parting == pytest.approx(r, abs=1e-3)
    return lambda s: np.where(
        s < 0, s * lasts, np.where(s < 1, found.sol(lasts * np.clip(s, 0, 1))[0], -parting * lasts * (s - 1))
    )


def find_ratio(path_of_one, path_of_other, since, lasts):
    """The duration of the half sine that describes paths (n, 2) without noise, over that of the force."""
    table = pd.concat(
        [
            pd.DataFrame({"frame": np.arange(len(since)), "particle": k, "x": path[:, 0], "y": path[:, 1]})
            for k, path in enumerate((path_of_one, path_of_other))
        ]
    )
    keys = KEYS | {"fps": 500.0}
    balls = to_tracks(table.assign(x_std=1e-5, y_std=1e-5), keys)
    paths = [push_fit._cut_path(ball, lasts / 2 - since[0], 0.12, 1 / 500) for ball in balls]
    tried = lasts * np.linspace(0.6, 1.15, 56)
    return float(tried[np.argmin(push_fit._fit_middles(paths, tried, np.zeros(56), tried / 8)[1])]) / lasts


@pytest.mark.parametrize(("r", "ratio", "scatter"), push_fit.LAWS.T[1:].tolist())
def test_the_table_of_laws_is_that_of_integrated_forces(r, ratio, scatter):
    since, found = (np.arange(-65, 75) + 0.3) / 500, []
    for law in LAWS:
        hit = SoftHit(0.02, r=r, v0=0.4, law=law)
        found.append(find_ratio(*hit.positions(since), since, float(hit.end_of_force()[0])))
    overlap = 2e-3 * throw_back_by_hertz(r)(since / 0.02)[:, None] * [0.5, 0.0]
    found.append(find_ratio(overlap, -overlap, since, 0.02))
    assert np.mean(found) == pytest.approx(ratio, abs=0.015)
    assert np.std(found, ddof=1) == pytest.approx(scatter, abs=0.02)
