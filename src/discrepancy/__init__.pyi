"""The public names, listed once."""

from .data.collisions import InputError as InputError
from .finding import Finding as Finding
from .finding import find as find

__version__: str
__all__ = ["Finding", "InputError", "__version__", "find"]
