"""The words for scatter and contacts: numbers with units and errors, causes, and the next measurement."""

import dataclasses
import math
from types import SimpleNamespace

import pytest

from discrepancy.fitting.stretch_moves import StretchScatter
from discrepancy.outcome import Verdict
from discrepancy.select.contact_effects import ContactClaim, ContactNumber
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.impact_laws import SPIN_NUMBER
from discrepancy.validate.claim_tests import ClaimTest, HeldOutTest, Rejection, StrengthVariation
from discrepancy.validate.residual_map import Disagreement
from discrepancy.wording import (
    describe_claim,
    describe_contacts,
    describe_disagreement,
    describe_rejection,
    describe_stretch_scatter,
    describe_verdict,
)
from synthcam.library import library
from synthcam.model import Model

RECOIL = ContactClaim(
    quantity="recoil",
    law="the struck body seems heavier by a share",
    causes=("mass_mismatch", "hop"),
    numbers=(ContactNumber("log of the ratio", 0.02, 0.004, "1"),),
    contacts=79,
    scatter=0.01,
    sigma=5.0,
    left_out_sigma=3.0,
    rivals=("ball a is heavier by a share",),
    mean=ContactNumber("mean recoil", 0.02, 0.004, "1"),
)


def test_friction_beside_an_unseen_spin_says_that_strikers_count_as_rolling():
    numbers = (ContactNumber("mu", 0.0844, 0.0057, "1"), ContactNumber(SPIN_NUMBER, 0.77, 0.15, "1"))
    claim = dataclasses.replace(
        RECOIL, quantity="friction", law="Coulomb friction", numbers=numbers, causes=("ball_friction",)
    )
    (with_spin, _), (without, _) = (
        describe_contacts([each], Model()) for each in (claim, dataclasses.replace(claim, numbers=numbers[:1]))
    )
    assert "(mu 0.0844 +- 0.0057, rms of R w over the speed 0.77 +- 0.15; 5.0 sigma)" in with_spin
    assert "Strikers count as rolling" in with_spin
    assert "Strikers count as rolling" not in without


@pytest.mark.parametrize(
    ("effect", "values", "std", "text"),
    [
        (
            "plate_tilt",
            {"x": -1.0004e-3, "y": 3e-7},
            {"x": 7e-7, "y": 7e-7},
            "(a plate that is not level): the plate falls by 1.0004 +- 0.0007 mrad towards -x "
            "(1429 standard errors from zero), y +0.3 +- 0.7 urad (not significant); jointly 9 sigma",
        ),
        (
            "plate_tilt",
            {"x": 1.001e-3, "y": -4.997e-4},
            {"x": 7e-7, "y": 7e-7},
            "the plate falls by 1.0010 +- 0.0007 mrad towards +x (1430 standard errors from zero) "
            "and 499.7 +- 0.7 urad towards -y (714 standard errors from zero); jointly 9 sigma",
        ),
        (
            "mass_mismatch",
            {"excess": -0.02},
            {"excess": 1e-3},
            "ball a is lighter by the fraction 0.020 +- 0.001 (9 sigma)",
        ),
        (
            "mass_mismatch",
            {"excess": 0.02},
            {"excess": math.inf},
            "is heavier by the fraction 0.02, without an error (9 sigma)",
        ),
        ("stribeck", {"rise": -0.2}, {"rise": 0.01}, "friction is smaller at slow slip, rise -0.20 +- 0.01 (9 sigma)"),
        ("air_drag", {"share": 0.5}, {"share": 0.1}, "(the drag of air): share +0.5 +- 0.1 (9 sigma)"),
    ],
)
def test_a_claim_says_what_the_sign_of_its_strength_means(effect, values, std, text):
    values, std = ({f"{effect}.{k}": v for k, v in each.items()} for each in (values, std))
    assert describe_claim(EffectClaim(effect, values, std, 9.0, (effect,)), Model()).endswith(text)


def test_each_meaning_has_a_text_for_either_sign():
    told = [p for kind in library().values() for p in kind.parameters() if any(p.meaning)]
    assert len(told) > 20
    for p in told:
        assert not p.fixed
        assert p.low < 0 < p.high
        assert len(set(p.meaning) - {""}) == 2


