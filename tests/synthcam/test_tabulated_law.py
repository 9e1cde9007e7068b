"""Laws from tables, against closed forms of the motion."""

import pickle

import numpy as np
import pytest
from scipy.integrate import quad

from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.model import Model, build_model, list_model_settings, read_model, write_model
from synthcam.scene.scene import check_scene
from synthcam.table import SmoothTable
from synthcam.tabulated_law import SEARCH_ONLY_LAWS, TABLE_KINDS, TabulatedLaw, kind_of, table_names
from synthcam_shared.errors import InputError

G = Model().gravity


def held(numbers=None, **tables):
    """A model with these tables, of pairs (x, y), as from a file."""
    model = Model() if numbers is None else Model(**numbers)
    laws = {k: {"x": np.asarray(x).tolist(), "y": np.asarray(y).tolist()} for k, (x, y) in tables.items()}
    return build_model(list_model_settings(model) | {"free_laws": laws})


def hit(model, v0=0.5, b=0.0, labels="ab", heading=0.0):
    launch = Launch.pair(model.bodies(labels), time=0.0, v0=v0, b=b, heading=heading, contact=(0.0, 0.0))
    return solve(model, launch, -0.01, 0.6)


def slide_ends(motion):
    return {e.i: e.t for e in motion.events if e.kind == "slide_end"}


def rolls(model, v0=0.3, until=0.6):
    """Speeds of one ball that rolls along x from t = 0."""
    launch = Launch.single(model.bodies("a"), 0.0, v0, 0.0, (0.0, 0.0))
    times = np.linspace(0, until, 31)
    return times, solve(model, launch, 0.0, until).at(times)[0, :, 3]


def test_friction_that_grows_with_the_slip_ends_the_slide_as_it_must():
    m0, m1 = (
        0.2,
        0.3,
    )  # a target that the impact does not spin: du/dt = -(7/2) g (m0 + m1 u), so T = ln(1 + m1 u/m0) / ((7/2) g m1)
    speeds = np.linspace(0, 1, 9)
    model = held({"spin_transfer": 0.0}, friction_speed=(speeds, m0 + m1 * speeds))
    slip = (1 + model.restitution) / 2 * 0.5
    assert slide_ends(hit(model))[0] == pytest.approx(np.log(1 + m1 * slip / m0) / (3.5 * G * m1), rel=1e-6)


def test_a_rough_table_is_smooth_enough_to_be_integrated():
    rng = np.random.default_rng(3)
    x, y = np.linspace(0, 0.6, 25), rng.uniform(0.15, 0.3, 25)
    model = held({"spin_transfer": 0.0}, friction_speed=(x, y))
    slip = (1 + model.restitution) / 2 * 0.5
    curve = SmoothTable(tuple(x.tolist()), tuple(y.tolist()))
    expected = quad(lambda u: 1 / (3.5 * G * float(curve(np.array(u)))), 0, slip, limit=500, epsabs=1e-12)[0]
    assert slide_ends(hit(model))[0] == pytest.approx(expected, rel=1e-9)


def test_beyond_its_ends_a_curve_stays_as_it_is_there():
    model = held({"spin_transfer": 0.0}, friction_speed=((0.0, 0.01), (0.3, 0.3)))
    slip = (1 + model.restitution) / 2 * 0.5
    assert slide_ends(hit(model))[0] == pytest.approx(slip / (3.5 * G * 0.3), rel=1e-6)


@pytest.mark.parametrize("ball", ["a", "b"])
def test_a_curve_of_one_ball_leaves_the_other(ball):
    model = held(**{f"friction_speed_{ball}": ((0.0, 1.0), (0.1, 0.1))})
    slides, plain = slide_ends(hit(model, labels="ab")), slide_ends(hit(Model(), labels="ab"))
    own = "ab".index(ball)
    assert slides[own] == pytest.approx(plain[own] * Model().sliding_friction / 0.1, rel=1e-6)
    assert slides[1 - own] == pytest.approx(plain[1 - own], rel=1e-9)


def test_a_rolling_loss_of_a_table_stands_in_place_of_both_numbers():
    times, speed = rolls(held(rolling_speed=((0.0, 0.1, 0.2, 1.0), (0.2, 0.2, 0.2, 0.2))))
    np.testing.assert_allclose(speed, 0.3 - 0.2 * times, rtol=1e-7)


