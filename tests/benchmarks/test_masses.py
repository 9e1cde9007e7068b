"""Wrong masses put into hits: both bodies strike, or always the same one."""

import numpy as np
import pandas as pd
import pytest
from tracker_local import draw_rows, draw_unequal_rows

from benchmarks.real import masses
from benchmarks.real.recordings import RecordedHit
from tracker.measurement.local.local_columns import calibrate_set


@pytest.fixture
def measure(monkeypatch):
    """Measure hits as rows say, whatever the camera file states; returns the masses that it states."""

    def prepare(rows):
        stated = []

        def measure(hit, support):
            stated.append(tuple(hit.camera["ball_masses"]))
            return rows[int(hit.name)]

        def calibrate(measured):
            return [row | {"b_local": 0.01, "b_local_std": 0.01} for row in calibrate_set(measured)]

        monkeypatch.setattr(masses, "measure_hit", measure)
        monkeypatch.setattr(masses, "calibrate_set", calibrate)
        return stated

    return prepare


def make_hits(camera):
    return [RecordedHit(str(k), pd.DataFrame(), camera) for k in range(60)]


@pytest.mark.parametrize(
    ("strikers", "law"), [((7, 9), "ball a is"), ((9,), "the struck body seems"), ((7,), "the struck body seems")]
)
def test_a_wrong_mass_is_named_with_its_size_whichever_body_strikes(measure, strikers, law):
    """The mass of body 7 is wrong. Recoil gives the right one, whatever the camera file states."""
    rows = [row for row in draw_unequal_rows(0.0, hits=120) if row["particle2"] in strikers][:60]
    ids = {7: 0, 9: 1}
    stated = measure([row | {name: ids[row[name]] for name in ("particle1", "particle2")} for row in rows])
    given = masses.MassSet("discs", "air", make_hits({"ball_masses": [0.03, 0.03]}))
    first, *wrong = masses.try_masses(given)
    assert first["strikes"] == {(7, 9): 30, (9,): 0, (7,): 60}[strikers]
    assert not first["causes"]
    sizes = np.unique([line["wrong"] for line in wrong])
    most = min(10 * first["limit"], masses.LARGEST)
    assert sizes.max() == pytest.approx(most)
    assert sizes == pytest.approx(-sizes[::-1])
    one, two = np.array(stated).reshape(1 + len(wrong), 60, 2)[:, 0].T
    assert np.log(one / 0.03) == pytest.approx([0.0, *(line["wrong"] for line in wrong)])
    assert two == pytest.approx(0.03)
    for line in wrong:
        assert law in line["law"]
        assert "mass_mismatch" in line["causes"]
        assert abs(line["z"]) < 2
        assert abs(line["size"] + line["wrong"]) < 0.02


def test_a_ball_of_a_match_is_particle_0_of_its_hits():
    """Three balls meet in pairs; the positions of a ball stay its own."""
    hits = []
    for name, balls in (("first", (1, 2)), ("second", (3, 1)), ("third", (2, 3))):
        tracks = pd.DataFrame({"particle": [0, 1], "x": [float(ball) for ball in balls]})
        hits.append(RecordedHit(name, tracks, {}, balls))
    sets = list(masses.make_sets("3cushiontool", hits))
    assert [[hit.name for hit in one.hits] for one in sets] == [
        ["first", "second"],
        ["first", "third"],
        ["second", "third"],
    ]
    for ball, one in enumerate(sets, 1):
        for hit in one.hits:
            at = hit.tracks.set_index("particle")["x"]
            assert at[0] == hit.balls[0] == ball
            assert at[1] == hit.balls[1] != ball


def test_the_limit_of_a_body_that_never_strikes_is_that_of_a_usual_bias(measure):
    """Four velocities with errors of 0.0125 of the normal speed, over the kick of 1.8 / 2 of it; 5 sigma of that."""
    measure(draw_rows(60, 0.003, 0.003, -0.15))
    own, std = masses.measure_own(masses.MassSet("pucks", "air", make_hits({})).measure())
    assert own == pytest.approx(0.15 / 0.9, rel=0.2)
    assert std == pytest.approx(0.025 / 0.9, rel=0.2)
