"""Entries beside one another: leaderboard, pictures, page."""
