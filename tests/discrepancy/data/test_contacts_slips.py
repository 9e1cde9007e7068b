"""Spins and slides that are traced through the contacts of a crowd against those of the simulation."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.search.crowd_laws import make_tray
from discrepancy.data.slips import find_wall_normals, trace_slips
from synthcam import Scene

AXES = (("1i", "j", "before"), ("2i", "i", "before"), ("1o", "j", "after"), ("2o", "i", "after"))


@pytest.fixture(scope="module")
def truth():
    """Contacts of a simulated crowd of balls."""
    return solve_contacts(Scene.read("crowd", timing={"frames": 100}).draw(seed=2), radius=0.00119)


def solve_contacts(clip, radius):
    """Contacts of a clip: rows of estimates without errors, contacts.parquet, and the true slips."""
    motion = clip.solve()
    every = motion.events[motion.events.kind.isin(["contact", "wall"])].reset_index(drop=True)
    every = every.assign(collision=np.where(every.kind == "contact", (every.kind == "contact").cumsum() - 1, -1))
    events = every[every.kind == "contact"].reset_index(drop=True)
    rows, slips = [], []
    for number, event in enumerate(events.itertuples()):
        states = {
            name: motion.at([time]).set_index("particle")
            for name, time in (("before", event.t_s - 1e-9), ("after", event.t_s))
        }
        row = {"collision": number}
        for column, ball, side in AXES:
            state = states[side].loc[getattr(event, ball)]
            row |= {f"v{column}x_local": state.vx, f"v{column}y_local": state.vy}
        one, two = (states["before"].loc[ball] for ball in (event.j, event.i))
        normal = np.array([one.x - two.x, one.y - two.y])
        normal /= np.hypot(*normal)
        tangent = np.array([-normal[1], normal[0]])
        into = np.array([two.vx - one.vx, two.vy - one.vy])
        out = np.array([row[f"v1o{axis}_local"] - row[f"v2o{axis}_local"] for axis in "xy"])
        v0 = np.hypot(*into)
        row |= {"v0_local": v0, "b_local": into @ tangent / v0, "r_local": out @ normal / (into @ normal)}
        rows.append(row | {f"{name}_std": 1e-9 for name in row if name.endswith("_local")})
        spins = one[["wx", "wy"]] + two[["wx", "wy"]]
        vertical = radius * (spins.wx * normal[1] - spins.wy * normal[0])
        across = into @ tangent + radius * (one.wz + two.wz)
        sign = 1 if into @ tangent >= 0 else -1
        slips.append(
            (sign * across, np.hypot(across, vertical), event.impulse_t, event.impulse_n, radius * (one.wz + two.wz))
        )
    return rows, list_contacts(motion, every, clip.model), np.array(slips)


def list_contacts(motion, events, model):
    """The columns of contacts.parquet, without errors."""
    found = []
    for event in events.itertuples():
        wall = event.kind == "wall"
        ball = event.i if wall else event.j
        before, after = (motion.at([t]).set_index("particle").loc[ball] for t in (event.t_s - 1e-9, event.t_s))
        change = np.array([after.vx - before.vx, after.vy - before.vy])
        along = change / np.hypot(*change)
        row = {"t_s": event.t_s, "collision": event.collision, "particle1": ball, "particle2": -1 if wall else event.i}
        row |= {"x": before.x, "y": before.y, "nx": along[0], "ny": along[1]}
        found.append(row | {"kick": np.hypot(*change), "kick_std": 1e-9, "mu_k": model.sliding_friction})
    return pd.DataFrame(found)


def test_slips_are_those_of_the_simulation(truth):
    rows, table, true = truth
    found = trace_slips(rows, table)
    assert np.abs(true[:, 4]).max() > 0.02  # m/s: some balls turn
    across = np.array([found[k].across for k in range(len(rows))])
    assert across == pytest.approx(true[:, 0], abs=1e-6)
    friction = np.array([found[k].friction for k in range(len(rows))])
    assert np.abs(friction) == pytest.approx(np.abs(true[:, 2] / true[:, 3]), rel=1e-3, abs=1e-6)


def test_discs_slip_in_the_plane_alone_and_turn_as_discs():
    clip = Scene.read("pucks", timing={"frames": 150}, walls=[]).draw(seed=2)
    rows, table, true = solve_contacts(clip, radius=0.03)
    found = trace_slips([row | {"motion_local": "glide"} for row in rows], table)
    assert np.abs(true[:, 4]).max() > 0.02  # m/s: some discs turn
    assert [found[k].across for k in range(len(rows))] == pytest.approx(true[:, 0], abs=1e-6)
    assert [found[k].size for k in range(len(rows))] == pytest.approx(true[:, 1], abs=1e-6)


def test_balls_that_still_slide_slip_less_along_the_vertical(truth):
    """A kick changes the velocity of a ball, not its rotation, until the plate makes it roll."""
    rows, table, true = truth
    found = trace_slips(rows, table)
    down, down_std = (np.array([getattr(found[k], name) for k in range(len(rows))]) for name in ("down", "down_std"))
    off = np.abs(np.abs(down) - np.sqrt(true[:, 1] ** 2 - true[:, 0] ** 2))
    assert off.max() < 0.012
    assert (off < 2 * down_std + 1e-3).all()
    as_if_rolling = [find_vertical_speed_of_rolling_balls(row) for row in rows]
    assert np.abs(np.abs(as_if_rolling) - np.abs(down)).max() > 0.1


def find_vertical_speed_of_rolling_balls(row):
    v0, b = row["v0_local"], row["b_local"]
    one, two = (np.array([row[f"v{k}{axis}_local"] for axis in "xy"]) for k in ("1i", "2i"))
    heading = (two - one) / v0
    return (one + two) @ (np.sqrt(1 - b**2) * heading + b * np.array([heading[1], -heading[0]]))


@pytest.fixture(scope="module")
def tray():
    """Contacts of a tray with straight walls, whose friction turns the balls."""
    return solve_contacts(make_tray(balls=36, frames=100).draw(seed=4), radius=0.00119)


def test_hits_in_a_line_show_the_normal_of_a_wall(tray):
    _, table, _ = tray
    normals = find_wall_normals(table, 0.00238)
    hits = table.sort_values("t_s").reset_index(drop=True).loc[list(normals)]
    assert len(hits) >= 10
    for (normal, error), x, y in zip(normals.values(), hits["x"], hits["y"], strict=True):
        side = abs(x) > 0.0237  # walls at 25 mm and 18 mm from the middle
        inwards = (-np.sign(x), 0.0) if side else (0.0, -np.sign(y))
        assert normal == pytest.approx(inwards, abs=1e-3)
        assert error < 1e-2
    angle = np.arange(len(table)) * 1.0
    place = {"x": 0.02 * np.cos(angle), "y": 0.02 * np.sin(angle), "nx": -np.cos(angle), "ny": -np.sin(angle)}
    assert not find_wall_normals(table.assign(**place), 0.00238)  # a round wall


def test_the_friction_of_a_wall_turns_balls(tray):
    rows, table, true = tray
    known, unknown = trace_slips(rows, table, 0.00238), trace_slips(rows, table)
    hit = [k for k, slip in unknown.items() if slip.across_std > 1e-3]
    traced = [k for k in hit if known[k].across_std < 1e-3]
    assert len(traced) >= 4
    assert [known[k].across for k in traced] == pytest.approx(true[traced, 0], abs=2e-3)
    assert max(abs(unknown[k].across - true[k, 0]) for k in traced) > 0.05


def test_more_friction_than_stops_the_slip_shows_a_third_body(truth):
    """The spin that it gives a ball is not known."""
    rows, table, _ = truth
    turned = next(k for k in range(len(rows)) if set(find_balls(table, k)) & set(find_balls(table, k + 1)))
    row = dict(rows[turned])
    along = 0.3 * np.array([rows[turned]["v1iy_local"], -rows[turned]["v1ix_local"]])
    for k, axis in enumerate("xy"):
        row[f"v1o{axis}_local"] += along[k]
    hit = trace_slips([row if k == turned else each for k, each in enumerate(rows)], table)
    assert trace_slips(rows, table)[turned + 1].across_std < 1e-6
    assert hit[turned + 1].across_std > 0.01


def find_balls(table, collision):
    return table.loc[table["collision"] == collision, ["particle1", "particle2"]].to_numpy()[0].tolist()


def test_a_contact_without_an_estimate_leaves_the_spin_uncertain(truth):
    rows, table, true = truth
    turned = int(np.argmax(np.abs(true[:, 4])))
    balls = set(table.loc[turned, ["particle1", "particle2"]])
    before = max(k for k in range(turned) if balls & set(table.loc[k, ["particle1", "particle2"]]))
    known = trace_slips(rows, table)[turned]
    lost = trace_slips([row | {"v0_local": np.nan} if k == before else row for k, row in enumerate(rows)], table)
    assert before not in lost
    assert known.across_std < 1e-6
    friction = np.sqrt(np.mean([slip.friction**2 for slip in lost.values() if abs(slip.friction) < 0.3]))
    kick = table["kick"][before]
    assert lost[turned].across_std == pytest.approx(2.5 * friction * kick, rel=0.01)


def test_two_balls_that_meet_again_share_the_error_of_their_spins():
    """The scatter of the second slip, where the impulse of the first contact is drawn with its error."""
    usual = {f"{name}_local_std": 1e-9 for name in ("v0", "b", "r", *(f"v{k}{x}" for k, *_ in AXES for x in "xy"))}
    velocities = {"v1i": (0.0, 0.0), "v2i": (1.0, 0.0), "v1o": (0.638, -0.416), "v2o": (0.362, 0.416)}
    row = usual | {f"{name}{x}_local": v for name, both in velocities.items() for x, v in zip("xy", both, strict=True)}
    row |= {"v0_local": 1.0, "b_local": 0.6, "r_local": 0.9, "v1oy_local_std": 0.02, "v2oy_local_std": 0.02}
    row |= {"v1ox_local_std": 0.02, "v2ox_local_std": 0.02}
    table = pd.DataFrame({"t_s": [0.1, 0.2], "collision": [0, 1], "particle1": 4, "particle2": 7, "kick": 0.1})
    rng, drawn = np.random.default_rng(1), []
    for _ in range(1000):
        first = {
            f"{name}{x}_local": v + rng.normal(0, 0.02)
            for name, both in velocities.items()
            if name.endswith("o")
            for x, v in zip("xy", both, strict=True)
        }
        drawn.append(trace_slips([row | first | {"collision": 0}, row | {"collision": 1}], table)[1].across)
    claimed = trace_slips([row | {"collision": 0}, row | {"collision": 1}], table)[1].across_std
    assert claimed == pytest.approx(np.std(drawn), rel=0.1)
