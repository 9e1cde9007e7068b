"""The set of clips as an experiment: conditions that all clips share, and which clips are held out."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from discrepancy_clips import exact

from discrepancy.data.launch import B
from discrepancy.data.notes import SearchNoteKind
from discrepancy.data.study_design import note_uniform_conditions, split_held_out
from synthcam.model import Model


def alike(**same):
    """Clips all alike in some columns of the launch."""
    columns = ("x", "y", "t_c", "speed", "heading", "b")
    out = []
    for c in exact(Model(), 8, 5):
        launch = c.launch.copy()
        for name, value in same.items():
            launch[columns.index(name)] = value * (1 + 1e-3 * c.clip)
        out.append(dataclasses.replace(c, launch=launch))
    return out


def test_what_clips_that_are_all_alike_cannot_tell():
    assert note_uniform_conditions(alike()) == []
    for same, word in (({"speed": 0.3}, "at 0.3 m/s"), ({"b": 0.1}, "b near 0.10"), ({"heading": 3.14}, "one way")):
        said = note_uniform_conditions(alike(**same))
        assert len(said) == 1
        assert word in str(said[0])
    assert len(note_uniform_conditions(alike(speed=0.3, b=0.0, heading=0.0))) == 3


def test_one_speed_hides_what_hangs_on_it():
    """Restitution hangs on the speed along the line of centres; friction on one that falls to zero in a clip."""
    same = alike(speed=0.3)
    (said,) = note_uniform_conditions(same)
    assert "hardly show how restitution or spin transfer depends on the speed" in str(said)
    wide = [dataclasses.replace(c, launch=np.r_[c.launch[:B], 0.2 * c.clip - 0.7]) for c in same]
    (said,) = note_uniform_conditions(wide)
    assert "hardly show how spin transfer depends on the speed" in str(said)


def launched(**columns):
    """Clips with these speeds, headings (degrees) or b, of which nothing else is known."""
    count = len(next(iter(columns.values())))
    each = {"speed": np.linspace(0.1, 0.6, count), "heading": np.linspace(-170, 170, count), "b": np.zeros(count)}
    each |= columns
    rows = zip(each["speed"], np.radians(each["heading"]), each["b"], strict=True)
    return [SimpleNamespace(launch=np.array([0.0, 0.0, 0.1, *row])) for row in rows]


@pytest.mark.parametrize(("widest", "told"), [(22, False), (40, True)])
def test_headings_within_thirty_degrees_of_their_mean_are_one_way(widest, told):
    said = note_uniform_conditions(launched(heading=np.linspace(-widest, widest, 9), b=np.linspace(-0.5, 0.5, 9)))
    assert any(note.kind is SearchNoteKind.ONE_HEADING for note in said) is not told


@pytest.mark.parametrize(("span", "told"), [(0.035, False), (0.07, True)])
def test_impact_parameters_that_span_a_twentieth_are_one(span, told):
    notes = note_uniform_conditions(launched(b=0.2 + np.linspace(0, span, 9)))
    assert any(note.kind is SearchNoteKind.ONE_IMPACT_PARAMETER for note in notes) is not told


@pytest.mark.parametrize(("count", "out", "extremes"), [(7, 1, False), (8, 2, True), (30, 7, True)])
def test_a_quarter_is_kept_out_and_of_eight_the_extremes(count, out, extremes):
    b = np.zeros(count)
    b[1] = 0.5
    clips = launched(b=b)
    fitted, kept_out = split_held_out(clips)
    assert len(kept_out) == out
    assert len(fitted) == count - out
    assert ({id(clips[1]), id(clips[-1])} <= {id(c) for c in kept_out}) is extremes
