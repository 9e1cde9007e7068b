"""Scenes of many bodies: what they become, and one line for each that cannot be."""

import copy
import tracemalloc

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from synthcam.dynamics.supports import Air
from synthcam.scene.bodies import MAX_BODIES, _find_overlap
from synthcam.scene.scene import Scene, check_scene
from synthcam.scene.table_drawing import TWO_BALLS
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera

TRAY = {
    "launches": [{"position": [-0.01, 0.0], "velocity": [0.3, 0.0]}, {"position": [0.01, 0.0]}],
    "walls": [
        {"start": [-0.03, -0.02], "end": [0.03, -0.02]},
        {"start": [0.03, -0.02], "end": [0.03, 0.02]},
        {"start": [0.03, 0.02], "end": [-0.03, 0.02]},
        {"start": [-0.03, 0.02], "end": [-0.03, -0.02]},
    ],
    "timing": {"frames": 20},
}


def changed(change):
    scene = copy.deepcopy(TRAY)
    change(scene)
    return scene


def test_the_scene_that_comes_with_it():
    clip = Scene.read("tray").draw(seed=1)
    motion = clip.solve()
    assert len(clip.launch.bodies.radius) == 12
    assert set(motion.events["kind"]) >= {"contact", "wall", "slide_end"}
    assert len(clip.tracks) == 12 * clip.frames
    assert clip.tracks["visible"].all()
    assert "striker" not in clip.camera_json
    assert np.isnan(clip.truth["r"])
    assert "10 x contact" in repr(motion)


def test_a_number_in_a_list_is_drawn_for_each_clip():
    scene = Scene.read("tray")
    assert "launches.0.velocity.0 uniform [-0.3, 0.3]" in repr(scene)
    one, two = (scene.draw(k, seed=1).launch.states[:, 3:5] for k in (0, 1))
    assert len(np.unique([one, two])) == 48
    assert np.abs([one, two]).max() < 0.3


def test_two_balls_of_a_pair_and_of_a_table_move_alike():
    """The pair of `launch` and the same balls of `launches`, which start earlier."""
    timing = {"frames": 60, "contact_frame": 20}
    launch = {"v0": 0.3, "b": 0.3, "heading": 0.2, "contact": [0.0, 0.0]}
    pair = check_scene({"launch": launch, "timing": timing}, "scene").draw()
    states = pair.view.motion.at(0.0)[:, 0]
    launches = [{"position": s[:2].tolist(), "velocity": s[3:5].tolist()} for s in states]
    table = check_scene({"launches": launches, "timing": timing}, "scene").draw()
    columns = ["x", "y", "vx", "vy", "wx", "wy", "wz"]
    np.testing.assert_allclose(table.tracks[columns], pair.tracks[columns], rtol=0, atol=1e-8)
    assert table.solve().events["kind"].tolist() == pair.solve().events["kind"].tolist()


def test_bodies_have_what_their_entries_say():
    bodies = [
        {"diameter": 4e-3, "density": 2500},
        {"shape": "disc", "mass": 1e-3, "support": {"kind": "air", "decel": 0.1}, "label": "a"},
    ]
    effects = {"mass_mismatch": {"excess": 0.5}}
    clip = check_scene(TRAY | {"bodies": bodies, "effects": effects}, "scene").draw()
    own = clip.launch.bodies
    np.testing.assert_allclose(own.radius, [2e-3, 1.19e-3])
    np.testing.assert_allclose(own.mass, [2500 * np.pi / 6 * 4e-3**3, 1.5e-3])
    np.testing.assert_allclose(own.inertia, [0.4, 0.5])
    assert clip.table.supports == (None, Air(decel=0.1))


