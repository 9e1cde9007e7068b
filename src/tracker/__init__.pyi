"""The public names, listed once."""

from . import benchmark as benchmark
from .camera.camera import Camera as Camera
from .camera.camera_json import InputError as InputError
from .recording import Result as Result
from .recording import measure as measure
from .recording import track as track

__version__: str
__all__ = ["Camera", "InputError", "Result", "__version__", "measure", "track"]
