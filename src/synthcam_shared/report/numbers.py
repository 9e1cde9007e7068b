"""Numbers as text: so many significant digits, or a value with the error of its last digits."""

import math
from typing import Any

NOT_KNOWN = "–"


def format_number(value: Any, digits: int = 3) -> str:
    """Format a number for a table; digits: the significant ones of a float.

    A whole number and a text are shown as they are, and None, NaN and infinity as "–". A float has a power of ten only
    under 0.001 and from a million on.
    """
    if isinstance(value, int | str):
        return str(value)
    if value is None or not math.isfinite(value):
        return NOT_KNOWN
    rounded = float(f"{value:.{digits}g}")
    if rounded == 0 or 1e-3 <= abs(rounded) < 1e6:
        return f"{rounded:.15g}"
    mantissa, _, exponent = f"{rounded:.{digits - 1}e}".partition("e")
    raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    return f"{mantissa}·10{str(int(exponent)).translate(raised)}"


def format_percent(value: float) -> str:
    """Format a share as a number of whole per cent."""
    return f"{100 * value:.0f} %" if math.isfinite(value) else NOT_KNOWN


def format_with_error(value: float | None, std: float | None) -> str:
    """Format a value with its standard error in brackets, as 0.9027(12): two digits of the error.

    Without an error the value has four digits; without a value the text is "–".
    """
    if value is None or not math.isfinite(value):
        return NOT_KNOWN
    if std is None or not math.isfinite(std) or std <= 0:
        return f"{value:.4g}"
    std = float(f"{std:.2g}")
    digits = 1 - math.floor(math.log10(std))
    if digits < 0:
        return f"{value:.0f}({std:.0f})"
    return f"{value:.{digits}f}({std * 10**digits:.0f})"


def round_to_error(value: float, std: float, digits: int) -> str:
    """Format a value to the precision of `digits` digits of its error, or to three digits without an error."""
    if not (math.isfinite(std) and std > 0 and value):
        return f"{value:.3g}"
    places = digits - 1 - math.floor(math.log10(float(f"{std:.{digits - 1}e}")))
    figures = max(places + math.floor(math.log10(abs(value))) + 1, 1)
    if abs(value) < 1e-4:
        return f"{value:.{figures - 1}e}"
    return f"{value:.{places}f}" if places > 0 else f"{value:.{figures}g}"