@pytest.mark.parametrize(
    ("change", "known"),
    [
        ({}, {}),
        ({"bodies": {"shape": "disc"}, "support": {"kind": "air"}}, {"body": "disc", "support": "air"}),
        ({"bodies": {"shape": "disc"}, "support": {"kind": "dry"}}, {"body": "disc", "support": "sliding"}),
        ({"bodies": {"shape": "shell"}}, {"body": 2 / 3}),
        ({"bodies": [{}, {"shape": "disc", "support": {"kind": "air"}}]}, {}),  # no key can say it of one of them
    ],
)
def test_the_camera_file_says_what_the_bodies_are_and_what_carries_them(change, known):
    written = check_scene(TRAY | change, "scene").draw().camera_json
    assert {key: written[key] for key in ("body", "support") if key in written} == known
    inertia = {"disc": 0.5, "ball": 0.4}
    body = known.get("body", "ball")
    assert Camera.from_dict(written).body == inertia.get(body, body)
    assert Camera.from_dict(written).support == known.get("support", "")


def test_a_ball_starts_in_the_air_or_without_rolling():
    launches = [{"position": [0.0, 0.0], "velocity": [0.2, 0.1], "slip": [0.05, 0.0], "height": 1e-3, "rise": 0.1}]
    state = check_scene(TRAY | {"launches": launches}, "scene").draw().launch.states[0]
    np.testing.assert_allclose(state[:6], [0, 0, 2.19e-3, 0.2, 0.1, 0.1])
    np.testing.assert_allclose([state[3] - 1.19e-3 * state[7], state[4] + 1.19e-3 * state[6]], [0.05, 0.0], atol=1e-15)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda s: s["launches"][1].update(position=[-0.009, 0.0]), "bodies 0 and 1 overlap by 0.00138 m"),
        (lambda s: s["walls"][0].update(end=[-0.03, -0.02]), "walls.0: a wall from .* has no length"),
        (lambda s: s["walls"][0].pop("end"), "walls.0: expected start and end, or centre and radius"),
        (lambda s: s["walls"][0].update(radius=1.0), "walls.0: expected start and end, or centre and radius"),
        (lambda s: s["walls"][0].update(height=3e-3), "walls.0.height: expected a height within body 0"),
        (lambda s: s["launches"][1].update(position=[0.0295, 0.0]), "launches.1: the body is in wall 1"),
        (lambda s: s["launches"][1].update(position=[0.05, 0.0]), "launches.1: the body is outside the walls"),
        (lambda s: s.update(walls=[{"centre": [0, 0], "radius": 5e-3}]), "launches.0: the body is beyond wall 0"),
        (lambda s: s.update(bodies=[{}, {}, {}]), "bodies: 3 of them and 2 launches"),
        (lambda s: s.update(bodies={"shape": "cube"}), r"bodies\.shape: expected"),
        (
            lambda s: s.update(bodies=[{"shape": "disc", "height": 2e-3}, {}], support={"kind": "air"}),
            "bodies: disc 0 is 0.002 m high; expected that of the balls beside it, 0.00238 m",
        ),
        (
            lambda s: s.update(bodies=[{"shape": "disc", "height": h} for h in (1e-3, 2e-3)], support={"kind": "air"}),
            "bodies: disc 1 is 0.002 m high; expected one height for all",
        ),
        (
            lambda s: s.update(bodies={"shape": "disc", "height": 5e-3}, support={"kind": "air"}),
            "bodies: disc 0 is 0.005 m high; expected at most 0.00476 m: two diameters, and half",
        ),
        (lambda s: s.update(bodies={"height": 1e-3}), "bodies: body 0 is a ball; expected no height, or shape: disc"),
        (
            lambda s: s.update(bodies={"shape": "disc"}, support={"kind": "air"}, surface={"ball": "steel"}),
            "surface.ball: steel is of balls alone; expected matte for discs",
        ),
        (lambda s: s.update(bodies={"colour": "red"}), "bodies: colour of body 0: expected together with surface.ball"),
        (
            lambda s: s.update(bodies={"colour": "mauve"}, surface={"ball": "matte"}),
            "bodies.colour: expected .*white.*",
        ),
        (lambda s: s.update(bodies={"mass": -1}), r"bodies\.mass: expected a number above 0"),
        (lambda s: s.update(contact_duration=10.0), "contact_duration: expected a number of 0.01 or less"),
        (lambda s: s["launches"][0].update(spin=1e300), r"launches\.0\.spin: expected a number of 100000 or less"),
        (lambda s: s["launches"][0].update(velocity=[float("nan"), 0]), r"launches\.0\.velocity\.0: expected a finite"),
        (
            lambda s: s.update(support={"kind": "air"}) or s["launches"][0].update(slip=[0.1, 0]),
            "launches.0: slip, height",
        ),
        (lambda s: s.update(bodies={"shape": "disc"}), "bodies: disc 0 is on a plate of balls; expected support"),
        (lambda s: s.update(support={"kind": "dry"}), "bodies: body 0 is on a dry support; expected a disc"),
        (lambda s: s.update(launch={"v0": 0.3}), "launch: of one pair, beside launches of many bodies"),
        (lambda s: s.pop("launches"), "walls: of a scene of many bodies; expected `launches`"),
        (lambda s: s.update(launches=[]), "launches: expected 1 or more values"),
        (
            lambda s: s.update(launches=[{"position": [0, 0]}] * (MAX_BODIES + 1)),
            f"launches: expected {MAX_BODIES} values or fewer, found {MAX_BODIES + 1}",
        ),
        (lambda s: s.update(bodies=[{}] * 1_000_000), "bodies: expected 20000 values or fewer, found 1000000"),
        (lambda s: s.update(walls=s["walls"] * 1000), "walls: expected 1000 values or fewer, found 4000"),
        (
            lambda s: s.update(groups=[{"count": 1, "size": [1.0, 1.0]}] * 101),
            "groups: expected 100 values or fewer, found 101",
        ),
        (
            lambda s: s.update(groups=[{"count": 1, "size": [1.0, 1.0], "body": [{}] * (MAX_BODIES + 1)}]),
            "groups.0.body: expected 20000 values or fewer",
        ),
        (lambda s: s["launches"][0].update(velocity=[{"uniform": [0.3, 0.1]}, 0]), "launches.0.velocity.0.uniform"),
        (lambda s: s["launches"][0].update(position=["left", 0]), "launches.0.position.0"),
        (lambda s: s["launches"][0].update(time=0.1, height=0.01), "launches.0: height: of a launch at time 0"),
        (
            lambda s: s["launches"][0].update(push={"until": 0.1, "acceleration": [1, 0]}, time=0.2),
            "launches.0: push.until",
        ),
        (
            lambda s: s["launches"][0].update(push={"until": 0.1, "acceleration": [1, 0]}, rise=0.2),
            "launches.0: push: of a",
        ),
        (lambda s: s.update(bodies={"sticks": 1e-3}), "bodies: bodies stick on air, and discs on a dry plate"),
        (lambda s: s.update(contact_force={"law": "hertz", "duration": 1e-3}), "contact_force: expected law: linear"),
        (
            lambda s: s.update(contact_force={"duration": 1e-3}, effects={"hop": {"share": 1.0}}),
            "contact_force: balls do not hop",
        ),
        (
            lambda s: s.update(contact_force={"duration": 1e-3}, effects={"magnetic_attraction": {"pull": 0.1}}),
            "balls that push each other are launched together",
        ),
        (
            lambda s: s.update(
                bodies={"shape": "disc", "sticks": 1}, support={"kind": "air"}, contact_force={"duration": 1}
            ),
            "contact_force: of bodies that do not stick",
        ),
        (lambda s: s["walls"][0].update(cushion="mathavan", tangential_restitution=0.5), "walls.0: tangential_rest"),
        (
            lambda s: s["walls"][1].update(cushion="mathavan") or s.update(support={"kind": "air"}),
            "walls.1.cushion: mathavan is a law of balls",
        ),
        (
            lambda s: s.update(support={"kind": "air", "decel_range": [0.2, 0.1]}),
            "support.decel_range.*low before high",
        ),
        (lambda s: s.update(support={"kind": "air", "decel_range": [-0.2, 0.1]}), "support.decel_range.*below 0"),
    ],
)
def test_what_cannot_be_is_one_line(change, line):
    with pytest.raises(InputError, match=line) as refused:
        check_scene(changed(change), "scene.yaml")
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith("scene.yaml")


