"""Rolling steel balls: their exact motion, their picture, and the truth about both."""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synthcam.camera.render import NoGL as NoGL
    from synthcam.model import Ball as Ball
    from synthcam.model import Model as Model
    from synthcam.scene.clip import Clip as Clip
    from synthcam.scene.motion import Motion as Motion
    from synthcam.scene.scene import Scene as Scene
    from synthcam.settings import InputError as InputError

__version__ = version("synthcam")
__all__ = ["Ball", "Clip", "InputError", "Model", "Motion", "NoGL", "Scene", "__version__"]

_HOMES = {
    "Ball": "model",
    "Clip": "scene.clip",
    "InputError": "settings",
    "Model": "model",
    "Motion": "scene.motion",
    "NoGL": "camera.render",
    "Scene": "scene.scene",
}


def __getattr__(name: str) -> Any:
    """A public name from its module, imported when first asked for: what draws or fits takes long to load."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
