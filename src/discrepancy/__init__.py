"""Where do simulation and measurement disagree, and what is missing from the model?"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from discrepancy.finding import Finding as Finding
    from discrepancy.finding import find as find
    from tracker.camera.camera_json import InputError as InputError

__version__ = version("synthcam")
__all__ = ["Finding", "InputError", "__version__", "find"]

_HOMES = {
    "Finding": "finding",
    "InputError": "data.collisions",
    "find": "finding",
}


def __getattr__(name: str) -> Any:
    """A public name from its module, imported when first asked for: what fits takes long to load."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
