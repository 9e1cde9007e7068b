"""Comparison of entries: leaderboard, figures, page."""
