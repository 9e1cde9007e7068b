"""Finds, follows and measures rolling balls in video. Knows nothing of how the video was made."""

from importlib.metadata import version

__version__ = version("synthcam")
