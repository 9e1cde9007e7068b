"""Values drawn for each clip."""

import zlib

import numpy as np
import pytest
from scipy import stats

from synthcam.scene.distribution import draw_settings, find_choices, parse_distribution, replace_at, replace_by_extremes
from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError

SCENE = {"launch": {"v0": {"uniform": [0.1, 0.6]}, "b": {"normal": [0.0, 0.1]}}, "ball": {"diameter": 2e-3}}


def values(kind, args, n=2000):
    return [draw_settings({"x": {kind: args}}, k, 7)["x"] for k in range(n)]


def test_each_has_its_law():
    assert stats.kstest(values("uniform", [2, 5]), stats.uniform(2, 3).cdf).pvalue > 1e-3
    assert stats.kstest(values("normal", [2, 5]), stats.norm(2, 5).cdf).pvalue > 1e-3
    counts = np.unique(values("choice", ["a", "b", "c"]), return_counts=True)[1]
    assert stats.chisquare(counts).pvalue > 1e-3
    assert stats.kstest(values("uniform", [2, 5]), stats.uniform(2, 3.3).cdf).pvalue < 1e-3  # the test can fail


def test_a_normal_is_cut():
    assert replace_by_extremes({"x": {"normal": [1, 2]}}, "low", "") == {"x": -7}
    assert replace_by_extremes({"x": {"normal": [1, 2]}}, "high", "") == {"x": 9}
    assert max(np.abs(values("normal", [0, 1], 5000))) <= 4


def test_no_value_moves_another():
    alone = [draw_settings(SCENE, k, 3)["launch"]["v0"] for k in range(5)]
    more = {"sensor": {"gain": {"uniform": [1, 2]}}, **SCENE, "model": {"restitution": {"uniform": [0.8, 0.9]}}}
    fewer = {"launch": {"v0": {"uniform": [0.1, 0.6]}}}
    for other in (more, fewer):
        assert [draw_settings(other, k, 3)["launch"]["v0"] for k in range(5)] == alone


def test_same_draw_whatever_the_order():
    forth = [draw_settings(SCENE, k, 3) for k in range(6)]
    back = [draw_settings(SCENE, k, 3) for k in reversed(range(6))]
    assert forth == back[::-1]


def test_clip_seed_and_key_each_make_another_stream():
    def v(number, seed, key="v0"):
        return draw_settings({"launch": {key: {"uniform": [0, 1]}}}, number, seed)["launch"][key]

    found = [v(k, s, key) for k in range(20) for s in range(20) for key in ("v0", "b")]
    assert len(set(found)) == 800
    assert stats.kstest(found, stats.uniform.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(found[::2], found[1::2])[0, 1]) < 0.15


def test_pinned():
    """A dataset's seed means the same in every version: this number may change only with a line in the CHANGELOG."""
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(3, spawn_key=(1, zlib.crc32(b"launch.v0")))))
    assert draw_settings(SCENE, 1, 3)["launch"]["v0"] == rng.uniform(0.1, 0.6)


@pytest.mark.parametrize(
    "wrong",
    [
        {"uniform": [1]},
        {"uniform": [2, 1]},
        {"uniform": [1, float("nan")]},
        {"uniform": [1, 10**400]},
        {"uniform": [True, 2]},
        {"uniform": "ab"},
        {"normal": [0, -1]},
        {"normal": [0, float("inf")]},
        {"choice": []},
        {"choice": 3},
    ],
)
def test_a_wrong_one_is_named(wrong):
    with pytest.raises(InputError, match=r"file: launch\.v0\.(uniform|normal|choice): expected"):
        parse_distribution(wrong, "launch.v0", "file")


def test_what_is_none():
    for value in (3, "uniform", {"gauss": [0, 1]}, {"uniform": [0, 1], "normal": [0, 1]}, {}, None):
        assert parse_distribution(value, "", "") is None


def test_choices_are_found_and_put_in():
    plain = {"a": {"b": {"choice": [1, 2]}, "c": 3}}
    assert list(find_choices(plain)) == [(("a", "b"), [1, 2])]
    assert replace_at(plain, ("a", "b"), 9) == {"a": {"b": 9, "c": 3}}
    assert plain["a"]["b"] == {"choice": [1, 2]}


def test_a_long_choice_is_checked_by_its_extremes():
    """200,000 values: one check for each would take hours, for each of them a new copy of all."""
    values = [0.1 + 1e-6 * k for k in range(200_000)]
    assert (
        len(check_scene({"launch": {"v0": {"choice": values}}}, "s.yaml").settings["launch"]["v0"]["choice"]) == 200_000
    )
    with pytest.raises(InputError, match=r"launch\.v0: expected a number above 0"):
        check_scene({"launch": {"v0": {"choice": [*values[:100_000], -1.0, *values[100_000:]]}}}, "s.yaml")
    with pytest.raises(InputError, match=r"sensor\.bits"):
        check_scene({"sensor": {"bits": {"choice": [8, 9.5, 12]}}}, "s.yaml")
    with pytest.raises(InputError, match=r"launch\.v0"):
        check_scene({"launch": {"v0": {"choice": [0.1, float("nan"), 0.2]}}}, "s.yaml")
    with pytest.raises(InputError, match=r"name\.choice: expected at most 1000 different values, found 200000"):
        check_scene({"name": {"choice": [f"{k}" for k in range(200_000)]}}, "s.yaml")
