"""Strikers that do not roll up to the hit: they slide, spin about the vertical, or roll only from some time on.

Only where the tracks reject two rolling balls, and the simplest first: what was rolling stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tracker.measurement.collision.adequacy import Flag
from tracker.measurement.collision.collision_model import FREE, GRAVITY, SLIDING, SPIN, TIED
from tracker.measurement.collision.least_squares import BallPair, CollisionFit
from tracker.measurement.noise.position_noise import WINDOW, find_bent_windows

if TYPE_CHECKING:
    from tracker.measurement.collision.contacts import Contact

Floats = NDArray[np.float64]
CONVINCING = 1e-3  # p-value that a further freedom must reach: it is asked for after a fit was rejected
KEPT = (0.6, 0.35)  # of the positions before the contact, the last ones, where no push is seen or is not all
FEWEST = 5  # positions before the contact
SLIPS, TRANSFERS = (0.15, 0.5), (0.05, 0.3)  # slip over speed at contact, and C, from which a fit starts
SEEN = 5.0  # standard errors by which the approach must be seen to slow down
MOST_SPIN = 1.25  # R w over v of a ball struck half a radius off its centre, where a cue slips off: 5/2 times 1/2


@dataclass(frozen=True)
class StrikerHypothesis:
    """A way in which ball 2 may come: flags that say so, what is fitted then, and starts (16,)."""

    flags: tuple[Flag, ...]
    contact: Contact
    starts: list[Floats]


def alternative_strikers(contact: Contact, rolling: Floats) -> Iterator[StrikerHypothesis]:
    """Ways in which ball 2 may come other than rolling all the while, the simplest first.

    Parameters
    ----------
    contact : Contact
    rolling : ndarray of shape (16,)
        The tied parameters by which both balls roll.

    Yields
    ------
    Striker
    """
    late = list(_without_first_positions(contact))
    yield from (StrikerHypothesis((Flag.ROLLS_LATE,), one, [rolling]) for one in late)
    spun = _with_spin(contact, ("side",))
    yield StrikerHypothesis((Flag.STRIKER_SPINS,), spun, [rolling])
    yield from (
        StrikerHypothesis((Flag.ROLLS_LATE, Flag.STRIKER_SPINS), _with_spin(one, ("side",)), [rolling]) for one in late
    )
    for one, flags in (
        (contact, (Flag.STRIKER_SLIDES,)),
        *((one, (Flag.ROLLS_LATE, Flag.STRIKER_SLIDES)) for one in late),
    ):
        starts = _sliding_starts(one.pair, rolling)
        if starts:
            yield StrikerHypothesis(flags, _with_spin(one, SPIN), starts)


def is_believable(tied: CollisionFit, free: CollisionFit) -> bool:
    """Whether a ball can be spun so, and where it slides up to the contact is seen to slow down."""
    v0, ux, uy, side = (tied.parameters[TIED.index(name)] for name in ("v0", *SPIN))
    if abs(side) > MOST_SPIN * v0 or np.hypot(ux, uy) > (1 + MOST_SPIN) * v0:
        return False
    if not tied.pair.striker_slides:
        return True
    at = [FREE.index(name) for name in SLIDING]
    pull = free.parameters[at]
    return bool(pull @ np.linalg.pinv(free.cov[np.ix_(at, at)]) @ pull > SEEN**2)


def _with_spin(contact: Contact, names: tuple[str, ...]) -> Contact:
    return replace(contact, pair=replace(contact.pair, fitted_spin=names))


def _without_first_positions(contact: Contact) -> Iterator[Contact]:
    """The same without the first positions of the striker: those up to the last push, if one is seen, or a share."""
    track = contact.pair.striker
    before = np.flatnonzero(track.frame < contact.frame)
    pushed = find_bent_windows(track.where(track.frame < contact.frame - 1))
    since = [int((track.frame[before] >= pushed[-1] + WINDOW).sum())] if len(pushed) else []
    for kept in since + [round(share * len(before)) for share in KEPT]:
        if FEWEST <= kept < len(before):
            rows = track.frame >= track.frame[before[-kept]]
            yield replace(contact, pair=replace(contact.pair, striker=track.where(rows)))


def _sliding_starts(pair: BallPair, rolling: Floats) -> list[Floats]:
    """Starts (16,) by which the striker slides: its slip lies along its deceleration before the contact."""
    track = pair.striker
    before = track.where(track.start + track.exposure < rolling[0])
    if len(before) < FEWEST:
        return []
    t = before.time - rolling[0]
    pull = 2 * np.polynomial.polynomial.polyfit(t, before.position, 2)[2]
    size = float(np.hypot(*pull))
    if not size > 0:
        return []
    at, starts = {name: TIED.index(name) for name in TIED}, []
    for slip, transfer in product(SLIPS, TRANSFERS):
        start = rolling.copy()
        start[at["ux"] : at["uy"] + 1] = -pull / size * slip * rolling[at["v0"]]
        start[at["log_mu"]], start[at["C"]] = np.log(np.clip(size / GRAVITY, 1e-3, 1.0)), transfer
        start[at["r"]] = np.clip(start[at["r"]], 0.5, 1.0)
        starts.append(start)
    return starts
