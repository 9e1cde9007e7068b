"""Rolling steel balls: their exact motion, their picture, and the truth about both."""

from importlib.metadata import version

__version__ = version("synthcam")
