"""Figures of the errors of all clips, where some estimates are missing."""

import numpy as np
import pandas as pd

from tracker.scoring.score_page import draw_error_bars


def test_a_kind_of_estimate_without_a_value_has_a_panel_that_says_so():
    """A histogram of nothing divides zero by zero, and warnings are errors here."""
    table = pd.DataFrame({"status": "ok", "r": [0.9, 0.8], "r_std": 0.01, "r_true": [0.91, 0.79], "v0_true": 0.3})
    panels = draw_error_bars(table.assign(r_local=np.nan, r_local_std=np.nan)).axes
    drawn = [sum(patch.get_height() for patch in axes.patches) for axes in panels]
    assert drawn[0] > 0
    assert drawn[1:] == [0, 0]
    assert [[text.get_text() for text in axes.texts] for axes in panels[1:]] == [["no clip has this estimate"]] * 2
    assert not panels[0].texts
