"""The model: its numbers, its file, and changes by name."""

import math

import numpy as np
import pytest

from synthcam.effects.plate_tilt import PlateTilt
from synthcam.model import Ball, Model, as_model, check_free, read_model, write_model
from synthcam.scene.scene import Scene, read_scene, schema
from synthcam_shared.errors import InputError


def test_the_defaults_are_the_papers():
    m = Model()
    assert (m.restitution, m.sliding_friction, m.spin_transfer) == (0.903, 0.232, 0.347)
    assert (m.rolling_drag, m.rolling_decel, m.ball.diameter) == (0.135, 1.03e-2, 2.38e-3)


def test_a_file_with_an_empty_section_is_the_default_model(tmp_path):
    (tmp_path / "m.yaml").write_text("model: {}")
    assert read_model(tmp_path / "m.yaml") == Model()


def test_a_ball_weighs_its_volume():
    assert Ball(2e-3, 1000).mass == pytest.approx(1000 * 4 / 3 * math.pi * 1e-9)
    assert Ball(2e-3).radius == 1e-3


def test_bodies_by_label_and_by_flag():
    model = Model().replace({"diameter_mismatch.excess": 0.02, "mass_mismatch.excess": 0.1})
    theirs, ours = model.bodies("aba"), model.bodies_where(np.array([True, False, True]))
    assert theirs.radius[0] > theirs.radius[1] == model.ball.radius
    assert theirs.mass[0] > theirs.mass[1] == model.ball.mass
    assert theirs.labels == ours.labels == ("a", "b", "a")
    np.testing.assert_array_equal([ours.radius, ours.mass, ours.inertia], [theirs.radius, theirs.mass, theirs.inertia])


def test_value_and_replace_by_dotted_name():
    m = Model().replace({"restitution": 0.8, "plate_tilt.x": 1e-3})
    assert m.restitution == 0.8
    assert m.value("plate_tilt.x") == 1e-3
    assert m.value("plate_tilt.y") == 0
    assert m.value("rolling_quadratic.K") == 0
    assert m.replace({"plate_tilt.y": 2e-3}).effects == (PlateTilt(x=1e-3, y=2e-3),)
    assert Model().effects == ()
    assert Model().laws.has_effect_on("push") is False
    assert m.laws.has_effect_on("push") is True


def test_a_scene_of_numbers_is_a_model_too(tmp_path):
    (tmp_path / "s.yaml").write_text("launch: {v0: 0.1}\nmodel: {restitution: 0.8}\nfree: [plate_tilt.x]\n")
    assert read_model(tmp_path / "s.yaml") == Model(restitution=0.8, free=("plate_tilt.x",))


def test_a_model_to_be_searched_may_lack_sliding_friction(tmp_path):
    (tmp_path / "m.yaml").write_text("model: {sliding_friction: 0, spin_transfer: 0}\n")
    assert read_model(tmp_path / "m.yaml") == Model(sliding_friction=0, spin_transfer=0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("model: {restitution: {uniform: [0.8, 0.9]}}", r"m\.yaml: model\.restitution: expected a number"),
        ("model: {restitution: 1.2}", r"model\.restitution: expected a number of 1 or less, found 1.2"),
        ("model: {bounce: 1}", r"m\.yaml: model\.bounce: unknown key"),
        ("free: [bounce]", r"m\.yaml: free: bounce is no parameter; did you mean hop\.bounce\?"),
        ("effects: {plate_tilt: {x: 3}}", r"effects\.plate_tilt\.x: expected a number of 0\.1 or less"),
    ],
)
def test_a_wrong_model_file(tmp_path, text, message):
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(InputError, match=message) as e:
        read_model(tmp_path / "m.yaml")
    assert "\n" not in str(e.value)


def test_round_trip_with_everything(tmp_path):
    m = Model(ball=Ball(3e-3, 7700.0), gravity=9.8, effects=(PlateTilt(x=1 / 3e3),), free=("gravity", "plate_tilt.x"))
    write_model(m, tmp_path / "m.yaml")
    assert read_model(tmp_path / "m.yaml") == m


def test_free_names():
    assert check_free(["restitution", "plate_tilt.x"], "here") == ("restitution", "plate_tilt.x")
    with pytest.raises(InputError, match="here: free: plate_tilt is no parameter"):
        check_free(["plate_tilt"], "here")


def test_symbols_are_other_names_of_three_numbers(tmp_path):
    """Truth and results say r, mu_k and C; a scene or model may use either name, in `free` and --set too."""
    short, long = tmp_path / "short.yaml", tmp_path / "long.yaml"
    short.write_text("model: {r: 0.8, mu_k: {uniform: [0.1, 0.2]}, C: 0.3}\n")
    long.write_text("model: {restitution: 0.8, sliding_friction: {uniform: [0.1, 0.2]}, spin_transfer: 0.3}\n")
    drawn = [read_scene(file).draw(3, 7) for file in (short, long)]
    assert drawn[0].model == drawn[1].model
    assert drawn[0].model.restitution == pytest.approx(drawn[0].truth["r"]) == 0.8
    assert read_scene(long, ("model.C=0.25",)).draw(0, 0).model.spin_transfer == 0.25
    assert Scene.read(long, model={"r": 0.7}).draw(0, 0).model.restitution == 0.7
    short.write_text("model: {mu_k: 0.2}\nfree: [r, mu_k]\n")
    model = Model.read(short)
    assert (model.sliding_friction, model.free) == (0.2, ("restitution", "sliding_friction"))
    assert model.replace({"C": 0.1}).value("C") == 0.1
    assert as_model({"model": {"r": 0.6}}).restitution == 0.6


def test_a_number_under_both_names_is_one_line(tmp_path):
    file = tmp_path / "both.yaml"
    file.write_text("model: {mu_k: 0.2, sliding_friction: 0.2}")
    for read in (read_model, read_scene):
        with pytest.raises(InputError, match=r"both\.yaml: model\.mu_k: the same number as model\.sliding_friction"):
            read(file)


def test_the_schema_lists_both_names():
    rules = schema()["$defs"]["ModelSettings"]["properties"]
    assert rules["mu_k"]["anyOf"] == rules["sliding_friction"]["anyOf"]
    assert "mu_k" in rules["sliding_friction"]["description"]