def test_overlaps_of_bodies_of_any_size():
    """The first pair, or none, is that of all pairs."""
    rng = np.random.default_rng(3)
    for count, size in ((2, 0.01), (40, 0.1), (40, 0.4), (40, 1.0)) * 10:
        radius = 10 ** rng.uniform(-4, -1, count)
        centres = np.column_stack([rng.uniform(0, 2 * size, (count, 2)), np.full(count, 0.01)])
        gaps = np.linalg.norm(centres[:, None] - centres, axis=-1) - radius - radius[:, None] + np.eye(count)
        found = _find_overlap(centres, radius, 0.0)
        assert (found is None) == bool((gaps + np.diag(np.full(count, np.inf)) >= 0).all())
        assert found is None or (gaps[found] < 0 and found[0] < found[1])


def test_a_heap_of_bodies_at_one_place_takes_little_memory():
    heap = {"launches": [{"position": [0.0, 0.0]}] * 2000}
    check_scene(TRAY, "scene")
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"bodies 0 and .* overlap by 0\.00238 m"):
            check_scene(heap, "scene")
        assert tracemalloc.get_traced_memory()[1] < 30e6  # 300 MB for a list of all two million pairs
    finally:
        tracemalloc.stop()


def test_a_body_in_one_of_many_walls():
    """Each end of a wall, its middle, and a place beside it."""
    walls = [{"start": [0.01 * k, -0.02], "end": [0.01 * k, 0.02]} for k in range(300)]
    beside = [{"position": [0.01 * k + 0.005, 0.001 * (k % 20)]} for k in range(299)]
    check_scene({"launches": beside, "walls": walls}, "scene")
    for place in ([1.0, -0.021], [1.0, 0.021], [1.0011, 0.0], [0.9989, 0.01]):
        with pytest.raises(InputError, match=r"launches\.299: the body is in wall 100;"):
            check_scene({"launches": [*beside, {"position": place}], "walls": walls}, "scene")