def test_a_force_in_proportion_to_the_speed_makes_it_fall_exponentially():
    model = held({"rolling_drag": 0.0, "rolling_decel": 0.0}, force_speed=((0.0, 1.0), (0.0, -0.7)))
    times, speed = rolls(model)
    np.testing.assert_allclose(speed, 0.3 * np.exp(-5 / 7 * 0.7 * times), rtol=1e-7)


def test_a_force_over_the_heading_acts_along_and_across():
    turn = np.linspace(-np.pi, np.pi, 9)
    model = held({"rolling_drag": 0.0, "rolling_decel": 0.0}, force_heading=(turn, [[-0.7, 0.35]] * 9))
    launch = Launch.single(model.bodies("a"), 0.0, 0.3, 0.0, (0.0, 0.0))
    vx, vy = solve(model, launch, 0.0, 0.5).at(np.array([0.5]))[0, 0, 3:5]
    assert np.hypot(vx, vy) == pytest.approx(0.3 * np.exp(-5 / 7 * 0.7 * 0.5), rel=1e-7)
    assert np.arctan2(vy, vx) == pytest.approx(5 / 7 * 0.35 * 0.5, rel=1e-7)


@pytest.mark.gate
def test_a_map_of_forces_is_a_well():
    side = np.linspace(-0.1, 0.1, 5)
    x, y = (s.ravel() for s in np.meshgrid(side, side))
    k = 7 / 5 * 25.0  # x'' = -25 x: a quarter of a period takes pi / 10
    well = np.stack([x, y], axis=1), np.stack([-k * x, -k * y], axis=1)
    model = held({"rolling_drag": 0.0, "rolling_decel": 0.0}, force_place=well)
    times, speed = rolls(model, 0.3, 0.25)
    np.testing.assert_allclose(speed, 0.3 * np.cos(5 * times), atol=1e-7)


def test_a_rolling_loss_of_two_parts_has_the_second_at_its_pace():
    turn = np.linspace(-np.pi, np.pi, 9)
    model = held({"rolling_drag": 0.0, "rolling_decel": 0.0}, rolling_heading=(turn, [[0.0, 0.05]] * 9))
    times, speed = rolls(model)
    np.testing.assert_allclose(speed, 0.3 * np.exp(-0.5 * times), rtol=1e-7)  # .05 m/s^2 at .1 m/s


@pytest.mark.parametrize(
    ("law", "at", "turn"),
    [
        ("restitution_speed", 0.5 * 0.8, False),
        ("restitution_obliqueness", 0.6, False),
        ("restitution_heading", 0.7, True),
    ],
)
def test_restitution_is_that_of_the_table_at_the_impact(law, at, turn):
    x = np.linspace(-np.pi, np.pi, 73) if turn else np.linspace(0, 1, 11)

    def value(x):
        return 0.8 + 0.1 * np.cos(x) if turn else 0.9 - 0.2 * x**2

    motion = hit(held(**{law: (x, value(x))}), b=0.6, heading=0.7)
    (contact,) = (e for e in motion.events if e.kind == "contact")
    before, after = ((s[0, 3:5] - s[1, 3:5]) @ np.array(contact.n) for s in (contact.before, contact.after))
    assert -after / before == pytest.approx(value(at), abs=1e-6)


def test_what_an_effect_multiplies_is_the_law_of_the_table():
    both = held(friction_speed=((0.0, 1.0), (0.1, 0.1))).replace({"friction_mismatch.excess": 1.0})
    slides, plain = slide_ends(hit(both)), slide_ends(hit(Model()))
    assert slides[0] == pytest.approx(plain[0] * Model().sliding_friction / 0.2, rel=1e-6)  # ball a


