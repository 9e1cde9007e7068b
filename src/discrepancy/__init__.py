"""Where do simulation and measurement disagree, and what is missing from the model?"""

from importlib.metadata import version

__version__ = version("synthcam")
