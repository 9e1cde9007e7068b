"""The truth's numbers, each worked out another way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.dynamics.kinematics import contact_velocity, rolling_state, rolling_velocity
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effects.velocity_restitution import VelocityRestitution
from synthcam.model import Model
from synthcam.scene import ground_truth
from synthcam.scene.film_time import FilmedMotion
from synthcam.scene.scene import Scene, check_scene

R = Model().ball.radius
PAIR, ALONE = Model().bodies("ab"), Model().bodies("b")
G = 9.81
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)


def camera(**changes):
    settings = {"size": (640, 480), "scale": 1.6e-4, "height": 0.5, "ball_radius": R}
    return PinholeCamera.overhead(**settings | {"fps": 250, "exposure": 5e-4, "psf_sigma_px": 1.0} | changes)


def scalars(model, launch, end=0.3):
    return ground_truth.make_true_scalars(model, launch, solve(model, launch, 0.0, end))


@given(
    st.floats(0.5, 1),
    st.floats(0, 0.45),
    st.floats(0.1, 0.4),
    st.floats(0.05, 0.6),
    st.floats(-0.9, 0.9),
    st.floats(0, 6),
)
@settings(max_examples=60)
def test_scalars_of_an_oblique_collision(r, c, mu, v0, b, heading):
    """Everything from the contract's formulas in the frame of n and t, by hand."""
    row = scalars(
        Model(restitution=r, spin_transfer=c, sliding_friction=mu), Launch.pair(PAIR, 0.1, v0, b, heading, (0, 0))
    )
    d = np.array([np.sqrt(1 - b * b), b])  # along n and t: b = z . [d x (x2 - x1)] / 2R with x2 - x1 = -2R n
    w0 = np.array([-d[1], d[0]]) * v0 / R  # of the roller, along n and t
    kick = np.array([(1 + r) / 2 * d[0], 0.4 * c * d[1]]) * v0
    v1, v2 = kick, v0 * d - kick
    w1, w2 = np.array([0, -c * w0[1]]), np.array([w0[0], (1 - c) * w0[1]])
    finals, taus = [], []
    for v, w in ((v1, w1), (v2, w2)):
        u = v - R * np.array([w[1], -w[0]])
        taus.append(np.hypot(*u) / (3.5 * mu * G))
        finals.append(v - 2 / 7 * u)
    expected = {
        "v0": v0,
        "b": b,
        "t_c": 0.1,
        "r": r,
        "C": c,
        "mu_k": mu,
        "tau1": taus[0],
        "tau2": taus[1],
        "v1f": np.hypot(*finals[0]),
        "v2f": np.hypot(*finals[1]),
        "energy_fraction": (finals[0] @ finals[0] + finals[1] @ finals[1]) / v0**2,
        "momentum_fraction": (finals[0] + finals[1]) @ d / v0,
        "w1n": w1[0],
        "w1t": w1[1],
        "w2n": w2[0],
        "w2t": w2[1],
    }
    for name, value in expected.items():
        size = v0 / R if name.startswith("w") else 1.0
        assert row[name] == pytest.approx(value, rel=1e-11, abs=1e-12 * size), name
    if abs(b) > 1e-3:
        assert row["s"] == pytest.approx(1 - 0.8 * c, rel=1e-9)
    if min(np.hypot(*f) for f in finals) > 1e-6:
        cosine = finals[0] @ finals[1] / np.hypot(*finals[0]) / np.hypot(*finals[1])
        assert np.cos(row["final_angle"]) == pytest.approx(cosine, abs=1e-12)


def test_the_papers_figures():
    row = scalars(Model(), Launch.pair(PAIR, 0.1, 0.2, 0, 0, (0, 0)))
    assert row["v1f"] / 0.2 == pytest.approx(0.5805, abs=5e-5)
    assert row["v2f"] / 0.2 == pytest.approx(0.2212, abs=5e-5)
    assert row["energy_fraction"] == pytest.approx(0.386, abs=5e-4)
    assert row["momentum_fraction"] == pytest.approx(0.802, abs=5e-4)
    assert np.isnan(row["s"])
    assert row["final_angle"] == pytest.approx(0, abs=1e-12)


