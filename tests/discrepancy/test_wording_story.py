"""Each sentence says what the numbers say."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import collisions, searched
from discrepancy_outsiders import outsider

from discrepancy.fitting.gauss_newton import fit_model, solve_step
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.policy import SearchPolicy
from discrepancy.wording import gain_of_next_step, write_story
from synthcam.model import Model


@pytest.fixture(params=["nothing", "velocity_restitution", "restitution_speed"])
def found(request):
    return outsider(request.param) if request.param == "restitution_speed" else searched(request.param)


def test_sentences_with_the_numbers(found):
    fitted, where, closed, still = write_story(found)
    assert fitted.startswith(f"The search fitted {len(found.data.clips)} collisions together")
    assert f"{len(found.data.held_out)} more collisions were held out" in fitted
    assert "converged" in fitted
    assert f"On the {len(found.data.clips)} fitted collisions the base model has chi^2" in where
    assert f"{found.gap.floor_um:.2f} um" in closed
    these = f"These {len(found.data.clips)} fitted collisions cannot "
    shown = f"These {len(found.data.clips)} fitted collisions would show "
    assert still.startswith((f"{these}distinguish", shown, "None of"))


def test_effects_that_do_not_show_come_with_the_size_that_would_show():
    """A search lists effects above ten realistic sizes, or as many as its policy says; one of five may still hide."""
    found = searched("nothing")
    shown = dataclasses.replace(found, undetectable=())
    assert (
        " would show every effect of the library at 10 times its realistic size, or at less." in write_story(shown)[3]
    )
    hidden = dataclasses.replace(found, undetectable=("hop", "air_drag"), policy=SearchPolicy(max_detection_limit=4.0))
    assert " show hop or air_drag only above 4 times its realistic size, or not at all." in write_story(hidden)[3]


def test_what_is_missing_is_said_with_its_numbers():
    what = searched("velocity_restitution").sentence()
    assert what.startswith("Missing effect: velocity_restitution (")
    assert ", e +0.05" in what
    outside = outsider("restitution_speed").sentence()
    assert "r that depends on the normal speed, which no effect of the library makes" in outside
    assert "model.yaml holds its curve" in outside
    unheld = dataclasses.replace(outsider("restitution_speed"), model_holds_law=False)
    assert "model.yaml cannot hold it" in unheld.sentence()
    assert "Nothing is missing" in searched("nothing").sentence()


def test_a_share_of_chance_is_not_told():
    found = searched("velocity_restitution")
    share = f"{100 * found.gap.closure:.1f} %"
    assert f"The best model removes {share} of the excess of chi^2 over noise." in write_story(found)[2]
    gap = dataclasses.replace(found.gap, closure=float("nan"))
    none = dataclasses.replace(found, gap_fits=dataclasses.replace(found.gap_fits, gap=gap))
    assert write_story(none)[2].endswith("is too small to say what share of it the best model removes.")
    assert none.sentence().startswith("The base model already predicts held-out collisions within the noise")
    assert found.sentence().startswith("Missing effect:")


def test_a_fit_that_did_not_converge_is_said():
    """The base fit of one noise, put where chi^2 still falls."""
    base = searched("nothing").base_fit
    slope = base.slopes[0][:, 0]
    off = dataclasses.replace(
        base, residuals=(base.residuals[0] + 20 * slope / (slope @ slope) ** 0.5, *base.residuals[1:])
    )
    assert gain_of_next_step(base) < 0.1
    assert gain_of_next_step(off) > 1
    found = searched("nothing")
    moved = dataclasses.replace(found, base_fit=off)
    assert "the fit converged" in write_story(found)[0]
    assert "the fit did not converge: a further step would lower chi^2 by" in write_story(moved)[0]


def test_a_parameter_that_stands_at_its_limit_has_converged():
    """Noise asks for less rolling drag than none: that is no step to take."""
    clips = collisions(Model().replace({"rolling_drag": 0.0}), 6, 8)
    fit = fit_model(clips, Model(), BASE_PARAMETERS, Noise(NoiseComponent(1.0)))
    assert fit.model.rolling_drag == 0
    shared, _ = solve_step(fit, 0.0, np.full(len(BASE_PARAMETERS), -np.inf), np.full(len(BASE_PARAMETERS), np.inf))
    assert shared[BASE_PARAMETERS.index("rolling_drag")] < 0
    assert gain_of_next_step(fit) < 0.1


def test_a_place_without_a_size_is_told_without_one(found):
    unsized = tuple(dataclasses.replace(p, size=float("nan")) for p in found.base_disagreements)
    assert "um rms" not in write_story(dataclasses.replace(found, base_disagreements=unsized))[1]


def test_what_clips_all_alike_cannot_tell_is_said():
    found = dataclasses.replace(searched("nothing"), uniform=("all clips go one way: no tilt can be told",))
    assert write_story(found)[3].endswith(" All clips go one way: no tilt can be told.")
