"""The protocol of a detector: it is made from a `View` and returns `Glints`, or `Detections` of a whole clip.

A detector is a class, made once a clip from a `View`. It has one of two forms:

- `FrameDetector`: it is called with each frame and returns the `Glints` of that frame;
- `ClipDetector`: its ``detect`` takes all frames of the clip and returns `Detections`.

One class attribute is optional: ``point`` says what x and y are. It is "glint" (the default), "centre" (of the ball's
outline), or "either". The latter is the centre if the camera file says that balls are matte, otherwise the glint. For a
detector of centres ``view.takes`` is there and ``view.plate`` is only the first frame; for one of glints ``view.takes``
is None.

A detector has no other hooks. ``detectors/opencv_components.py`` is a short example of the first form.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

from numpy.typing import NDArray

from synthcam_shared.arrays import Flags
from tracker.camera.camera import Camera
from tracker.camera.frames import GREY
from tracker.detection.background.takes import FilmTakes
from tracker.detection.candidates import EmptyPlate
from tracker.detection.glints import Glints
from tracker.detection.motion_blur import MotionBlurEvidence
from tracker.settings import TrackerSettings

Point: TypeAlias = Literal["glint", "centre"]


@dataclass(frozen=True, eq=False)
class View:
    """The knowledge of a detector about a clip. It contains no truth."""

    camera: Camera  # the camera file; for a detector of glints, what the file left open is estimated from the clip
    plate: EmptyPlate  # the picture without balls: `level` (h, w) counts, `noise` counts a pixel a frame, `hot` pixels
    frames: Sequence[Any] = ()  # all frames, grey (h, w), uint8 or uint16; each is read when it is indexed
    takes: FilmTakes | None = None
    """For a detector of centres: the takes of the film, repeated frames, and the noise of a pixel."""
    settings: TrackerSettings = field(default_factory=TrackerSettings)
    """The user's settings; detectors use ``settings.detection``."""
    area: Flags | None = None
    """The pixels (h, w) among which balls are searched; None: all. Positions outside are dropped, by any detector."""
    radius: float | None = None  # radius of the balls that the user points at, px
    channel: str = GREY  # which plane of a film in colour the frames are: "grey", "red", "red-blue", ...

    @property
    def sigma(self) -> float:
        """Gaussian width of a resting glint, px."""
        if self.camera.sigma is None:
            raise ValueError("the camera of a view has a width of glints: make it by make_view")
        return self.camera.sigma


@dataclass(frozen=True, eq=False)
class OutlineRadius:
    """Radius of the balls' outlines, px: its median and the random error of that."""

    radius: float
    std: float


@dataclass(frozen=True, eq=False)
class Detections:
    """The result of a detector for a clip."""

    glints: Glints  # of all frames; `frame` holds their numbers
    notes: tuple[str, ...] = ()  # sentences for the user
    blur: MotionBlurEvidence | None = None
    """The exposure that the glints show; None where the detector does not measure their motion blur."""
    outline_radius: OutlineRadius | None = None  # of balls that are seen whole


@runtime_checkable
class FrameDetector(Protocol):
    """Finds the balls of one frame at a time."""

    def __call__(self, frame: NDArray[Any], /) -> Glints:
        """The balls of one grey (h, w) frame. Their frame number is ignored; an error ends the run in one line."""


@runtime_checkable
class ClipDetector(Protocol):
    """Finds the balls of a whole clip."""

    def detect(self, frames: Iterable[tuple[int, NDArray[Any]]], /) -> Detections:
        """The balls of numbered frames, which come once and in order."""


@runtime_checkable
class SharedDetector(ClipDetector, Protocol):
    """A `ClipDetector` whose frames several processes can share: ``detect`` is `gather` of `examine` of each frame."""

    @property
    def can_share(self) -> bool:
        """True if no frame needs the result of another one."""

    def examine(self, number: int, frame: NDArray[Any], /) -> Any:
        """What one numbered frame shows. It must pickle, as the detector itself."""

    def gather(self, examined: Iterable[tuple[int, Any]], /) -> Detections:
        """The balls of numbered frames, which come once and in order, from what `examine` returned for each."""


AnyDetector: TypeAlias = FrameDetector | ClipDetector
DetectorClass: TypeAlias = Callable[[View], AnyDetector]
