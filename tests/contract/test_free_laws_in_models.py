"""Every free law of the search is a table that a model may hold, or one of which the model says why not."""

import dataclasses

import numpy as np
import pytest

from discrepancy.free_laws.law_kinds import SeriesEffect
from discrepancy.free_laws.library import list_free_laws
from discrepancy.free_laws.ranges import Axis
from synthcam.effect import LAWS, VECTOR_INPUTS
from synthcam.model import BASE_PARAMETERS, Model
from synthcam.tabulated_law import SEARCH_ONLY_LAWS, TABLE_KINDS, TabulatedLaw

COUNT = 5
PLACES = {"line": 121, "turn": 121, "place": 61}  # of a table, a side
BY_NAME = {law.base_name: law for law in list_free_laws()}


def axes_of(kind):
    if kind.axis == "turn":
        return (Axis("heading", "rad", -np.pi, np.pi, COUNT, "circle"),)
    return tuple(Axis(name, kind.x_unit, 0.0, 0.5, COUNT) for name in ("x", "y")[: 2 if kind.axis == "place" else 1])


def test_each_is_there_or_said_to_be_none():
    assert set(BY_NAME) == set(TABLE_KINDS) | set(SEARCH_ONLY_LAWS)


@pytest.mark.parametrize("name", TABLE_KINDS)
@pytest.mark.parametrize("ball", ["", "b"])
def test_a_table_of_a_series_bends_the_law_as_the_series_does(name, ball):
    kind, search = TABLE_KINDS[name], BY_NAME[name]
    assert (kind.law, kind.what) == search.bends
    assert (kind.owners, kind.unit, kind.parts, kind.one_ball) == (
        search.owners, search.unit, search.parts, search.one_ball,
    )  # fmt: skip
    if ball and not kind.one_ball:
        return
    law = dataclasses.replace(search, axes=axes_of(kind), ball=ball)
    rng = np.random.default_rng(1)
    series = SeriesEffect(law, tuple(1e-3 * rng.standard_normal(law.size)))
    grids = [a.grid(PLACES[kind.axis]) for a in law.axes]
    x = [g.ravel() for g in np.meshgrid(*grids, indexing="ij")]
    model = Model()
    y = law.values(np.array(series.coefs), *x) + law.value_in_model(model, *x).reshape(
        (-1, 2) if law.parts == 2 else -1
    )
    places = x[0].tolist() if len(x) == 1 else np.stack(x, axis=1).tolist()
    table = TabulatedLaw.of(
        law.name, places, np.abs(y) if kind.low == 0 else y, {n: getattr(model, n) for n in BASE_PARAMETERS}
    )
    instant = {
        what: rng.uniform(0.05, 0.3, (3, 4, 2) if what in {*VECTOR_INPUTS, "heading"} else (3, 4))
        for what in LAWS[kind.law]
    }
    instant["of_a"] = np.array([1.0, 0.0, 0.0])[:, None]
    value = rng.uniform(0.2, 0.4, (3, 4, 2) if kind.law == "push" else (3, 4))
    for (law_bent, bend, asks), (other, other_bend, other_asks) in zip(table.bends, series.bends, strict=True):
        assert (law_bent, asks) == (other, other_asks)
        found, expected = (f(value, *[instant[a] for a in asks]) for f in (bend, other_bend))
        np.testing.assert_allclose(found, expected, atol=1e-8)
        if ball:
            np.testing.assert_array_equal(found[0], value[0])
        assert np.abs(expected - value).max() > 1e-5
