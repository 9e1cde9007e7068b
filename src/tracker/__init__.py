"""Finds, follows and measures rolling balls in video. Knows nothing of how the video was made."""
