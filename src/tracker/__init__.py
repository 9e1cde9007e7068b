"""Finds, follows and measures rolling balls in video. Knows nothing of how the video was made."""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tracker.camera.camera import Camera as Camera
    from tracker.camera.camera_json import InputError as InputError
    from tracker.recording import Result as Result
    from tracker.recording import measure as measure
    from tracker.recording import track as track

__version__ = version("synthcam")
__all__ = ["Camera", "InputError", "Result", "__version__", "measure", "track"]

_HOMES = {
    "Camera": "camera.camera",
    "InputError": "camera.camera_json",
    "Result": "recording",
    "measure": "recording",
    "track": "recording",
}


def __getattr__(name: str) -> Any:
    """A public name from its module, imported when first asked for: what tracks takes long to load."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
