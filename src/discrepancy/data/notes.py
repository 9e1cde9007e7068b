"""Typed notes on clips: what a search leaves out and why, and what was done to the tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any


class SearchNoteKind(Enum):
    """The subject of a note; its value is the text, a template for the note's values."""

    # a clip that is left out
    BALLS_EXCHANGED = "the two balls exchange their numbers at frame {frames}"
    UNEVEN_TIMES = "its times are up to {off:.2g} frames off an even rate of {fps:g} per second"
    SEVERAL_COLLISIONS = "{count} collisions in one recording"
    NOT_MEASURED = "{status}"
    NO_ESTIMATE = "no estimate of the contact"
    CONTACT_LASTS = "{why}: the impacts of a model take no time, so this clip is no evidence"
    TOO_FEW_FRAMES = "a ball is seen in fewer than {least} frames before the contact"
    LOST_TO_FILTER = (
        "too few positions of a ball remain before or after the contact, without those that a smoothing filter moves"
    )
    UNLIKE_OTHERS = "chi^2 per point is {chi2:.3g}, far above all other clips with every model{held_out}"
    CONTRADICTS_OTHERS = "its shared parameters contradict all other clips by {sigma:.0f} sigma{held_out}"
    NO_FREE_MOTION = (
        "no free motion, with any friction and rolling loss, in {count} of {total} stretches, which begin in frame "
        "{frames}: chi^2 is up to {ratio:.2g} times the usual, and a ball may have met another"
    )
    # positions that are left out
    STRAYS = "positions of another ball, in frame {frames}, to which a ball jumps and back"
    OUTLIERS = "{count} of {total} positions, in frame {frames}, far off the path through their neighbours"
    # what was done to the tracks
    REPAIRED = "{text}"
    SMOOTHED = (
        "positions have been smoothed by a filter, which moves them near hits, gaps and ends by more than their noise; "
        "give them as they were measured"
    )
    ROUNDED = (
        "positions are rounded to {step:.3g} px: their errors are not random but depend on the position; "
        "give all digits"
    )
    THINNED = "positions less than {least_mm:.3g} mm from the previous one are missing: slow balls are hardly seen"
    MOVED_TO_EVEN_TIMES = (
        "frames are at uneven times, up to {off:.2g} frames off an even rate: positions are moved along their paths to "
        "even times, and those at the contact are left out"
    )
    # what the errors of the positions depend on
    FRAME_SHIFT = (
        "positions in odd frames are off those in even frames by {x_um:.2g} um in x and {y_um:.2g} um in y, and "
        "{late_ms:.2g} ms late ({sigma:.0f} sigma), as in interlaced film: the search removes this shift"
    )
    NOISE_BY_SPEED = "the noise changes by a factor of {ratio:.2g} with the speed ({sigma:.0f} sigma): errors rescaled"
    NOISE_BY_PLACE = (
        "the noise changes by a factor of {ratio:.2g} with the position ({sigma:.0f} sigma): errors rescaled"
    )
    NOISE_BY_BALL = "the noise of the two balls differs by a factor of {ratio:.2g} ({sigma:.0f} sigma): errors rescaled"
    NOISE_BY_PARITY = (
        "the noise of odd and of even frames differs by a factor of {ratio:.2g} ({sigma:.0f} sigma): errors rescaled"
    )
    # what many clips have in common
    CONTACTS_MAY_LAST = (
        "the paths cross within one diameter in {count} of the clips: contacts of about {duration_ms:.2g} ms and "
        "diameter_mismatch look the same"
    )
    NO_STRIKER = "who strikes: {text}"
    ONE_SPEED = "all clips are at {speed:.2g} m/s: they hardly show how {laws} depends on the speed"
    ONE_IMPACT_PARAMETER = (
        "all clips have b near {b:.2f}: they show nothing that depends on it, and hop and mass_mismatch look the same"
    )
    ONE_HEADING = (
        "all clips go one way: a tilt of the plate, a grain or a tilted camera can hardly be distinguished from drag"
    )


@dataclass(frozen=True)
class SearchNote:
    """One note; `str` gives its text, with the first few frames."""

    kind: SearchNoteKind
    clip: int | None = None  # that it concerns; None: it concerns all
    frames: tuple[int, ...] = ()  # that it concerns
    values: dict[str, Any] = field(default_factory=dict)  # the numbers and words that the text of this kind contains

    def __str__(self) -> str:
        shown = 5  # frames, of those that the note concerns
        frames, more = ", ".join(map(str, self.frames[:shown])), len(self.frames) - shown
        text = self.kind.value.format(frames=frames + (f" and {more} more" if more > 0 else ""), **self.values)
        return text if self.clip is None else f"clip {self.clip}: {text}"


@dataclass(frozen=True)
class NotesByTopic:
    """Notes by what they are about."""

    left_out: tuple[SearchNote, ...]  # clips, or positions of a clip, that are not used
    processed: tuple[SearchNote, ...]  # what was done to tracks that are used
    common: tuple[SearchNote, ...]  # what many clips have in common


def sort_notes(notes: Sequence[SearchNote]) -> NotesByTopic:
    """Sort the typed notes of `read_collisions`: on clips left out, on processed tracks, and on all clips."""
    kinds = SearchNoteKind.REPAIRED, SearchNoteKind.NO_STRIKER, SearchNoteKind.CONTACTS_MAY_LAST
    processed = tuple(note for note in notes if note.kind is kinds[0])
    common = tuple(note for note in notes if note.kind in kinds[1:])
    return NotesByTopic(tuple(note for note in notes if note.kind not in kinds), processed, common)


def count_lost_clips(notes: Sequence[SearchNote]) -> int:
    """Count the clips that a search leaves out by its notes; other notes are about clips that are used."""
    return sum(note.kind is not SearchNoteKind.STRAYS for note in sort_notes(notes).left_out)
