"""The boxes of the blind trials: the second integrator, the limits, the draws, causes outside the library."""

import dataclasses
import json

import numpy as np
import pytest
from blind_boxes import truth_of
from discrepancy_clips import exact

from benchmarks.search.sealed import boxes, drawing, evidence
from benchmarks.search.sealed.boxes import NOISES, UNDRAWN, Study
from benchmarks.search.sealed.fisher import LIMIT, Fisher
from benchmarks.search.sealed.integrator import PHYSICS
from benchmarks.search.sealed.ordinary import ORDINARY, UNKNOWN
from benchmarks.search.sealed.outsiders import OUTSIDERS
from benchmarks.search.sealed.studies import ROUND, STUDIES
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.library import free_laws_over
from synthcam.library import library
from synthcam.model import Model
from tracker.camera.camera import Camera

SIZES = {name: {f"{name}.{p.name}": p.typical for p in library()[name].parameters()} for name in PHYSICS}


@pytest.mark.parametrize("name", ["nothing", *PHYSICS])
def test_two_integrators_agree_to_a_tenth_of_a_nanometre(name):
    """A fifty thousandth of the noise: whatever a box finds, it is not the other integrator."""
    hidden = SIZES.get(name, {})
    hidden = hidden | ({"friction_anisotropy.s": -0.05} if name == "friction_anisotropy" else {})
    truth = truth_of(hidden)
    for clip in boxes.clips_of(truth):
        camera = Camera.from_dict(clip.camera_json)
        one, seen = evidence._by_synthcam(clip, camera)
        other, also = evidence.integrate_tracks(truth, clip, camera)
        np.testing.assert_array_equal(seen, also)
        np.testing.assert_allclose(one[seen] * boxes.SCALE, other[seen] * boxes.SCALE, rtol=0, atol=1e-10)


@pytest.fixture(scope="module")
def tilted():
    """A design, a tilt, and the rows in view."""
    truth = truth_of({}, clips=4)
    rows = boxes.fitted(truth)
    return truth, rows


@pytest.mark.parametrize("kind", NOISES)
def test_at_its_limit_an_effect_scores_five(kind, tilted):
    """Tracks are made one way, noise and all, and the limit worked out another."""
    truth, rows = tilted
    fisher = Fisher(boxes.base_model(truth), rows, NOISES[kind])

    def hidden(strength):
        tilt = library()["plate_tilt"](x=strength, y=-strength)
        return dataclasses.replace(fisher.model, effects=(tilt,))

    limit = fisher.limit(hidden, 1e-3, 0.05)
    unit = fisher.signature(hidden(limit)) / LIMIT
    moved = fisher._tracks(hidden(limit))
    rng, z, squares = np.random.default_rng(3), [], []
    for _ in range(40):
        tracks = []
        for k, row in enumerate(rows):
            noise = evidence.noise_of(kind, truth["frames"], rng).reshape(-1, 2)
            whole = row.ball * truth["frames"] + row.frame
            tracks.append(moved[k] - fisher.plain[k] + noise[whole])
            squares.append(fisher._white(k, noise[whole]) ** 2)
        z.append(unit @ fisher._cleaned(tracks))
    assert np.mean(z) == pytest.approx(LIMIT, abs=3.5 / np.sqrt(40))
    assert np.std(z) == pytest.approx(1, abs=3.5 / np.sqrt(80))
    squares = np.concatenate(squares)
    assert squares.mean() == pytest.approx(1, abs=3.5 * np.sqrt(2 / len(squares)))


def test_limits_are_those_of_other_trials():
    """Found earlier by a program of its own for the same experiment: 30 clips, white noise of 5 um."""
    truth = truth_of({}, clips=40, exchanged=False)
    fisher = Fisher(boxes.base_model(truth), boxes.fitted(truth), NOISES["white"])
    assert len(fisher.rows) == 30
    known = {"hop.share": 3.5e-3, "mass_mismatch.excess": 2.3e-4, "plate_tilt.x": 8e-6, "scale_error.e": 4.9e-4}
    known |= {"pixel_locking.amplitude": 2.3e-3, "stribeck.rise": 7.6e-3}  # at .1 m/s
    for key, limit in known.items():
        name, _, strength = key.partition(".")

        def hidden(size, name=name, strength=strength):
            effect = dataclasses.replace(library()[name].absent(), **{strength: size})
            return dataclasses.replace(fisher.model, effects=(effect,))

        assert fisher.limit(hidden, limit / 10, 1.0) == pytest.approx(limit, rel=0.15), key