def test_the_angle_in_free_space():
    """The paper's cos theta_f, just after a collision that passes on no spin."""
    for r, b in ((0.903, 0.25), (0.9, 0.096), (1.0, 0.5)):
        model = Model(restitution=r, spin_transfer=0)
        after = solve(model, Launch.pair(PAIR, 0.1, 0.3, b, 0, (0, 0)), 0.0, 0.2).first("contact").after[:, 3:5]
        q = 1 - b * b
        cosine = (1 - r) * q / np.sqrt(((1 - r) ** 2 * q + 4 * b * b) * q)
        assert after[0] @ after[1] / np.prod(np.hypot(*after.T)) == pytest.approx(cosine, abs=1e-12)


def test_no_slide_is_tau_0():
    """A ball struck without spin along its roll keeps rolling: head-on at r = -1 + 2C there is no slip; here b -> 1."""
    row = scalars(Model(restitution=0, spin_transfer=0), Launch.pair(PAIR, 0.1, 0.3, 0.9999999999999999, 0, (0, 0)))
    assert row["tau1"] < 1e-8
    assert row["tau2"] < 1e-8
    assert row["v2f"] == pytest.approx(0.3)


def test_relaxation_beyond_the_clip():
    clip = check_scene({"timing": {"frames": 27, "contact_frame": 25.3}, "launch": {"v0": 0.6, "b": 0.2}}, "x").draw(
        0, 0
    )
    short = scalars(clip.model, clip.launch, 27 / 250)
    long = scalars(clip.model, clip.launch, 0.5)
    assert short["tau1"] > 27 / 250 - short["t_c"]
    assert short == pytest.approx(long, rel=1e-12, nan_ok=True)
    late = solve(clip.model, clip.launch, 0.0, 27 / 250)
    assert late.t1 > 27 / 250
    view = FilmedMotion.solve(clip.model, clip.launch, clip.camera, 27)
    assert ground_truth.make_true_tracks(clip.launch.bodies, view, clip.lamp, 27)["t_s"].max() < 27 / 250


def test_both_moving():
    """Ball 2 is the faster; fractions lean on both initial velocities."""
    one = rolling_state(np.array([0.0, 0.0]), np.array([0.1, 0.05]), 0.0, R)
    two = rolling_state(np.array([-0.02, 0.001]), np.array([0.5, 0.05]), 0.0, R)
    launch = Launch(0.0, np.stack([one, two]), PAIR)
    model = Model(rolling_drag=0, rolling_decel=0)
    motion = solve(model, launch, 0.0, 0.5)
    row = ground_truth.make_true_scalars(model, launch, motion)
    hit = motion.first("contact")
    finals = np.array([motion.first("slide_end", k).after[0, 3:5] for k in (0, 1)])
    total = np.array([0.6, 0.1])
    assert row["v0"] == pytest.approx(0.4)
    assert row["momentum_fraction"] == pytest.approx(finals.sum(0) @ total / (total @ total))
    assert row["energy_fraction"] == pytest.approx((finals**2).sum() / (0.1**2 + 2 * 0.05**2 + 0.5**2))
    assert row["b"] == pytest.approx((0.001) / (2 * R), rel=1e-9)
    assert hit.i == 0


def test_r_is_the_balls_own_at_the_instant():
    model = Model(effects=(VelocityRestitution(e=0.2),))
    for b in (0.0, 0.5):
        row = scalars(model, Launch.pair(PAIR, 0.1, 0.2, b, 0.3, (0, 0)))
        assert row["r"] == pytest.approx(1 - 0.097 * (0.2 * np.sqrt(1 - b * b) / 0.3) ** 0.2, rel=1e-12)


