"""The public names, listed once."""

from .camera.render import NoGL as NoGL
from .dataset.labelled_frames import LabelledFrame as LabelledFrame
from .dataset.labelled_frames import stream as stream
from .dataset.recorded_dataset import Dataset as Dataset
from .dataset.recorded_dataset import RecordedClip as RecordedClip
from .dataset.recorded_dataset import RecordedFilm as RecordedFilm
from .dataset.recorded_dataset import open_dataset as open_dataset
from .library import add_effects as add_effects
from .model import Ball as Ball
from .model import Model as Model
from .scene.clip import Clip as Clip
from .scene.motion import Motion as Motion
from .scene.scene import Scene as Scene
from .settings import InputError as InputError

__version__: str
__all__ = [
    "Ball",
    "Clip",
    "Dataset",
    "InputError",
    "LabelledFrame",
    "Model",
    "Motion",
    "NoGL",
    "RecordedClip",
    "RecordedFilm",
    "Scene",
    "__version__",
    "add_effects",
    "open_dataset",
    "stream",
]
