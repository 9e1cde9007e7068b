"""Values for JSON."""

import json

import numpy as np

from synthcam_shared.json_values import replace_non_finite


def test_json_holds_what_numpy_gives():
    given = {
        "rows": (np.float64(0.5), float("nan"), np.inf, np.int64(3), np.True_),
        7: np.array([[1.0, np.nan], [-np.inf, 2.0]]),
        "text": "nan",
    }
    expected = '{"rows": [0.5, null, null, 3, true], "7": [[1.0, null], [null, 2.0]], "text": "nan"}'
    assert json.dumps(replace_non_finite(given), allow_nan=False) == expected