def test_a_body_on_air_glides_and_a_ball_slides():
    one = Disagreement(phase="sliding", ball="ball 2", observable="along", sigma=6.0)
    for friction, word in ((0.0, "gliding"), (0.2, "sliding")):
        text = describe_disagreement(one, Model().replace({"sliding_friction": friction}))
        assert text == f"ball 2 {word}, along its motion"


def test_scatter_is_given_in_the_units_of_the_bench():
    text = " ".join(describe_stretch_scatter(StretchScatter(0.054, 0.041, 5.7e-4, 0.15, 33.6)))
    for part in ("5.4 %", "0.041 m/s^2", "0.57 mm rms", "150 mm", "likelihood ratio is 34", "tracker warp"):
        assert part in text
    assert "warp" not in " ".join(describe_stretch_scatter(StretchScatter(displacement_m=5.7e-4, reach_m=0.15)))
    unlimited = describe_stretch_scatter(StretchScatter(friction=0.05, loss_m_s2=68.0, unlimited=("loss_m_s2",)))[0]
    assert "68" not in unlimited
    assert "the sliding friction scatters by 5 % and the rolling loss scatters by an amount that the pos" in unlimited
    assert describe_stretch_scatter(StretchScatter()) == []
    air = StretchScatter(loss_m_s2=0.54, across_m_s2=0.16, lasts_s=0.14, speed_power=1, speed_m_s=0.53)
    text = " ".join(describe_stretch_scatter(air))
    for part in ("0.54 m/s^2", "0.16 m/s^2", "at 0.53 m/s, in proportion to the speed", "within 140 ms"):
        assert part in text
    assert "Student" not in text
    tails = "A few stretches have far larger accelerations (Student's t with 2 degrees of freedom)."
    assert tails in describe_stretch_scatter(dataclasses.replace(air, freedom=2.0))
    assert "rolling" not in text


def test_the_verdict_on_stretches_is_not_that_on_contacts():
    plain = dataclasses.replace(RECOIL, causes=())
    words = [
        describe_verdict(SimpleNamespace(verdict=Verdict.NONE, data=SimpleNamespace(is_cut=is_cut), contacts=contacts))
        for is_cut, contacts in ((False, ()), (True, (plain,)), (True, (RECOIL, plain)))
    ]
    laws = "the struck body seems heavier by a share or ball a is heavier by a share"
    law = f"{laws} (mass_mismatch or hop, 5.0 sigma)"
    assert words == ["none", "none between contacts", f"none between contacts; contacts show: {law}"]


def test_causes_that_contacts_cannot_distinguish_come_with_a_measurement():
    text, _ = describe_contacts([RECOIL], Model())
    assert "+2 +- 0.4 % more mass" in text
    assert "The contacts show mass_mismatch or hop. Weigh the bodies" in text
    assert "fit nearly as well: ball a is heavier by a share" in text


def test_laws_that_contacts_exclude_are_listed():
    claim = dataclasses.replace(RECOIL, excluded=("ball 1 is heavier by a share", "ball 2 is heavier by a share"))
    text, _ = describe_contacts([claim], Model())
    assert "Excluded: ball 1 is heavier by a share; ball 2 is heavier by a share." in text
    assert "Excluded" not in describe_contacts([RECOIL], Model())[0]


def test_a_cause_that_the_model_has_is_not_called_missing():
    shares = dataclasses.replace(RECOIL, quantity="friction", causes=("spin_transfer", "ball_friction"))
    without = Model().replace({"spin_transfer": 0.0})
    assert "already" not in " ".join(describe_contacts([shares], without))
    text = " ".join(describe_contacts([shares], without.replace({"spin_transfer": 0.12})))
    assert "not compared with the impact of the model" in text
    assert "The model has spin_transfer already" in text


def test_each_reason_to_reject_has_words_of_its_own():
    passing = HeldOutTest((1.0, 0.9), 9.0, 9.0)
    tests = [
        ClaimTest("hop", 5.0, passing, passing, why, False, ("hop.bounce", 1.0), StrengthVariation("speed", 6.0))
        for why in Rejection
    ]
    assert len({describe_rejection(test) for test in tests} - {""}) == len(Rejection)
