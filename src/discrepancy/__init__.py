"""Find where simulation and measurement disagree, and which physics the model lacks."""

from importlib.metadata import version

import lazy_loader

__version__ = version("synthcam")
# Load each import of __init__.pyi at its first use, because drawing and fitting take long to load.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
