"""A camera file from a video of balls of known diameter."""
