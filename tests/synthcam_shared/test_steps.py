"""Steps within one job are shown by the progress that asks for their unit, and by no other."""

from synthcam_shared.steps import report_step, showing_steps


def test_the_innermost_progress_of_a_unit_shows_its_steps():
    outer, inner = [], []
    report_step("frames", 1, 9)
    with showing_steps("frames", lambda *step: outer.append(step)):
        report_step("frames", 2, 9)
        report_step("contacts", 3, 9)
        with showing_steps("contacts", lambda *step: inner.append(step)):
            report_step("contacts", 4, 9)
            report_step("frames", 5, 9)
        report_step("frames", 6, 9)
    report_step("frames", 7, 9)
    assert outer == [(2, 9), (6, 9)]
    assert inner == [(4, 9)]
