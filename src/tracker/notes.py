"""Notes: what the tracker assumed, converted or found unusual, as typed values with their text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum


class NoteKind(Enum):
    """The subject of a note; decisions read this, never the text.

    Examples
    --------
    >>> import tracker
    >>> tracker.NoteKind("noise") is tracker.NoteKind.NOISE
    True
    """

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
    EDIT = "edit"  # corrections by hand, from a file of edits
    REPAIR = "repair"  # positions of a table that were exchanged back, left out or renumbered
    STRIKER = "striker"  # which ball strikes is not stated
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

    Examples
    --------
    >>> import tracker
    >>> print(tracker.Note(tracker.NoteKind.GREY, "colour converted to grey"))
    colour converted to grey
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


def make_notes(kind: NoteKind, texts: Iterable[str], clip: int | None = None) -> list[Note]:
    """Make notes of one kind; empty texts make none."""
    return [Note(kind, text, clip) for text in texts if text]
