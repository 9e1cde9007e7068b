"""Scores of a tracker's results against the truth of a suite: positions, quantities, effects of its defects."""
