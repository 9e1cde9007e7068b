"""Compares a frame with its background: the still background of a film, its takes, and the regions that differ."""
