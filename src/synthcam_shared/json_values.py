"""Values that JSON can hold: no numpy, and null for what is not finite."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def replace_non_finite(value: Any) -> Any:
    """Convert values to those that JSON can hold: None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(k): replace_non_finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [replace_non_finite(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
