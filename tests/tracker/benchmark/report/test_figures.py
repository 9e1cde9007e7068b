"""The page's pictures: every curve that was measured is drawn, and a name is a name."""

from dataclasses import replace

import numpy as np
from benchmark_suite import tiny

from tracker.benchmark.report.figures import (
    DEFECTS,
    draw_crowds,
    draw_defects,
    draw_errors_by_setting,
    draw_headline,
    draw_published_quantities,
)

FIGURES = {"ratio": 1.5, "rmse_px": 0.02, "jaccard": 1.0, "found": 1.0, "false": 0, "n": 60, "missed": 0}


def entry(name):
    curve = [[-0.25, 0.001, 0.001], [0.25, -0.001, 0.001]]
    shift = {f"{q}{kind}": {"in_errors": 0.5} for q in ("r", "tau1", "energy_fraction") for kind in ("", "_free")}
    return {
        "tracker": {"name": name},
        "score": 50.0,
        "parts": dict.fromkeys(("bright", "dim"), FIGURES),
        "phase": dict.fromkeys(("bright", "dim"), curve),
        "gap": [{"gap": 0.1, "ratio": 2.0}],
        "quantities": {},
        "defects": dict.fromkeys(DEFECTS, shift),
    }


def texts(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def definition():
    return replace(tiny(), data={**tiny().data, "phase": ["bright", "dim"]})


def test_each_phase_has_a_panel_with_the_word_of_its_setting():
    titles = [axes.get_title() for axes in draw_errors_by_setting([entry("one")], definition()).axes if axes.axison]
    assert titles == ["Brightness", "Balls about to touch", "Locking to pixels (bright)", "Locking to pixels (dim)"]


def test_a_name_is_shown_as_it_is():
    """A dollar is no formula, and what begins with _ stands in the legend too."""
    odd = [entry(name) for name in ("$a$", r"$\\foo$", "_mine", "a_b", "<b>")]
    drawn = draw_errors_by_setting(odd, definition())
    for figure in (
        draw_headline(odd, definition()),
        drawn,
        draw_published_quantities(odd, "bright", ["r"]),
        draw_defects(odd, ["r"], ""),
    ):
        figure.draw_without_rendering()
    legends = [axes.get_legend() for axes in drawn.axes if axes.get_legend()] + list(drawn.legends)
    assert len(legends) == 1
    assert len(legends[0].get_texts()) == len(odd)


def test_a_quantity_that_a_defect_takes_away_is_not_shown_as_unmoved():
    one = entry("one")
    assert "no result" not in texts(draw_defects([one], ["r"], "_free"))
    one["defects"] = one["defects"] | {"locking": {"r_free": {"in_errors": None}}}
    assert texts(draw_defects([one], ["r"], "_free")).count("no result") == 1
    assert texts(draw_defects([one], ["r"], "")).count("no result") == 1


def test_crowds_are_drawn_by_axis_and_an_entry_without_them_has_no_point():
    axes = {name: {"title": name, "label": name, "points": [[0.1, "bright"], [0.5, "dim"]]} for name in ("one", "two")}
    crowds = {"axes": axes, "parts": {"bright": "b", "dim": "d"}}
    given = replace(tiny(), data={**tiny().data, "crowds": crowds})
    scores = {"hota": 0.9, "ratio": 1.2, "contacts_found": 0.7, "temperature_error": None}
    figure = draw_crowds([entry("old"), {**entry("new"), "crowds": {"dim": scores}}], given)
    figure.draw_without_rendering()
    assert len(figure.axes) == 8
    old, new = figure.axes[0].get_lines()
    assert np.isnan(old.get_ydata()).all()
    assert np.array_equal(new.get_ydata(), [np.nan, 0.9], equal_nan=True)
    assert new.get_xdata().tolist() == [0.1, 0.5]
