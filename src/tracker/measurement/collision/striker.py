"""Strikers that do not roll up to the hit: they slide, spin about the vertical, or roll only from some time on.

They are tried only where the tracks reject two rolling balls, the simplest first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from synthcam_shared.arrays import Array
from tracker.measurement.collision.adequacy import Flag
from tracker.measurement.collision.collision_model import FREE, GRAVITY, SLIDING, SPIN, TIED
from tracker.measurement.collision.contacts import Contact
from tracker.measurement.collision.least_squares import BallPair, CollisionFit
from tracker.measurement.noise.position_noise import WINDOW_FRAMES, find_bent_windows

MIN_POSITIONS_BEFORE_CONTACT = 5  # positions before the contact


@dataclass(frozen=True)
class StrikerHypothesis:
    """A possible motion of ball 2 before the hit: its flags, the contact to fit, and starts (16,)."""

    flags: tuple[Flag, ...]
    contact: Contact
    starts: list[Array]


def list_alternative_strikers(contact: Contact, rolling: Array) -> Iterator[StrikerHypothesis]:
    """List motions of ball 2 before the hit other than rolling, the simplest first.

    rolling: the tied parameters (16,) by which both balls roll.
    """
    late = [((Flag.ROLLS_LATE,), one) for one in _without_first_positions(contact)]
    either: list[tuple[tuple[Flag, ...], Contact]] = [((), contact), *late]
    for late_flag, one in late:
        yield StrikerHypothesis(late_flag, one, [rolling])
    for flags, one in either:
        yield StrikerHypothesis((*flags, Flag.STRIKER_SPINS), _with_spin(one, ("side",)), [rolling])
    for flags, one in either:
        if starts := _sliding_starts(one.pair, rolling):
            yield StrikerHypothesis((*flags, Flag.STRIKER_SLIDES), _with_spin(one, SPIN), starts)


def is_believable_striker(tied: CollisionFit, free: CollisionFit) -> bool:
    """Decide whether a striker can spin or slide as a fit finds it."""
    # R w over v: a cue slips off a ball beyond half a radius from its centre, which gives 5/2 times 1/2
    max_spin = 1.25
    least_deceleration = 5.0  # standard errors by which a sliding striker must be seen to slow down before the contact
    v0, ux, uy, side = (tied.parameters[TIED.index(name)] for name in ("v0", *SPIN))
    if abs(side) > max_spin * v0 or np.hypot(ux, uy) > (1 + max_spin) * v0:
        return False
    if not tied.pair.striker_slides:
        return True
    at = [FREE.index(name) for name in SLIDING]
    pull = free.parameters[at]
    return bool(pull @ np.linalg.pinv(free.cov[np.ix_(at, at)]) @ pull > least_deceleration**2)


def _with_spin(contact: Contact, names: tuple[str, ...]) -> Contact:
    return replace(contact, pair=replace(contact.pair, fitted_spin=names))


def _without_first_positions(contact: Contact) -> Iterator[Contact]:
    """The same without the first positions of the striker: those up to the last push, if one is seen, or a share."""
    track = contact.pair.striker
    before = np.flatnonzero(track.frame < contact.frame)
    pushed = find_bent_windows(track.where(track.frame < contact.frame - 1))
    since = [int((track.frame[before] >= pushed[-1] + WINDOW_FRAMES).sum())] if len(pushed) else []
    # shares of the positions before the contact, where no push is seen or is not all
    for kept in since + [round(share * len(before)) for share in (0.6, 0.35)]:
        if MIN_POSITIONS_BEFORE_CONTACT <= kept < len(before):
            rows = track.frame >= track.frame[before[-kept]]
            yield replace(contact, pair=replace(contact.pair, striker=track.where(rows)))


def _sliding_starts(pair: BallPair, rolling: Array) -> list[Array]:
    """Starts (16,) by which the striker slides: its slip lies along its deceleration before the contact."""
    track = pair.striker
    before = track.where(track.start + track.exposure < rolling[0])
    if len(before) < MIN_POSITIONS_BEFORE_CONTACT:
        return []
    t = before.time - rolling[0]
    pull = 2 * np.polynomial.polynomial.polyfit(t, before.position, 2)[2]
    size = float(np.hypot(*pull))
    if not size > 0:
        return []
    at, starts = {name: TIED.index(name) for name in TIED}, []
    for slip, transfer in product((0.15, 0.5), (0.05, 0.3)):  # slip over speed at the contact, and C
        start = rolling.copy()
        start[at["ux"] : at["uy"] + 1] = -pull / size * slip * rolling[at["v0"]]
        start[at["log_mu"]], start[at["C"]] = np.log(np.clip(size / GRAVITY, 1e-3, 1.0)), transfer
        start[at["r"]] = np.clip(start[at["r"]], 0.5, 1.0)
        starts.append(start)
    return starts