def test_it_survives_yaml_also_where_its_number_was_changed(tmp_path):
    model = held(friction_speed=((0.0, 0.5, 1.0), (0.2, 0.25, 0.3)), rolling_speed=((0.0, 1.0), (0.1, 0.4)))
    write_model(model, tmp_path / "m.yaml")
    assert read_model(tmp_path / "m.yaml") == model == pickle.loads(pickle.dumps(model))
    pairs = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
    map_ = held(friction_place=(pairs, [0.2, 0.2, 0.3, 0.4])).replace({"sliding_friction": 0.242})
    np.testing.assert_allclose(list_model_settings(map_)["free_laws"]["friction_place"]["y"], [0.21, 0.21, 0.31, 0.41])
    raised = model.replace({"sliding_friction": model.sliding_friction + 0.01, "rolling_drag": 0.235})
    write_model(raised, tmp_path / "raised.yaml")
    again = read_model(tmp_path / "raised.yaml")
    tables = {e.law: e.table.y for e in again.effects}
    np.testing.assert_allclose(tables["friction_speed"], [0.21, 0.26, 0.31], rtol=1e-14)
    np.testing.assert_allclose(tables["rolling_speed"], [0.1, 0.5], rtol=1e-14)
    assert slide_ends(hit(again)) == pytest.approx(slide_ends(hit(raised)), rel=1e-12)


@pytest.mark.parametrize("law", ["friction_speed", "rolling_speed_a", "force_speed_b", "restitution_obliqueness"])
def test_many_collisions_at_once_move_as_one_does(law):
    x = np.linspace(0, 1, 9)
    model = held(**{law: (x, 0.2 + 0.1 * np.sin(3 * x))})
    times = np.linspace(-0.01, 0.3, 40)
    many = solve_collisions(model, np.array([[0.0, 0.0, 0.0, 0.5, 0.0, 0.3]]), -0.01, 0.3).at(times)[:, 0]
    np.testing.assert_allclose(many, hit(model, b=0.3).at(times), atol=1e-9)
    assert np.abs(many - hit(Model(), b=0.3).at(times)).max() > 1e-4


def test_a_scene_simulates_with_it():
    scene = check_scene({"free_laws": {"restitution_speed": {"x": [0.0, 1.0], "y": [0.5, 0.5]}}}, "here")
    assert scene.draw().truth["r"] == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize(
    ("law", "values", "said"),
    [
        ("friction_sped", {"x": [0, 1], "y": [1, 1]}, "did you mean free_laws.friction_speed"),
        ("friction_place_a", {"x": [0, 1], "y": [1, 1]}, "unknown key"),
        ("friction_speed", {"x": [1, 0], "y": [1, 1]}, "friction_speed: .*x: expected rising"),
        ("friction_speed", {"x": [0, 1], "y": [1, -1]}, "y: expected numbers of 0 or more, found -1"),
        ("spin_transfer_speed", {"x": [0, 1], "y": [0, 0.8]}, "y: expected numbers from 0 to 0.714"),
        ("rolling_heading", {"x": [0, 1, 2], "y": [1, 1, 1]}, "y: expected pairs, m/s\\^2"),
        ("friction_place", {"x": [0, 1], "y": [1, 1]}, "x: expected pairs, m"),
        ("friction_speed", {"x": [0, 1]}, "free_laws.friction_speed.y: required key is missing"),
        ("lag_speed", {"x": [0, 1], "y": [1, 1]}, "free_laws.lag_speed: of the instrument"),
        ("restitution_clip", {"x": [0, 1], "y": [1, 1]}, "another number in each clip; .*distribution"),
    ],
)
def test_what_is_no_free_law_is_one_line(tmp_path, law, values, said):
    file = tmp_path / "m.yaml"
    file.write_text(f"free_laws: {{{law}: {values}}}".replace("'", ""))
    for read in (read_model, lambda path: check_scene({"free_laws": {law: values}}, str(path))):
        with pytest.raises(InputError, match=f"m.yaml: .*{said}") as error:
            read(file)
        assert "\n" not in str(error.value)


def test_every_name_has_a_kind_and_a_law_of_one_ball_is_that_balls():
    every = list(table_names())
    assert {"friction_speed", "friction_speed_a", "force_place_b", "rolling_place"} <= set(every)
    assert not set(every) & set(SEARCH_ONLY_LAWS)
    assert kind_of("rolling_speed_b") == (TABLE_KINDS["rolling_speed"], "b")
    with pytest.raises(KeyError):
        kind_of("restitution_speed_a")
    assert all(TabulatedLaw(n, None).name() == n for n in every)
