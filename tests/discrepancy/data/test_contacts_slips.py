"""Spins that are traced through the contacts of a crowd against those of the simulation."""

import numpy as np
import pandas as pd
import pytest

from discrepancy.data.contacts import trace_slips
from synthcam import Scene

AXES = (("1i", "j", "before"), ("2i", "i", "before"), ("1o", "j", "after"), ("2o", "i", "after"))


@pytest.fixture(scope="module")
def truth():
    """Contacts of a simulated crowd of balls."""
    return solve_contacts(Scene.read("crowd", timing={"frames": 100}).draw(seed=2), radius=0.00119)


def solve_contacts(clip, radius):
    """Contacts of a clip: rows of estimates without errors, contacts.parquet, and the true slips."""
    motion = clip.solve()
    events = motion.events[motion.events.kind == "contact"].reset_index(drop=True)
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
    table = pd.DataFrame(
        {"t_s": events.t_s, "collision": range(len(events)), "particle1": events.j, "particle2": events.i, "kick": 0.1}
    )
    return rows, table, np.array(slips)


def test_slips_are_those_of_the_simulation(truth):
    rows, table, true = truth
    found = trace_slips(rows, table)
    assert np.abs(true[:, 4]).max() > 0.02  # m/s: some balls turn
    across = np.array([found[k].across for k in range(len(rows))])
    assert across == pytest.approx(true[:, 0], abs=1e-6)
    friction = np.array([found[k].friction for k in range(len(rows))])
    assert np.abs(friction) == pytest.approx(np.abs(true[:, 2] / true[:, 3]), rel=1e-3, abs=1e-6)
    rolls = np.abs(true[:, 1] - [found[k].size for k in range(len(rows))]) < 1e-3
    assert rolls.mean() > 0.5  # the others still slide from a contact before


def test_discs_slip_in_the_plane_alone_and_turn_as_discs():
    clip = Scene.read("pucks", timing={"frames": 150}, walls=[]).draw(seed=2)
    rows, table, true = solve_contacts(clip, radius=0.03)
    found = trace_slips([row | {"motion_local": "glide"} for row in rows], table)
    assert np.abs(true[:, 4]).max() > 0.02  # m/s: some discs turn
    assert [found[k].across for k in range(len(rows))] == pytest.approx(true[:, 0], abs=1e-6)
    assert [found[k].size for k in range(len(rows))] == pytest.approx(true[:, 1], abs=1e-6)


def test_a_contact_without_an_estimate_leaves_the_spin_uncertain(truth):
    rows, table, true = truth
    turned = int(np.argmax(np.abs(true[:, 4])))
    balls = set(table.loc[turned, ["particle1", "particle2"]])
    before = max(k for k in range(turned) if balls & set(table.loc[k, ["particle1", "particle2"]]))
    known = trace_slips(rows, table)[turned]
    lost = trace_slips([row | {"v0_local": np.nan} if k == before else row for k, row in enumerate(rows)], table)
    assert before not in lost
    assert known.across_std < 1e-6
    assert lost[turned].across_std == pytest.approx(2.5 * 0.15 * 0.1, rel=0.01)


def test_two_balls_that_meet_again_share_the_error_of_their_spins():
    """The scatter of the second slip, where the impulse of the first contact is drawn with its error."""
    usual = {f"{name}_local_std": 1e-9 for name in ("v0", "b", "r", *(f"v{k}{x}" for k, *_ in AXES for x in "xy"))}
    velocities = {"v1i": (0.0, 0.0), "v2i": (1.0, 0.0), "v1o": (0.5, 0.3), "v2o": (0.5, -0.3)}
    row = usual | {f"{name}{x}_local": v for name, both in velocities.items() for x, v in zip("xy", both, strict=True)}
    row |= {"v0_local": 1.0, "b_local": 0.5, "r_local": 0.9, "v1oy_local_std": 0.02, "v2oy_local_std": 0.02}
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
