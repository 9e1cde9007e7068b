"""Notes: what the tracker assumed, converted or found unusual, as typed values with their text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tracker.camera.camera import Camera


class NoteKind(Enum):
    """What a note is about; decisions read this, never the text."""

    CHANNEL = "channel"  # which colour channel was taken
    GREY = "grey"  # colour was converted to grey
    LINEAR = "linear"  # counts were made linear in light
    DETECTOR = "detector"  # which detector was taken, and what it noticed
    ASSUMED = "assumed"  # keys of the camera file that are assumed or estimated
    MISSING = "missing"  # keys of the camera file without which something cannot be measured
    UNMODELLED = "unmodelled"  # keys of the camera file that the tracker does not account for
    FILM = "film"  # faults of a film's file
    TIMING = "timing"  # frame rate or exposure differ from the camera file
    LINKING = "linking"  # tracks that begin or end inside the picture
    TABLE = "table"  # how a table of tracks was read
    MISFIT = "misfit"  # collisions that the model does not describe
    FLAG = "flag"  # collisions with a flag
    NOISE = "noise"  # errors of positions that differ from the claimed ones


@dataclass(frozen=True)
class Note:
    """One thing that a user has to know.

    Attributes
    ----------
    kind : NoteKind
    text : str
        The sentence to print; `str(note)` gives it too.
    clip : int, optional
        The recording it is about; two notes are equal whatever their clip and frames.
    frames : tuple of int
        The frames it is about; empty: all of them.
    """

    kind: NoteKind
    text: str
    clip: int | None = field(default=None, compare=False)
    frames: tuple[int, ...] = field(default=(), compare=False)

    def __str__(self) -> str:
        return self.text


COLOUR_TO_GREY = Note(NoteKind.GREY, "colour converted to grey")
MADE_LINEAR = Note(NoteKind.LINEAR, "sensor.gamma: counts are made linear in light before anything else")
NO_CAMERA_FILE = Note(
    NoteKind.MISSING,
    "no camera file: positions in px only; `tracker calibrate FILM --diameter M --fps HZ -o camera.json` makes one",
)


def note_all(kind: NoteKind, texts: Iterable[str], clip: int | None = None) -> list[Note]:
    """Make notes of one kind; empty texts make none."""
    return [Note(kind, text, clip) for text in texts if text]


def describe_camera_gaps(camera: Camera) -> list[Note]:
    """Make notes of what the camera file leaves out and of what in it is not accounted for."""
    assumed = [name for name in camera.assumed if name != "ball_diameter" and camera.metric]
    notes = note_all(NoteKind.ASSUMED, [f"assumed or estimated: {', '.join(assumed)}"] if assumed else [])
    if camera.metric and not camera.knows_diameter:
        text = "ball_diameter: not given; collisions are not measured, and glints are not taken to centres"
        notes.append(Note(NoteKind.MISSING, text))
    return notes + note_all(NoteKind.UNMODELLED, camera.unmodelled)


def describe_exposure(camera: Camera, key: str) -> list[Note]:
    """Make a note where the motion blur differs from the exposure in the camera file; `key` holds the one seen."""
    if camera.exposure_from_blur is None:
        return []
    kind = "longer" if camera.exposure_from_blur > camera.exposure else "shorter"
    return [Note(NoteKind.TIMING, f"exposure: motion blur is {kind} than it makes it; taken as it is seen ({key})")]


def describe_frame_rate(camera: Camera, claimed: float, tolerance: float = 0.01) -> list[Note]:
    """Make a note where a video file claims another frame rate: slow motion, or a wrong camera file.

    claimed: in frames per second; NaN or 0 where the file claims none. tolerance: 29.97 counts as 30.
    """
    if not camera.metric or not claimed > 0 or abs(claimed / camera.fps - 1) < tolerance:
        return []
    text = f"fps: {camera.fps:g} in the camera file, {claimed:g} in the video's; check which is that of the exposures"
    return [Note(NoteKind.TIMING, text)]
