"""Groups of bodies: where and how fast many bodies start."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from synthcam.scene.scene import Scene
from synthcam_shared.errors import InputError

D = 0.00238


def states(groups, seed=0, number=0, **sections):
    launch = Scene.build("many", groups=groups, **sections).draw(number, seed).launch
    return launch.states[:, :2], launch.states[:, 3:5], launch


@pytest.mark.parametrize(
    ("group", "fraction"),
    [
        ({"count": 60, "size": [0.03, 0.03]}, 0.25),
        ({"count": 300, "size": [0.046, 0.046], "arrangement": "lattice"}, 0.58),
    ],
)
def test_bodies_keep_their_gap_and_their_area(group, fraction):
    places, velocities, _ = states([group | {"centre": [0.01, -0.02], "gap": 5e-5, "rms_speed": 0.2}])
    assert pdist(places).min() >= D + 5e-5 - 1e-15
    assert np.abs(places - [0.01, -0.02]).max() <= group["size"][0] / 2
    assert len(places) * np.pi * D**2 / 4 / (group["size"][0] + D) ** 2 == pytest.approx(fraction, abs=0.03)
    assert np.sqrt((velocities**2).sum(axis=1).mean()) == pytest.approx(0.2, rel=1e-12)
    assert velocities.mean(axis=0) == pytest.approx([0, 0], abs=1e-15)
    assert (velocities**2).mean(axis=0) == pytest.approx(
        0.02, rel=5 / np.sqrt(len(places))
    )  # no direction is preferred


def test_a_lattice_fills_the_area_from_side_to_side():
    places, _, _ = states([{"count": 90, "size": [0.03, 0.02], "arrangement": "lattice"}])
    assert places.max(axis=0) == pytest.approx(-places.min(axis=0), abs=3e-4)


def test_random_places_fill_the_area_evenly():
    places = np.vstack([states([{"count": 40, "size": [0.04, 0.04]}], number=k)[0] for k in range(25)])
    counts = np.histogram2d(*(places / 0.04 + 0.5).T, bins=4, range=[[0, 1], [0, 1]])[0]
    # the rim has more, because nothing outside keeps bodies off
    assert counts[1:3, 1:3] == pytest.approx(len(places) / 16, rel=0.25)
    assert counts == pytest.approx(len(places) / 16, rel=0.5)


def test_clips_differ_and_repeat():
    group = [{"count": 5, "size": [0.02, 0.02], "rms_speed": {"uniform": [0.1, 0.3]}}]
    first, again, other, seed = (states(group, *key)[0] for key in ((1, 0), (1, 0), (1, 1), (2, 0)))
    assert (first == again).all()
    assert (first != other).all()
    assert (first != seed).all()


def test_a_rack_has_rows_of_bodies_a_gap_apart():
    places, _, launch = states(
        [{"count": 15, "arrangement": "rack", "centre": [0.02, 0.0], "gap": 1e-5}],
        launches=[{"position": [-0.02, 0.0], "velocity": [0.5, 0.0]}],
    )
    assert len(places) == 16
    assert places[1] == pytest.approx([0.02, 0.0])
    apart = np.sort(pdist(places[1:]))
    assert apart[:30] == pytest.approx(D + 1e-5, rel=1e-12)  # 30 pairs touch in a rack of 15
    assert apart[30] > 1.7 * D
    assert np.ptp(places[1:, 0]) == pytest.approx(4 * (D + 1e-5) * np.sqrt(3) / 2)
    assert launch.states[0, 3] == 0.5


def test_groups_keep_clear_of_each_other_and_have_their_own_bodies():
    small = {"count": 20, "size": [0.02, 0.02], "body": {"diameter": 0.001, "density": 2500}}
    places, _, launch = states([{"count": 8, "size": [0.02, 0.02], "gap": 1e-4}, small])
    radius = launch.bodies.radius
    assert radius.tolist() == [D / 2] * 8 + [0.0005] * 20
    apart = np.linalg.norm(places[:, None] - places, axis=2) - radius[:, None] - radius
    assert apart[np.triu_indices(28, 1)].min() >= 0
    assert launch.bodies.mass[-1] == pytest.approx(2500 * np.pi / 6 * 1e-9)


def test_the_truth_lists_each_body():
    clip = Scene.read("crowd").draw(seed=3)
    assert len(clip.drawn["launches"]) == 30
    assert "groups" not in clip.drawn
    assert Scene.build("again", launches=clip.drawn["launches"]).draw().launch.states == pytest.approx(
        clip.launch.states
    )


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"groups": [{"count": 5}]}, "groups.0.size: expected the width and the height of the area"),
        (
            {"groups": [{"count": 99, "size": [0.01, 0.01]}]},
            "groups.0: .. of 99 bodies find a position at random in 0.01",
        ),
        (
            {"groups": [{"count": 99, "size": [0.01, 0.01], "arrangement": "lattice"}]},
            "groups.0: 2. of 99 bodies have room",
        ),
        ({"groups": [{"count": 0, "size": [1.0, 1.0]}]}, "groups.0.count: expected"),
        ({"groups": [{"count": 2, "size": [0.0, 1.0]}]}, "groups.0.size.0: expected"),
        ({"groups": []}, "groups: expected"),
        (
            {"groups": [{"count": 20_000, "size": [9.0, 9.0], "arrangement": "lattice"}] * 2},
            "at most 20000 bodies in all",
        ),
        ({"groups": [{"count": 2, "size": [1.0, 1.0]}], "bodies": [{}, {}]}, "bodies: a list beside groups"),
        (
            {"groups": [{"count": 2, "size": [1.0, 1.0], "body": {}}], "bodies": [{}, {}]},
            "bodies: 2 of them and 0 launches; expected as many, or one",
        ),
        ({"groups": [{"count": 3, "arrangement": "rack", "gap": 1e300}]}, "groups.0.gap: expected"),
        ({"groups": [{"count": 2, "size": [1.0, 1.0]}], "launch": {"v0": 0.2}}, "beside groups of many bodies"),
        (
            {"groups": [{"count": 1, "arrangement": "rack"}], "launches": [{"position": [0.0, 0.0]}]},
            "bodies 0 and 1 overlap",
        ),
        ({"groups": [{"count": 2, "size": [1.0, 1.0], "gaps": 1.0}]}, "groups.0.gaps: unknown key"),
    ],
)
def test_groups_that_cannot_be(sections, message):
    with pytest.raises(InputError, match=message):
        Scene.build("wrong", **sections)
