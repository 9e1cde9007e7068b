"""Corrections of tracks by hand: a file of edits, which are applied in their order before anything is measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from pydantic import Field

from synthcam_shared.arrays import Flags, Ints
from synthcam_shared.errors import InputError
from synthcam_shared.settings import Positive, Settings, build_settings, read_settings
from tracker.detection.link import Tracks
from tracker.measurement.collision.contacts import MarkedContact
from tracker.notes import Note, NoteKind

EDITS = "edits.yaml"  # the name of the file beside results
BY_HAND = "by_hand"  # flag of a position that an edit has added
Number = Annotated[int, Field(ge=0, le=(1 << 31) - 1)]
Pixels = Annotated[float, Field(ge=-1e6, le=1e6)]


class Edit(Settings):
    """One correction. `ball` is the number of a particle, `frame` that of a frame, as in the tracks."""

    noun: ClassVar[str]
    clip: Number | None = None  # None: the only one
    ball: Number

    def change(self, tracks: Tracks) -> Tracks:
        """The tracks with this correction. Raises InputError where they lack what it names."""
        raise NotImplementedError

    def find(self, tracks: Tracks, frame: int | None = None) -> Flags:
        """The rows of the ball, or its row of one frame. Raises InputError where there are none."""
        rows = tracks.particle == self.ball
        rows &= frame is None or tracks.frame == frame
        if not rows.any():
            raise InputError(f"ball {self.ball} has no position{'' if frame is None else f' in frame {frame}'}")
        return np.asarray(rows)


class RemovePoint(Edit):
    """Take a position out of a track."""

    noun = "position removed"
    action: Literal["remove_point"]
    frame: Number

    def change(self, tracks: Tracks) -> Tracks:
        return tracks.take(~self.find(tracks, self.frame))


class RemoveTrack(Edit):
    """Take out all positions of a ball."""

    noun = "track removed"
    action: Literal["remove_track"]

    def change(self, tracks: Tracks) -> Tracks:
        return tracks.take(~self.find(tracks))


class Exchange(Edit):
    """Exchange the numbers of two balls from a frame on. `other` may be a new number, which cuts a track in two."""

    noun = "exchange of numbers"
    action: Literal["exchange"]
    other: Number
    frame: Number

    def change(self, tracks: Tracks) -> Tracks:
        late, swap = tracks.frame >= self.frame, {self.ball: self.other, self.other: self.ball}
        own = late & np.isin(tracks.particle, [*swap])
        if len(swap) < 2 or not own.any():
            pair = f"balls {self.ball} and {self.other}"
            raise InputError(f"{pair}: expected two different balls, one of them seen from frame {self.frame} on")
        particle = tracks.particle.copy()
        particle[own] = [swap[int(number)] for number in particle[own]]
        return _sort(replace(tracks, particle=particle))


class AddPoint(Edit):
    """Add a position that was measured by hand: x, y and the standard error of each, px."""

    noun = "position added"
    action: Literal["add_point"]
    frame: Number
    x: Pixels
    y: Pixels
    error: Annotated[Positive, Field(le=1e6)]

    def change(self, tracks: Tracks) -> Tracks:
        if ((tracks.particle == self.ball) & (tracks.frame == self.frame)).any():
            raise InputError(f"ball {self.ball} has a position in frame {self.frame}; remove that one before")
        cov, nan = self.error**2 * np.eye(2)[None], np.array([np.nan])
        time = nan
        if np.isfinite(tracks.time).any():
            frames, first = np.unique(tracks.frame, return_index=True)
            if not frames[0] <= self.frame <= frames[-1]:
                raise InputError(f"frame {self.frame}: expected {frames[0]} to {frames[-1]}, whose times are known")
            time = np.interp([self.frame], frames, tracks.time[first])
        frame, particle = (np.array([number], dtype=np.int64) for number in (self.frame, self.ball))
        xy, flags = (np.array([self.x]), np.array([self.y])), np.array([BY_HAND], dtype=np.str_)
        new = Tracks(frame, particle, *xy, cov, flux=nan, flags=flags, glint_x=nan, glint_y=nan, time=time)
        joined = {name: np.concatenate([values, getattr(new, name)]) for name, values in vars(tracks).items()}
        return _sort(replace(tracks, **joined))


class MarkContact(Edit):
    """Say that two balls touch in a frame, or within half a frame of it. The collision is measured there."""

    noun = "contact marked"
    action: Literal["mark_contact"]
    other: Number
    frame: Number

    def change(self, tracks: Tracks) -> Tracks:
        for number in (self.ball, self.other):
            ball = self.model_copy(update={"ball": number})
            seen = tracks.frame[ball.find(tracks)]
            if self.ball == self.other or not seen.min() < self.frame < seen.max():
                raise InputError(f"balls {self.ball} and {self.other}: expected two, seen before and after the frame")
        return tracks


AnyEdit: TypeAlias = RemovePoint | RemoveTrack | Exchange | AddPoint | MarkContact


class _EditsFile(Settings):
    """A file of edits."""

    edits: list[Annotated[AnyEdit, Field(discriminator="action")]] = Field(default_factory=list, max_length=10_000)


@dataclass(frozen=True)
class EditedTracks:
    """Tracks with the edits of their clip. notes: say how many; contacts: those that are marked."""

    tracks: Tracks
    contacts: tuple[MarkedContact, ...] = ()
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True)
class TrackEdits:
    """Edits in the order in which they are applied. where: what messages call their file."""

    edits: tuple[AnyEdit, ...] = ()
    where: str = EDITS

    @staticmethod
    def of(given: EditsSource | None) -> TrackEdits:
        """Edits from an object, keys and values, or a YAML file; None gives none. Raises InputError."""
        if given is None or isinstance(given, TrackEdits):
            return given or TrackEdits()
        if isinstance(given, str | Path):
            return TrackEdits(tuple(read_settings(Path(given), _EditsFile).edits), f"{given}")
        return TrackEdits(tuple(build_settings(given, _EditsFile, "edits").edits), "edits")

    def to_keys(self) -> dict[str, Any]:
        """The keys and values of the file, the action of each edit first; without the clip where there is only one."""
        every = [edit.model_dump(exclude_none=True) for edit in self.edits]
        return {"edits": [{"action": keys.pop("action"), **keys} for keys in every]}

    def write(self) -> str:
        """The text of the file: a line for each edit."""
        lines = [", ".join(f"{key}: {value}" for key, value in edit.items()) for edit in self.to_keys()["edits"]]
        return "".join(["edits:\n", *(f"- {{{line}}}\n" for line in lines)]) if lines else "edits: []\n"

    def check_clips(self, numbers: Collection[int]) -> None:
        """Raise InputError for an edit of a clip that is not there, or of none where there are several."""
        for k, edit in enumerate(self.edits):
            if edit.clip is None and len(numbers) > 1:
                raise InputError(f"{self.where}: edits.{k}: expected the key clip, as there are {len(numbers)} clips")
            if edit.clip is not None and edit.clip not in numbers:
                raise InputError(f"{self.where}: edits.{k}.clip: there is no clip {edit.clip}")

    def of_clip(self, clip: int) -> list[tuple[int, AnyEdit]]:
        """The edits of one clip, each with its position in the file."""
        return [(k, edit) for k, edit in enumerate(self.edits) if edit.clip in (None, clip)]

    def check_frames(self, clip: int, film: Ints) -> None:
        """Raise InputError for an edit of a frame outside the film of its clip, before anything is tracked."""
        for k, edit in self.of_clip(clip):
            self._check_frame(k, getattr(edit, "frame", int(film[0])), film)

    def _check_frame(self, k: int, frame: int, film: Ints) -> None:
        first, last = (int(film.min()), int(film.max())) if len(film) else (0, 0)
        if not first <= frame <= last:
            raise InputError(f"{self.where}: edits.{k}.frame: expected {first} to {last}, found {frame}")

    def apply(self, tracks: Tracks, clip: int, film: Ints | None = None) -> EditedTracks:
        """Apply the edits of one clip. Raises InputError for one that does not fit the tracks.

        film: numbers of its frames, to which positions may be added; None: from the first to the last of the tracks.
        """
        own = self.of_clip(clip)
        marks = [(k, edit) for k, edit in own if isinstance(edit, MarkContact)]
        for k, edit in own:
            if isinstance(edit, AddPoint):
                self._check_frame(k, edit.frame, tracks.frame if film is None else film)
        for k, edit in (*own, *marks):  # a later edit may have taken out a ball of a contact
            try:
                tracks = edit.change(tracks)
            except InputError as error:
                raise InputError(f"{self.where}: edits.{k} ({edit.action}): {error}") from None
        contacts = tuple(MarkedContact(edit.ball, edit.other, edit.frame) for _, edit in marks)
        for (one, (j, _)), (other, (k, _)) in combinations(zip(contacts, marks, strict=True), 2):
            if one.is_near(other[:2], other.frame):
                where = f"{self.where}: edits.{k} (mark_contact)"
                raise InputError(f"{where}: edits.{j} marks this contact, in frame {one.frame}; keep one of the two")
        counts = Counter(edit.noun for _, edit in own)
        nouns = [(count, *noun.partition(" ")) for noun, count in counts.items()]
        text = ", ".join(f"{count} {first}{'s' * (count > 1)} {rest}" for count, first, _, rest in nouns)
        notes = (Note(NoteKind.EDIT, f"edited by hand: {text}", clip),) if own else ()
        return EditedTracks(tracks, contacts, notes)


EditsSource: TypeAlias = TrackEdits | Mapping[str, Any] | str | Path


def _sort(tracks: Tracks) -> Tracks:
    return tracks.take(np.lexsort((tracks.frame, tracks.particle)))
