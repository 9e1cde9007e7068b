"""A search takes no clip whose contact lasts for evidence: its models have impacts that take no time."""

import numpy as np
import pandas as pd
import pytest
from tracker_contacts import SoftHit

from discrepancy import cli
from discrepancy.data.notes import SearchNote, SearchNoteKind, count_lost_clips, sort_notes
from discrepancy.data.reading import read_collisions
from synthcam_shared.errors import InputError

INSTANT = SoftHit(0.0, 0.9, friction=0.2, b=0.2)


def read(*hits):
    parts = [hit.tracks(np.random.default_rng(k)).assign(clip=k, striker="b") for k, hit in enumerate(hits)]
    table = pd.concat(parts)
    camera = INSTANT.camera | {"scale": 1e-3, "size": [640, 480]}
    table[["x", "y"]] = (table[["x", "y"]] + 0.2) / 1e-3
    return read_collisions(table, camera)


@pytest.mark.parametrize(
    ("hit", "why"),
    [
        (SoftHit(0.014, 0.9, friction=0.2, b=0.2), "the contact lasts 1"),
        (SoftHit(0.014, 0.9, b=0.2), "the contact lasts 1"),
        (SoftHit(0.012, sticky=True, after=180), "the balls stay together"),
        (SoftHit(0.028, 0.4, v0=0.15, friction=0.2), "the contact lasts as long as the balls may slide"),
        (SoftHit(0.02, 0.9, after=14), "too few frames outside the contact"),
    ],
)
def test_a_contact_that_lasts_is_left_out_with_a_note(hit, why):
    clips, notes = read(INSTANT, hit)
    assert [clip.clip for clip in clips] == [0]
    (note,) = sort_notes(notes).left_out
    assert (note.kind, note.clip) == (SearchNoteKind.CONTACT_LASTS, 1)
    assert str(note).startswith(f"clip 1: {why}")
    assert count_lost_clips(notes) == 1


def test_without_any_other_clip_the_contact_is_named():
    with pytest.raises(InputError, match="no clip with a measured collision; clip 0: the contact lasts 1"):
        read(SoftHit(0.014, 0.9, b=0.2))


def test_a_contact_that_may_be_one_of_smaller_balls_is_used_and_noted():
    """diameter_mismatch is the effect that looks the same, so the clip is evidence of one or the other."""
    clips, notes = read(INSTANT, SoftHit(0.0015, 0.9, fps=250.0, friction=0.2))
    assert len(clips) == 2
    (note,) = sort_notes(notes).common
    assert note.kind is SearchNoteKind.CONTACTS_MAY_LAST
    assert "diameter_mismatch" in str(note)


def test_a_repair_is_printed_as_what_was_done_to_the_tracks(capsys):
    repaired = SearchNote(SearchNoteKind.REPAIRED, 3, (8,), {"text": "balls exchange their numbers in frame 8"})
    strays, lost = SearchNote(SearchNoteKind.STRAYS, 1, (4,)), SearchNote(SearchNoteKind.NO_ESTIMATE, 2)
    no_striker = SearchNote(SearchNoteKind.NO_STRIKER, values={"text": "?"})
    given = sort_notes([repaired, strays, no_striker, lost])
    assert (given.left_out, given.processed, given.common) == ((strays, lost), (repaired,), (no_striker,))
    assert count_lost_clips([repaired, strays, no_striker, lost]) == 1
    cli._print_notes([str(note) for note in given.processed], [str(note) for note in given.left_out], most=False)
    tracks, left = capsys.readouterr().out.splitlines()
    assert tracks == "Tracks: clip 3: balls exchange their numbers in frame 8."
    assert left.startswith("Left out: clip 1")
