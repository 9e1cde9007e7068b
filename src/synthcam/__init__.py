"""Rolling steel balls: their exact motion, their picture, and the truth about both."""

from importlib.metadata import version

import lazy_loader

__version__ = version("synthcam")
# The names of __init__.pyi are imported when they are first used: drawing and fitting take long to load.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