def test_each_body_has_its_colour_and_its_height():
    """In the film, in the drawing from above and for the light; those of a group take turns."""
    kinds = [{"colour": "red", "pattern": "half"}, {"colour": [0.1, 0.2, 0.3], "albedo": 1.0}]
    group = {"count": 3, "size": [0.01, 0.005], "centre": [0, 0.01], "body": kinds}
    scene = TRAY | {"bodies": {"shape": "solid"}, "groups": [group], "surface": {"ball": "matte"}}
    clip = check_scene(scene | {"camera": {"colour": True}}, "scene").draw()
    red, own, white = (0.6375, 0.0425, 0.0425), (0.1, 0.2, 0.3), (0.85, 0.8245, 0.765)
    assert clip.finish is not None
    np.testing.assert_allclose([ball.colour for ball in clip.finish.balls], [white, white, red, own, red])
    assert [ball.pattern for ball in clip.finish.balls][1:4] == ["plain", "half", "plain"]
    motion = clip.solve()
    shown = [np.array(one.main) ** 2.2 for one in motion.colours]
    np.testing.assert_allclose(shown, [ball.colour for ball in clip.finish.balls])
    striped = motion.colours[2]
    assert [one.second is not None for one in motion.colours] == [False, False, True, False, True]
    paths = motion.plot(Figure().subplots()).lines[4::2]  # after the walls, each with its end
    np.testing.assert_allclose([paths[k].get_color() for k in (2, 3)], [striped.second, motion.colours[3].main])
    steel = check_scene(TRAY, "scene").draw().solve().plot(Figure().subplots())
    assert [line.get_color() for line in steel.lines[4:6]] == list(TWO_BALLS)
    flat = TRAY | {"bodies": {"shape": "disc", "pattern": "half"}, "support": {"kind": "air"}}
    discs = check_scene(flat, "scene").draw()
    np.testing.assert_allclose(discs.heights, 0.00238 / 4)
    assert discs.finish is not None  # discs are matte, and mirror no lamp
    assert discs.tracks[["glint_x_px", "glint_y_px"]].isna().to_numpy().all()
    axis = discs.orientation.at(0, np.array([0.0, 0.04])).apply([0, 0, 1])
    np.testing.assert_allclose(axis[:, 2], 0, atol=1e-12)  # in their plane