def test_a_draw_is_the_same_again_and_within_its_bounds():
    study = Study("test", {"one": 1}, 3, clips=6, frames=60)
    for box in range(study.boxes):
        truth = drawing.draw(study, box, "s")
        assert json.dumps(truth) == json.dumps(drawing.draw(study, box, "s"))
        (about,) = truth["about"]
        assert 0.85 <= about["ratio"] <= 20
        assert 0 <= about["nearest"] <= 1 + 1e-9
        assert boxes.model_of(truth).effects


@pytest.fixture
def undesigned(monkeypatch):
    """Boxes are drawn without a look at what their tracks would show."""

    def entry(_, kind, shapes, way, ratio, __):
        return {"effect": kind.name(), "values": {}, "ratio": ratio}

    monkeypatch.setattr(drawing, "fitted", lambda _: [])
    monkeypatch.setattr(drawing, "Fisher", lambda *_: None)
    monkeypatch.setattr(drawing, "_entry", entry)


@pytest.mark.parametrize(
    ("study", "kinds"), [("every", set(library()) - set(UNDRAWN)), ("outside", OUTSIDERS), ("ordinary", UNKNOWN)]
)
def test_a_round_hides_each_of_them(study, kinds, undesigned):
    drawn = [drawing.draw(STUDIES[study], box, "s") for box in range(ROUND[study])]
    hidden = [truth["effects"][0] for truth in drawn]
    assert set(hidden) == set(kinds)
    assert {t["source"] for t in drawn} == ({"synthcam"} if study != "every" else {"synthcam", "integrator"})
    for truth in drawn:
        assert truth["effects"] != ["unknown_lamp"] or truth["lamp"] is None
        assert truth["effects"] != ["glint_parallax"] or truth["lamp"][2] <= 0.2
        assert truth["exchanged"] or study != "ordinary"
    assert len(UNKNOWN) >= 10
    again = [drawing.draw(STUDIES[study], box, "t")["effects"][0] for box in range(5)]
    assert again != hidden[:5]  # another secret, another order


def test_what_is_never_hidden_makes_the_tracks_of_other_numbers():
    """adhesion of a larger friction, to the last digits; a wrong clock of another v0, drag, mu and decel."""
    truth = truth_of({}, clips=3)
    rows, model = boxes.fitted(truth), boxes.base_model(truth)
    launches = np.array([r.launch for r in rows])
    sticky = predict_tracks(model.replace({"adhesion.pull": 0.2}), launches, rows)
    rough = predict_tracks(model.replace({"sliding_friction": 1.2 * model.sliding_friction}), launches, rows)
    np.testing.assert_allclose(np.concatenate(sticky), np.concatenate(rough), atol=1e-12)
    f, rows = 1.01, [dataclasses.replace(r, camera=dataclasses.replace(r.camera, exposure=1e-7)) for r in rows]
    wrong = predict_tracks(model.replace({"clock_error.e": f - 1}), launches, rows)
    powers = {"rolling_drag": 1, "rolling_decel": 2, "sliding_friction": 2}
    other = model.replace({k: getattr(model, k) * f**n for k, n in powers.items()})
    moved = launches * np.array([1, 1, 1 / f, f, 1, 1])
    right = predict_tracks(other, moved, rows)
    np.testing.assert_allclose(np.concatenate(wrong), np.concatenate(right), atol=1e-9)
    assert set(UNDRAWN) == {"adhesion", "clock_error"}


def test_outsiders_are_in_no_library():
    assert len(OUTSIDERS) >= 8
    assert not {*OUTSIDERS, *ORDINARY} & set(library())
    assert not any(hasattr(e, "_moved") and e.VIDEO for e in (OUTSIDERS | ORDINARY).values())
    assert not any(ORDINARY[name].FREE_LAW for name in UNKNOWN)


@pytest.mark.parametrize("name", [n for n, kind in ORDINARY.items() if kind.SAME])
def test_what_the_library_has_taken_in_is_its_effect_exactly(name, design):
    _, fisher = design
    kind, rng = ORDINARY[name], np.random.default_rng(1)
    entry = drawing._entry(fisher, kind, drawing._shapes(kind, rng), drawing._way(kind, rng), 5.0, naming=False)
    assert kind.SAME[0] in entry["class"]
    assert entry["nearest"] == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("name", [n for n, kind in ORDINARY.items() if kind.FREE_LAW])
