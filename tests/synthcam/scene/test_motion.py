"""Motion for people: the tables are the trajectory's own numbers, the plot is in mm."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import synthcam

mpl.use("Agg")
MOTION = synthcam.Scene.read("oblique").draw(seed=1).solve()


def test_before_the_hit_the_striker_rolls_at_a_known_loss():
    """x and v of a roller under a = -(drag v + decel), by hand."""
    clip = synthcam.Scene.read("painter_behringer", launch={"v0": 0.3, "heading": 0.0}).draw()
    t_c, drag, decel = clip.truth["t_c"], 0.135, 0.0103
    table = clip.solve().at([0.0, t_c / 2])
    striker = table[table["particle"] == 1].set_index("t_s")
    v0 = striker["vx"][0.0]
    fall = np.exp(-drag * t_c / 2)
    assert striker["vx"][t_c / 2] == pytest.approx((v0 + decel / drag) * fall - decel / drag, rel=1e-12)
    assert set(striker["state"]) == {"roll"}
    assert striker["wy"][0.0] == pytest.approx(v0 / 1.19e-3)


def test_a_row_for_each_ball_and_time():
    table = MOTION.at(np.linspace(0, 0.4, 5))
    assert table["particle"].tolist() == [0] * 5 + [1] * 5
    assert table.columns.tolist() == "t_s particle x y z vx vy vz wx wy wz state".split()
    assert len(MOTION.at(0.1)) == 2
    np.testing.assert_array_equal(table["x"], MOTION.trajectory.at(np.linspace(0, 0.4, 5))[..., 0].ravel())


@pytest.mark.parametrize(
    ("t", "said"), [(0.5, "outside"), ([-1], "outside"), ("soon", "could not convert"), (None, "outside")]
)
def test_a_time_that_is_none_is_one_line(t, said):
    with pytest.raises(synthcam.InputError, match=said) as error:
        MOTION.at(t)
    assert str(error.value).startswith("t: ")
    assert "\n" not in str(error.value)


def test_the_events_stand_in_the_repr_and_the_page():
    kinds = MOTION.events["kind"].tolist()
    assert kinds == ["contact", "slide_end", "slide_end"]
    assert repr(MOTION).count("slide_end") == 2
    assert MOTION._repr_html_().count("<tr") == 1 + len(kinds)


def test_the_plot_is_in_mm_on_the_axes_given():
    ax = Figure().subplots()
    assert MOTION.plot(ax) is ax
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_aspect()) == ("x (mm)", "y (mm)", 1.0)
    target = MOTION.at(0.4).loc[0]
    assert ax.lines[0].get_xydata()[-1] == pytest.approx([1e3 * target["x"], 1e3 * target["y"]])
    assert MOTION.plot().figure is not ax.figure
