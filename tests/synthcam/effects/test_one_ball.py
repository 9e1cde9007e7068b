"""Effects on one ball alone: that ball moves as in a base model of its own, the other as if nothing were there."""

import numpy as np
import pytest

from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.model import Model

TIMES = np.linspace(0, 0.5, 126)
ROW = np.array([[0.003, -0.001, 0.1, 0.4, 0.7, 0.4]])
HOP = {"hop.share": 1.0, "hop.bounce": 0.4}
OWN = {  # the effect, and the base model in which both balls are as ball a is with it: motions of closed form
    "rolling_mismatch": ({"drag": 0.3, "decel": 0.02}, {"rolling_drag": 0.435, "rolling_decel": 0.0303}),
    "friction_mismatch": ({"excess": -0.4}, {"sliding_friction": 0.6 * 0.232}),
}


def single(model, labels, row=ROW[0]):
    x, y, t_c, v0, heading, b = row
    return solve(model, Launch.pair(model.bodies(labels), t_c, v0, b, heading, (x, y)), 0.0, TIMES[-1]).at(TIMES)


def many(model, labels, row=ROW[0]):
    return solve_collisions(model, row[None], 0.0, TIMES[-1], [labels[1] == "a"]).at(TIMES)[:, 0]


def pulled(model, labels, row=ROW[0]):
    """Both balls led together, as those that push each other are; they push too little to be seen."""
    return single(model.replace({"magnetic_attraction.pull": 1e-9}), labels, row)


def pulled_many(model, labels, row=ROW[0]):
    return many(model.replace({"magnetic_attraction.pull": 1e-9}), labels, row)


paths = pytest.mark.parametrize("path", [single, many, pulled, pulled_many])
strikes = pytest.mark.parametrize("labels", ["ab", "ba"])


@paths
@strikes
@pytest.mark.parametrize("name", OWN)
def test_each_ball_moves_as_in_its_own_base_model(name, labels, path):
    strengths, numbers = OWN[name]
    ours = path(Model().replace({f"{name}.{k}": v for k, v in strengths.items()}), labels)
    for ball, label in enumerate(labels):
        alone = single(Model().replace(numbers if label == "a" else {}), labels)[ball]
        np.testing.assert_allclose(ours[ball, :, :2], alone[:, :2], rtol=0, atol=3e-9)
        other = single(Model().replace({} if label == "a" else numbers), labels)[ball]
        assert np.abs(ours[ball, :, :2] - other[:, :2]).max() > 1e-4


@pytest.mark.parametrize("path", [single, many])
@strikes
def test_on_landings_each_ball_has_its_own_friction_too(labels, path):
    ours = path(Model().replace(HOP | {"friction_mismatch.excess": -0.4}), labels)
    for ball, label in enumerate(labels):
        alone = single(Model().replace(HOP | (OWN["friction_mismatch"][1] if label == "a" else {})), labels)
        np.testing.assert_allclose(ours[ball], alone[ball], rtol=0, atol=1e-8)


@paths
@strikes
def test_a_dragged_ball_slides_and_rolls_as_its_linear_equations_say(labels, path):
    """Head on. Sliding with u > 0 or u < 0: v' = -+ mu g - k v. Rolling: v' = -(drag + 5/7 k) v - decel."""
    k, v0, t_c = {"a": 0.8, "b": 0.3}, 0.4, 0.1
    base = Model()
    ours = path(base.replace({f"drag_mismatch.{x}": k[x] for x in "ab"}), labels, np.array([0, 0, t_c, v0, 0.0, 0.0]))
    motion = solve(base, Launch.pair(base.bodies(labels), t_c, v0, 0.0, 0.0, (0, 0)), 0.0, t_c)
    for ball, label in enumerate(labels):
        rate, start = k[label], np.array(motion.first("contact").after[ball])
        u = start[3] - base.ball.radius * start[7]
        mu_g = np.sign(u) * base.sliding_friction * base.gravity

        def speed(t, v=start[3], f=mu_g, k=rate):
            return (v + f / k) * np.exp(-k * t) - f / k

        def spin(t, w=start[7], f=mu_g):  # R w' = (5/2) mu g: a drag on the centre turns nothing
            return base.ball.radius * w + 2.5 * f * t

        low, high = 0.0, 0.2
        for _ in range(60):  # when the contact is at rest
            middle = (low + high) / 2
            low, high = (middle, high) if (speed(middle) - spin(middle)) * u > 0 else (low, middle)
        since = TIMES - t_c
        slides, rolls = (since > 0) & (since < low), since > low
        np.testing.assert_allclose(ours[ball, slides, 3], speed(since[slides]), rtol=0, atol=3e-9)
        drag, c = base.rolling_drag + 5 / 7 * rate, base.rolling_decel
        rolling = (speed(low) + c / drag) * np.exp(-drag * (since[rolls] - low)) - c / drag
        np.testing.assert_allclose(ours[ball, rolls, 3], np.maximum(rolling, 0.0), rtol=0, atol=1e-7)


def test_a_drag_goes_with_the_name_of_its_ball():
    """Exchanged names change nothing where both are dragged alike, and exchanged strengths with them never do."""
    alike, one = ({"drag_mismatch.a": a, "drag_mismatch.b": 0.5} for a in (0.5, 0.0))
    np.testing.assert_array_equal(*(single(Model().replace(alike), labels) for labels in ("ab", "ba")))
    swapped = {"drag_mismatch.a": 0.5, "drag_mismatch.b": 0.0}
    np.testing.assert_array_equal(single(Model().replace(one), "ab"), single(Model().replace(swapped), "ba"))