def test_without_a_collision():
    row = scalars(Model(), Launch.single(ALONE, 0.1, 0.2, 0.3, (0, 0)))
    assert row["v0"] == pytest.approx(0.2)
    assert (row["mu_k"], row["drag"], row["decel"]) == (0.232, 0.135, 0.0103)
    assert all(np.isnan(row[k]) for k in set(ground_truth.COLLISION_COLUMNS) - {"v0", "mu_k", "drag", "decel"})


@pytest.mark.parametrize("exposure", [5e-4, 4e-3])
@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.2, 0.05, 1e-3, -1e-3, 0.0)])
def test_the_mean_over_the_exposure(exposure, distortion):
    seen = camera(exposure=exposure, distortion=distortion, tilt=(0.05, -0.02))
    t_c = (10 + 0.4 * exposure * 250) / 250  # within frame 10's exposure
    motion = solve(Model(), Launch.pair(PAIR, t_c, 0.6, 0.3, 0.7, (0.01, 0.0)), 0.0, 0.4)
    table = ground_truth.make_true_tracks(PAIR, FilmedMotion(Model(), seen, motion), LAMP, 40)
    slides = [e.t for e in motion.events if e.kind == "slide_end"]
    frames = [0, 9, 10, 11, *(int(t * 250) for t in slides)]
    for k in frames:
        n = 20000
        times = k / 250 + (np.arange(n) + 0.5) / n * exposure
        px = seen.project(motion.at(times)[:, :, :3]).mean(axis=1)
        rows = table[table.frame == k]
        np.testing.assert_allclose(rows[["x_mean_px", "y_mean_px"]], px, rtol=0, atol=2e-7)
    hit = table[(table.frame == 10)]
    if exposure == 4e-3:  # the frame that holds the contact: its middle is not its mean
        assert np.abs(hit.x_mean_px - hit.x_px).max() > 0.1


def test_no_exposure_has_its_instant_for_a_mean():
    motion = solve(Model(), Launch.pair(PAIR, 0.04, 0.6, 0.3, 0.7, (0, 0)), 0.0, 0.4)
    table = ground_truth.make_true_tracks(PAIR, FilmedMotion(Model(), camera(exposure=0.0), motion), LAMP, 20)
    np.testing.assert_allclose(table.x_mean_px, table.x_px, rtol=0, atol=1e-10)
    np.testing.assert_allclose(table.t_s[:20], np.arange(20) / 250, rtol=0, atol=1e-15)


