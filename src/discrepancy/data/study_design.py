"""The set of clips as an experiment: which are held out, and which conditions all clips share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, V0, B, normal_speed
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.policy import current_policy


def note_uniform_conditions(clips: Sequence[MeasuredCollision]) -> list[SearchNote]:
    """A note for each condition that all clips share: however many they are, they cannot show what depends on it."""
    policy, launches = current_policy(), np.array([c.launch for c in clips])
    speeds, headings, b = launches.T[[V0, HEADING, B]]
    notes = []
    # the speeds on which these laws depend; friction's varies within a clip
    laws = {"restitution": normal_speed(launches), "spin transfer": speeds}
    if same := [law for law, v in laws.items() if v.max() < policy.same_speed_ratio * v.min()]:
        values = {"speed": np.median(speeds), "laws": " or ".join(same)}
        notes.append(SearchNote(SearchNoteKind.ONE_SPEED, values=values))
    if np.ptp(b) < policy.same_impact_parameter:
        notes.append(SearchNote(SearchNoteKind.ONE_IMPACT_PARAMETER, values={"b": np.median(b)}))
    mean = np.exp(1j * headings).mean()
    if np.abs(np.angle(np.exp(1j * headings) / mean)).max() < np.radians(policy.same_heading_deg):
        notes.append(SearchNote(SearchNoteKind.ONE_HEADING))
    return notes


def split_held_out(clips: Sequence[MeasuredCollision]) -> tuple[list[MeasuredCollision], list[MeasuredCollision]]:
    """Split clips into (those to fit, those held out): one in `SearchPolicy.hold_out_one_in`, over all speeds.

    From `SearchPolicy.min_clips_to_hold_out_extremes` clips on, the fastest and the most oblique collision are held
    out, so that the test extrapolates.
    """
    order = sorted(range(len(clips)), key=lambda k: float(clips[k].launch[V0]))
    count = max(len(clips) // current_policy().hold_out_one_in, 1)
    held_out: set[int] = set()
    if len(clips) >= current_policy().min_clips_to_hold_out_extremes:
        held_out = {order[-1], max(order[:-1], key=lambda k: abs(float(clips[k].launch[B])))}
    rest = [k for k in order if k not in held_out]
    more = max(count - len(held_out), 0)
    held_out |= {rest[(2 * k + 1) * len(rest) // (2 * more)] for k in range(more)}
    fitted, held = ([c for k, c in enumerate(clips) if (k in held_out) is out] for out in (False, True))
    return fitted, held
