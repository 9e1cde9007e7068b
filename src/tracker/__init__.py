"""Finds, follows and measures rolling balls in video. Knows nothing of how the video was made."""

from importlib.metadata import version

import lazy_loader

__version__ = version("synthcam")
# Names of __init__.pyi are imported when they are first used, because plotting and fitting load slowly.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