def test_what_a_free_law_has_taken_in_is_a_series_of_it_and_of_no_other(name):
    kind, clips = ORDINARY[name], exact(Model(), 20, 11)
    # a tenth of a typical fault, for columns are derivatives
    fault = kind(**{p.name: p.typical * (1 if p.fixed else 0.1) for p in kind.parameters()})
    launches = np.array([c.launch for c in clips])
    bent = dataclasses.replace(Model(), effects=(fault,))
    moved = np.concatenate(predict_tracks(bent, launches, clips)) - np.concatenate(
        predict_tracks(Model(), launches, clips)
    )
    left = {}
    for law in free_laws_over(Model(), launches, clips):
        if law.name in {kind.FREE_LAW, "friction_speed", "force_heading"}:
            columns = np.concatenate(law.derivatives(Model(), launches, clips)).reshape(-1, law.size)
            best = columns @ np.linalg.lstsq(columns, moved.ravel(), rcond=1e-9)[0]
            left[law.name] = np.linalg.norm(moved.ravel() - best) / np.linalg.norm(moved)
    own = left.pop(kind.FREE_LAW)
    assert own < 0.01
    assert min(left.values()) > 3 * own


@pytest.fixture(scope="module")
def design():
    truth = truth_of({}, clips=8, frames=70)
    return truth, Fisher(boxes.base_model(truth), boxes.fitted(truth), NOISES["white"])


@pytest.mark.parametrize("name", UNKNOWN)
def test_an_ordinary_fault_shows_and_is_like_no_effect(name, design):
    """The tracks of a box move as its limit was worked out with; and no effect of the library does the same."""
    truth, fisher = design
    kind, rng = ORDINARY[name], np.random.default_rng(1)
    entry = drawing._entry(fisher, kind, drawing._shapes(kind, rng), drawing._way(kind, rng), 5.0, naming=False)
    assert entry["nearest"] < boxes.ALIKE
    hidden = truth | {"hidden": entry["values"], "effects": [name], "kind": "ordinary"}
    foreseen = [a - p for a, p in zip(fisher._tracks(boxes.model_of(hidden)), fisher.plain, strict=True)]
    k = int(np.argmax([np.abs(f).max() for f in foreseen]))
    row, most = fisher.rows[k], np.abs(foreseen[k]).max()
    clip, base = (boxes.clips_of(t)[row.clip] for t in (hidden, truth))
    (one, _), (other, _) = (evidence._by_synthcam(c, row.camera) for c in (clip, base))
    moved = row.camera.unproject(one)[0] - row.camera.unproject(other)[0]
    assert most > 1e-8
    near = np.abs(row.frame - row.launch[2] * row.camera.fps) < 3  # of the hit, where differences are no velocity
    same = ~near if hasattr(kind, "_moved") else np.ones(len(near), bool)
    np.testing.assert_allclose(moved[row.ball, row.frame][same], foreseen[k][same], atol=0.02 * most + 1e-10)


def test_strengths_at_the_limit_lie_on_both_sides_of_it(undesigned):
    ratios = [drawing.draw(STUDIES["limit"], box, "s")["about"][0]["ratio"] for box in range(30)]
    assert all(0.85 <= r <= 1.2 for r in ratios)
    assert min(ratios) < 0.9
    assert max(ratios) > 1.15


@pytest.mark.parametrize(("longer", "allowed"), [(3.4e-3, True), (-4e-4, True), (-5e-4, False), (3.6e-3, False)])
def test_no_box_has_a_shutter_that_opens_for_no_time_or_too_long(tilted, longer, allowed, monkeypatch):
    truth, rows = tilted
    assert rows[0].camera.exposure == 5e-4
    design = Fisher(boxes.base_model(truth), rows, NOISES["white"])
    for name, said in (("limit", 1.0), ("signature", np.ones(9)), ("likeness", {"other": 0.5})):
        monkeypatch.setattr(design, name, lambda *_, said=said: said)
    entry = drawing._entry(design, library()["exposure_blur"], {}, {"longer": longer}, 1.0, naming=False)
    assert (entry is not None) == allowed
