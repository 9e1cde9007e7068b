"""Where do simulation and measurement disagree, and what is missing from the model?"""

from importlib.metadata import version

import lazy_loader

__version__ = version("synthcam")
# What __init__.pyi imports, when it is first asked for: what draws or fits takes long to load.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
