"""The public names, listed once."""

from . import benchmark as benchmark
from .camera.camera import Camera as Camera
from .camera.camera_json import InputError as InputError
from .gas.observe import Gas as Gas
from .gas.observe import observe_gas as observe_gas
from .notes import Note as Note
from .notes import NoteKind as NoteKind
from .recording import Result as Result
from .recording import measure as measure
from .recording import measure_all as measure_all
from .recording import track as track
from .sets.combined_set import CombinedSet as CombinedSet
from .sets.combined_set import combine as combine
from .settings import DetectionSettings as DetectionSettings
from .settings import FitSettings as FitSettings
from .settings import LinkSettings as LinkSettings
from .settings import TrackerSettings as TrackerSettings

__version__: str
__all__ = [
    "Camera",
    "CombinedSet",
    "DetectionSettings",
    "FitSettings",
    "Gas",
    "InputError",
    "LinkSettings",
    "Note",
    "NoteKind",
    "Result",
    "TrackerSettings",
    "__version__",
    "combine",
    "measure",
    "measure_all",
    "observe_gas",
    "track",
]
