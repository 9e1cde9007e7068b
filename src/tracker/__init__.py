"""Finds, follows and measures rolling balls in video. Knows nothing of how the video was made."""

from synthcam_shared.lazy_names import attach_names

# Names of __init__.pyi are imported when they are first used: drawing, plotting and fitting load slowly.
__getattr__, __dir__ = attach_names(__name__, __file__)