def test_tracks_columns_and_states():
    motion = solve(Model(), Launch.pair(PAIR, 0.1, 0.3, 0.2, 0.0, (0, 0)), 0.0, 0.4)
    table = ground_truth.make_true_tracks(PAIR, FilmedMotion(Model(), camera(), motion), LAMP, 100)
    columns = "frame t_s particle x_px y_px glint_x_px glint_y_px x y z vx vy vz wx wy wz"
    columns += " x_mean_px y_mean_px state visible hidden"
    assert list(table) == columns.split()
    assert len(table) == 200
    target, striker = (table[table.particle == k] for k in (0, 1))
    np.testing.assert_allclose(target.t_s, np.arange(100) / 250 + 2.5e-4)
    assert set(target.state[:25]) == {"rest"}
    assert set(striker.state[:25]) == {"roll"}
    assert target.state.iloc[25] == striker.state.iloc[25] == "slide"
    assert target.state.iloc[99] == "roll"
    np.testing.assert_allclose(table.x_px, 319.5 + table.x / 1.6e-4, rtol=0, atol=1e-6)
    np.testing.assert_allclose(table.y_px, 239.5 - table.y / 1.6e-4, rtol=0, atol=1e-6)
    states = table[["x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz"]].to_numpy()
    rolls = (table.state == "roll").to_numpy()
    np.testing.assert_allclose(contact_velocity(states[rolls], R), 0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(rolling_velocity(states[rolls], R), states[rolls][:, 3:5], rtol=0, atol=1e-15)


def test_visible_means_the_whole_ball():
    """By column: a ball of 7.44 px radius is whole between 6.94 and 631.06 px from the left.

    The upper rim of a disc of 2 mm is 1 mm nearer to the camera, and 0.6 px farther out at the edge of the picture.
    """
    places = ((7.0, True), (6.8, False), (632.0, True), (632.2, False), (-50, False), (900, False))
    discs = ((7.7, True), (7.4, False), (631.3, True), (631.6, False))
    for x, seen, height in [(*one, 0.0) for one in places] + [(*one, 2e-3) for one in discs]:
        position = ((x - 319.5) * 1.6e-4, 0.0)
        motion = solve(Model(rolling_decel=0), Launch.single(ALONE, 0.0, 1e-9, 0, position), 0.0, 0.01)
        view = FilmedMotion(Model(), camera(), motion)
        row = ground_truth.make_true_tracks(ALONE, view, LAMP, 1, heights=np.array([height])).iloc[0]
        assert row.visible == seen
        assert np.isnan(row.glint_x_px) == np.isnan(row.glint_y_px) == (height > 0)


def test_events_table():
    motion = solve(Model(), Launch.pair(PAIR, 0.1, 0.3, 0.2, 0.4, (0, 0)), 0.0, 0.4)
    table = ground_truth.make_true_events(motion, 250)
    assert list(table) == "t_s frame_float kind i j nx ny impulse_n impulse_t".split()
    hit = table.iloc[0]
    mass = 7800 * np.pi / 6 * 2.38e-3**3
    assert (hit.kind, hit.i, hit.j) == ("contact", 0, 1)
    assert hit.frame_float == pytest.approx(25)
    assert hit.impulse_n == pytest.approx(mass * 1.903 / 2 * 0.3 * np.sqrt(1 - 0.04))
    assert hit.impulse_t == pytest.approx(mass * 0.4 * 0.347 * 0.3 * 0.2)
    assert sorted(table.kind[1:]) == ["slide_end", "slide_end"]
    assert (table.j[1:] == -1).all()
    assert table.impulse_n[1:].isna().all()
    alone = solve(Model(), Launch.single(ALONE, 0.1, 0.3, 0.4, (0, 0)), 0.0, 0.4)
    assert ground_truth.make_true_events(alone, 250).dtypes.to_dict() == table.dtypes.to_dict()


PUCKS = {
    "ball": {"diameter": 0.06, "density": 1000},
    "model": {"restitution": 0.8, "spin_transfer": 0},
    "bodies": {"shape": "disc", "mass": 0.02},
    "support": {"kind": "air", "decel": 0.1},
    "launches": [
        {"position": [0.0, 0.0]},
        {"position": [-0.3, 0.0], "velocity": [1.0, 0.0]},
        {"position": [0.3, 0.2], "push": {"until": 0.1, "acceleration": [-2.0, 0.0]}},
    ],
    "walls": [{"start": [0.2, 0.5], "end": [0.2, -0.1]}],
    "camera": {"scale": 2.5e-3, "height": 2.0},
}


THREE = [
    {"position": [0.0, 0.0], "velocity": [0.3, 0.0]},
    {"position": [0.004, 0.0003]},
    {"position": [0.0066, 0.0002], "velocity": [0.0, 0.05]},
]
DISCS = {
    "ball": {"diameter": 0.06, "density": 1000},
    "bodies": {"shape": "disc", "mass": 0.02},
    "model": {"restitution": 0.8, "spin_transfer": 0.1},
    "camera": {"scale": 0.0025, "height": 2.0},
    "launches": [
        {"position": [0.0, 0.0], "velocity": [0.6, 0.0]},
        {"position": [0.1, 0.02]},
        {"position": [0.3, 0.05], "velocity": [-0.7, 0.0], "time": 0.1},
    ],
}
TAPE = {**DISCS, "bodies": [{"shape": "disc", "mass": 0.02, "sticks": 0.004}] * 3}
NOSE = {"start": [0.01, -0.1], "end": [0.01, 0.1], "restitution": 0.8, "friction": 0.2, "height": 1.6e-3}
TABLES = {
    "spring": {"launches": THREE[:2], "contact_force": {"law": "linear", "duration": 2e-3}},
    "hertz": {"launches": THREE[:2], "contact_force": {"law": "hertz", "modulus": 1e6}},
    "spring on air": {**DISCS, "support": {"kind": "air"}, "contact_force": {"law": "linear", "duration": 5e-3}},
    "tape on air": {**TAPE, "support": {"kind": "air", "decel": 0.02}},
    "tape on a dry plate": {**TAPE, "support": {"kind": "dry"}},
    "hop": {"launches": THREE, "effects": {"hop": {"share": 1.0, "bounce": 0.3}}},
    "flight": {"launches": [{"position": [0, 0], "velocity": [0.2, 0.0], "height": 0.002}], "walls": [NOSE]},
    "cushion": {"launches": THREE, "walls": [{**NOSE, "cushion": "mathavan"}]},
    "effects": {"launches": THREE, "effects": {"air_drag": {"share": 5.0}, "stribeck": {"rise": 0.5}}},
    "drawn contacts": {"launches": THREE, "scatter": {"restitution": 0.05, "friction": 0.2, "normal": 0.01}},
}


@pytest.mark.parametrize("name", ["tray", "pool", "pucks", "slide", *TABLES])
def test_the_energy_lost_is_what_contacts_walls_plate_and_air_took(name):
    timing = {"timing": {"frames": 60, "fps": 50, "exposure": 0.0}}
    slides = {"launches": [{"position": [0.0, 0.0], "velocity": [0.5, 0.0], "slip": [0.5, 0.0]}]}
    some = {"tray": Scene.read("tray", **timing), "pool": Scene.read("break", **timing)}
    made = {"pucks": PUCKS, "slide": slides, **TABLES}
    clip = (some.get(name) or check_scene({"name": name, **made.get(name, {}), **timing}, name)).draw(seed=1)
    table, bodies = clip.energy, clip.launch.bodies
    lost = table.filter(like="lost").sum(axis=1) - table["given_by_hand"]
    states = clip.launch.states
    first = 0.5 * bodies.mass @ (states[:, 3:5] ** 2).sum(axis=1)
    first += 0.5 * (bodies.mass * bodies.inertia * bodies.radius**2) @ (states[:, 6:] ** 2).sum(axis=1)
    first += 9.81 * bodies.mass @ (states[:, 2] - bodies.radius)
    np.testing.assert_allclose(table["energy"] + lost, first, rtol=1e-9)
    assert (table.filter(like="lost").diff().iloc[1:] > -1e-9 * first).all(axis=None)
    if name == "pucks":  # the first hit is head on, of 1 m/s less the air's share: it takes (1 - r^2)/4 m v^2
        hit = clip.solve().events.query("kind == 'contact'")["t_s"].iloc[0]
        before = table["lost_in_contacts"][table["t_s"] > hit].iloc[0]
        assert before == pytest.approx((1 - 0.8**2) / 4 * 0.02 * (1 - 2 * 0.1 * 0.24), rel=1e-9)
        assert table["given_by_hand"].iloc[-1] == pytest.approx(0.02 / 2 * 0.2**2, rel=1e-9)
        assert table["lost_by_sliding"].iloc[-1] == 0
    if name == "slide":  # 2/7 of the energy of a ball that starts without spin
        assert table["lost_by_sliding"].iloc[-1] == pytest.approx(2 / 7 * bodies.mass[0] / 2 * 0.5**2, rel=1e-9)
