"""Numbers as people read them."""

import math

import pytest

from synthcam_shared.report.numbers import format_number, format_percent, round_to_error


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (480.0, 2, "480"),
        (0.5, 3, "0.5"),
        (12345.6, 3, "12300"),
        (-0.00123456, 3, "-0.00123"),
        (0.0, 3, "0"),
        (6.4e-5, 3, "6.40·10⁻⁵"),
        (-2.5e7, 2, "-2.5·10⁷"),
        (7, 3, "7"),
        ("open", 3, "open"),
        (None, 3, "–"),
        (math.nan, 3, "–"),
        (math.inf, 3, "–"),
    ],
)
def test_significant_digits_and_powers_of_ten(value, digits, text):
    assert format_number(value, digits) == text


def test_shares_are_whole_per_cent():
    assert (format_percent(0.683), format_percent(math.nan)) == ("68 %", "–")


@pytest.mark.parametrize(
    ("value", "std", "digits", "shown"),
    [
        (0.001001, 7.4e-7, 1, "0.0010010"),
        (0.001001, 7.4e-7, 2, "0.00100100"),
        (-0.4567, 0.0996, 1, "-0.5"),
        (3.21e-6, 4e-8, 1, "3.21e-06"),
        (31.4, 2.0, 1, "31"),
        (0.02, 1.0, 1, "0.02"),
        (0.5, math.inf, 1, "0.5"),
    ],
)
def test_a_value_is_shown_as_far_as_its_error_goes(value, std, digits, shown):
    assert round_to_error(value, std, digits) == shown