def test_an_animation(tmp_path):
    motion = check_scene(TRAY, "scene").draw().solve()
    motion.animate(tmp_path / "table.gif", fps=10, slower=3)
    motion.animate(tmp_path / "table.mp4", slower=1)
    with Image.open(tmp_path / "table.gif") as picture:
        assert (picture.n_frames, picture.info["duration"]) == (4, 100)
    assert (tmp_path / "table.mp4").stat().st_size > 1000
    with pytest.raises(InputError, match=r"expected a name that ends in \.gif or \.mp4"):
        motion.animate(tmp_path / "table.avi")
    with pytest.raises(InputError, match="expected a larger fps or slower"):
        motion.animate(tmp_path / "table.gif", fps=1)
    assert not (tmp_path / "table.avi").exists()


def test_what_bodies_do_beside_gliding_and_rolling_is_in_the_truth():
    """Late launches, pushes, tape, draws of the air and of contacts: the events and their columns."""
    bodies = [{"shape": "disc", "sticks": 1e-3}, {"shape": "disc"}, {"shape": "disc"}]
    launches = [
        {"position": [-0.01, 0.0], "velocity": [0.3, 0.0], "time": 0.02},
        {"position": [0.0, 0.0]},
        {"position": [0.0, 0.01], "push": {"until": 0.03, "acceleration": [0.4, 0.3]}},
    ]
    support = {"kind": "air", "decel_range": [0.01, 0.02], "curl_range": [-0.1, 0.1]}
    scene = TRAY | {"bodies": bodies, "launches": launches, "support": support, "scatter": {"distance": 1e-3}}
    motion = check_scene(scene, "scene").draw(seed=1).solve()
    events = motion.events
    assert set(events["kind"]) >= {"launch", "release", "stretch", "contact", "together"}
    stretches, others = (events[(events["kind"] == "stretch") == whether] for whether in (True, False))
    assert stretches["decel"].between(0.01, 0.02).all()
    assert stretches["curl"].between(-0.1, 0.1).all()
    assert others["decel"].isna().all()
    assert (events["distance_shift"].notna() == (events["kind"] == "contact")).all()
    assert set(motion.at(0.01)["state"]) == {"rest", "push"}
    assert check_scene(scene, "scene").draw(seed=1).truth["v0"] == pytest.approx(0.3)


@pytest.mark.parametrize("force", [{"law": "linear", "duration": 2e-3}, {"law": "hertz", "modulus": 1e7}])
@pytest.mark.parametrize("kind", ["plate", "air", "dry"])
def test_contacts_last_in_a_scene(force, kind):
    bodies = {"shape": "solid" if kind == "plate" else "disc"}
    scene = TRAY | {"contact_force": force, "bodies": bodies, "support": {"kind": kind}}
    scene["launches"] = [TRAY["launches"][0] | {"velocity": [0.6, 0.0]}, TRAY["launches"][1]]
    events = check_scene(scene, "scene").draw().solve().events
    first, last = (events[events["kind"] == kind].iloc[0] for kind in ("contact", "contact_end"))
    assert 1e-4 < last["t_s"] - first["t_s"] < 3e-3
    assert first["impulse_n"] > 0
