"""Measures each contact of a crowd by its local estimate, with the friction that all contacts of the film share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.special import bdtrc, ndtr

from synthcam_shared.arrays import Array
from synthcam_shared.steps import report_step
from tracker.camera.camera import Camera
from tracker.camera.camera_json import BODIES
from tracker.measurement.collision.adequacy import describe_failure
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.collision.contacts import Contact, ContactCandidate, fit_velocity, prepare_contact
from tracker.measurement.crowd.track_contacts import TrackContact
from tracker.measurement.local.descents import FitInSteps, run_together
from tracker.measurement.local.local_estimate import LOCAL_NAMES, LocalEstimate, estimate_in_steps
from tracker.measurement.local.local_fit import BEFORE_OF_CROWD
from tracker.measurement.local.local_problem import ANY_TURN, KnownEnd, KnownSlips
from tracker.measurement.local.stretches import SLIDE_AND_ROLL
from tracker.measurement.positions import BallTrack
from tracker.settings import FitSettings

MU_K = LOCAL_NAMES.index("mu_k")
FILM_FRICTION_FACTOR = 0.1  # error of the logarithm of the friction that a film shows
SHORT_SLIDE = "other contacts of the film show the friction better"
_Estimates: TypeAlias = dict[int, tuple[Contact | None, LocalEstimate | str]]


def estimate_contacts(
    found: Sequence[TrackContact],
    balls: Sequence[BallTrack],
    camera: Camera,
    settings: FitSettings,
    *,
    min_frictions: int = 5,
    most_frictions: int = 30,
    max_friction_error: float = 0.2,
    at_once: int = 100,
) -> list[tuple[Contact | None, LocalEstimate | str]]:
    """Estimate each contact of two balls: its two balls, and the local estimate or the reason why there is none.

    found: all contacts of the film; those with walls end the stretches of a ball. The friction of the plate is that
    which the contacts with long slides show; the others take it as known.
    min_frictions: contacts that show the friction of the plate, from which on the others take it.
    most_frictions: contacts that are asked for it, those with the longest slides.
    max_friction_error: relative, of a contact that counts.
    at_once: contacts that are estimated together, which is quicker.
    """
    tracks = {ball.particle: ball for ball in balls}
    known = camera
    if not camera.support and camera.body == BODIES["ball"]:
        known = replace(camera, support="cloth")  # contacts of slow balls hide that they slide
    pairs = [contact for contact in found if len(contact.balls) == 2]
    longest = _sort_by_slide(pairs, found, settings)[:most_frictions]

    def estimate_all(numbers: Sequence[int], settings: FitSettings, done: int) -> _Estimates:
        """The estimates of these pairs by number; done: contacts that were estimated before."""
        out = _Estimates()
        for start in range(0, len(numbers), at_once):
            report_step("contacts", done + start, len(longest) + len(pairs))
            part = numbers[start : start + at_once]
            fits = [_estimate_in_steps(pairs[k], found, tracks, known, settings) for k in part]
            out |= zip(part, run_together(fits), strict=True)
        return out

    first = estimate_all(longest, settings, 0)
    seen = [(each.value[MU_K], each.std[MU_K]) for _, each in first.values() if isinstance(each, LocalEstimate)]
    friction = [mu for mu, std in seen if mu > 0 and 0 < std < max_friction_error * mu]
    used, error, done = settings, settings.local_friction_factor, first
    if len(friction) >= min_frictions:
        common = {"local_friction": float(np.median(friction)), "local_friction_factor": FILM_FRICTION_FACTOR}
        used, done = settings.model_copy(update=common), {}
        median_error = np.sqrt(np.pi / 2)  # of a median of normal values, over that of their mean
        error = min(float(np.std(np.log(friction))) / np.sqrt(len(friction)) * median_error, FILM_FRICTION_FACTOR)
    done = done | estimate_all([k for k in range(len(pairs)) if k not in done], used, len(longest))
    out = list[tuple[Contact | None, LocalEstimate | str]]()
    for k in range(len(pairs)):
        contact, each = done[k]
        own = first[k][1] if k in first else each if used is settings else SHORT_SLIDE
        out.append((contact, _share_friction(each, own, used, error)))
    return out


def shows_gliding(
    found: Sequence[TrackContact],
    balls: Sequence[BallTrack],
    camera: Camera,
    settings: FitSettings,
    *,
    most: int = 30,
    disturbed: float = 0.1,
    chance: float = 0.03,
) -> bool:
    """Decide whether the bodies of a crowd glide, by the contacts after which a slide would be seen best.

    Only contacts after which a slide would end count. A slide between contacts that follow fast looks like any push.
    Other balls disturb some paths of balls that roll, so that only gliding describes them: at most `disturbed` of these
    contacts. The bodies glide if so many contacts would show it with a probability below `chance` otherwise.

    found: contacts of the film as of bodies that slide. camera: does not say what carries the bodies. most: contacts
    that are asked.
    """
    tracks, pairs = {ball.particle: ball for ball in balls}, [contact for contact in found if len(contact.balls) == 2]
    ends = max((float(ball.time[-1]) for ball in balls), default=0.0)
    sorted_ = _sort_by_slide(pairs, found, settings)
    asked = [k for k in sorted_ if _would_end_slide(pairs[k], found, settings, ends)][:most]
    fits = run_together([_estimate_in_steps(pairs[k], found, tracks, camera, settings) for k in asked])
    estimates = [each for _, each in fits if isinstance(each, LocalEstimate)]
    gliding = sum(each.glides for each in estimates)
    return gliding > 0 and bool(bdtrc(gliding - 1, len(estimates), disturbed) < chance)


def _sort_by_slide(pairs: Sequence[TrackContact], found: Sequence[TrackContact], settings: FitSettings) -> list[int]:
    """The numbers of contacts of two balls, those with the longest slides first."""
    return sorted(range(len(pairs)), key=lambda k: -_seen_slide(pairs[k], found, settings))


def _share_friction(
    estimate: LocalEstimate | str, own: LocalEstimate | str, settings: FitSettings, error: float
) -> LocalEstimate | str:
    """The estimate with what a mean over contacts must know of the friction of the plate.

    All contacts share the error of the friction that they take as known; error: of its logarithm. They also share a
    part of their error because short slides are all modelled in one way. The friction of the estimate is that which its
    contact alone shows, so that a mean does not count the film's again.
    """
    slide_share = 0.1  # of the errors of r and mu_k that all contacts share, by benchmarks.tracker.crowd_contacts
    if isinstance(estimate, str) or estimate.glides:
        return estimate
    value, cov, response = estimate.value.copy(), estimate.cov.copy(), estimate.response.copy()
    effect = cov[MU_K] / value[MU_K] / settings.local_friction_factor**2 * error
    effect[~np.isfinite(effect)] = effect[MU_K] = 0.0
    alike = np.where(np.isin(LOCAL_NAMES, ("r", "mu_k")), slide_share * estimate.std, 0.0)
    common = {"friction": (settings.local_friction, effect), "slides": (0.0, alike)}
    estimate = replace(estimate, shared=estimate.shared | common)
    if isinstance(own, str):
        return replace(estimate, unseen=estimate.unseen | {"mu_k"})
    value[MU_K], response[MU_K] = own.value[MU_K], own.response[MU_K]
    cov[MU_K] = cov[:, MU_K] = 0.0
    cov[MU_K, MU_K] = own.cov[MU_K, MU_K]
    if estimate.cov_of_known is not None:  # balances of momentum do not show how large the errors of friction are
        known = estimate.cov_of_known.copy()
        known[MU_K] = known[:, MU_K] = 0.0
        estimate = replace(estimate, cov_of_known=known)
    unseen = estimate.unseen - {"mu_k"} | (own.unseen & {"mu_k"})
    return replace(estimate, value=value, cov=cov, response=response, unseen=unseen)


def _estimate_in_steps(
    contact: TrackContact,
    found: Sequence[TrackContact],
    tracks: Mapping[int, BallTrack],
    camera: Camera,
    settings: FitSettings,
) -> FitInSteps[tuple[Contact | None, LocalEstimate | str]]:
    """The two balls of a contact, and its local estimate or the reason why there is none."""
    window, min_window_s = 10.0 * _slide_duration(contact, settings), 0.05
    own = settings.model_copy(update={"local_window_s": float(np.clip(window, min_window_s, settings.local_window_s))})
    one, other = (_cut(tracks[n], contact, found, camera, settings) for n in contact.balls)
    frame = round(float(np.interp(contact.time, tracks[contact.one].time, tracks[contact.one].frame)))
    try:
        prepared = prepare_contact(ContactCandidate(one, other, frame), camera.ball_diameter, {}, own)
        if prepared.reason:
            return None, prepared.reason
        prepared = _keep_moving(prepared, (one, other), contact)
        pair = prepared.pair
        sliding = [_still_slides(track, contact, found, settings) for _, track in pair.balls]
        members = [track.particle for _, track in pair.balls]
        first, second = (_know_end(ball, contact, found, own) for ball in members)
        ends = first if sliding[0] else None, second if sliding[1] else None
        if all(sliding) and None in ends:
            return prepared, "both balls still slide from an earlier contact"
        if sliding[0]:
            prepared = replace(prepared, pair=replace(pair, target_moves=True))
        slips = _know_slips(members, contact, found, own)
        before = [(SLIDE_AND_ROLL,) if slid else usual for slid, usual in zip(sliding, BEFORE_OF_CROWD, strict=True)]
        fit = estimate_in_steps(prepared, camera, (1.0, 1.0), slips, ends, before, of_crowd=True)
        return prepared, (yield from fit)
    except (ArithmeticError, ValueError, IndexError) as error:  # one contact never costs the others
        return None, describe_failure(error)


def _keep_moving(prepared: Contact, cut: Sequence[BallTrack], contact: TrackContact) -> Contact:
    """The contact with all positions of its slower ball, if that moved before it rests; cut: tracks of both balls.

    A few positions do not show how slowly a ball rolls. It rests in a crowd only if all of them since its contact
    before show that, and if they show its velocity well: those of a few frames allow half the speed of a hit.
    """
    max_error = 0.02  # of the velocity of a ball that rests, over the kick; one not seen changes r by about that share
    pair = prepared.pair
    if pair.target_moves:
        return prepared
    whole = next(track for track in cut if track.particle == pair.struck.particle)
    early = whole.where(whole.time < contact.time)
    rests_in_all = np.count_nonzero(pair.struck.time < contact.time) == len(early)
    if len(early) > 1 and rests_in_all and fit_velocity(early)[2] < max_error * contact.kick:
        return prepared
    return replace(prepared, pair=replace(pair, struck=whole, target_moves=True))


def _slide_duration(contact: TrackContact, settings: FitSettings, particle: int | None = None) -> float:
    """How long a ball slides after a contact, s, by its slip; by its kick if no ball is given, or no slip is known.

    The surfaces of balls that roll drag one another, so that a slip is not the kick.
    """
    slip = np.nan if particle is None else float(np.hypot(*contact.slips[contact.balls.index(particle)]))
    return 2 * (slip if np.isfinite(slip) else contact.kick) / (7 * settings.local_friction * GRAVITY)


def _know_slips(
    balls: Sequence[int], contact: TrackContact, found: Sequence[TrackContact], settings: FitSettings
) -> KnownSlips | None:
    """What is known of the slips of both balls of a contact just after it."""
    least = 0.01  # error of either component of a slip, over the kick
    slips = contact.slips[[contact.balls.index(ball) for ball in balls]]
    if not np.hypot(*slips.T).min() > 0:
        return None
    left, left_std = zip(*(_find_left(ball, contact, found, settings) for ball in balls), strict=True)
    share, share_std = contact.spin_transfer
    return KnownSlips(
        slips=slips,
        left=np.array(left),
        left_std=left_std,
        normal=contact.normal,
        share=share,
        drag_std=share_std * abs(contact.surface_speed),
        std=least * contact.kick,
    )


def _find_left(
    particle: int, contact: TrackContact, found: Sequence[TrackContact], settings: FitSettings
) -> tuple[Array, float]:
    """What is left of the slip of a ball from the contact before this one, m/s, and its error."""
    last, end = _find_last(particle, contact, found), _know_end(particle, contact, found, settings)
    if last is None or end is None:
        return np.zeros(2), 0.0
    slip, lasts = last.slips[last.balls.index(particle)], contact.time - last.time - end.rolls
    left = slip * max(-end.rolls / lasts, 0.0)
    return left, float(np.hypot(*slip)) * end.rolls_std / lasts * float(ndtr(-end.rolls / end.rolls_std))


def _find_last(particle: int, contact: TrackContact, found: Sequence[TrackContact]) -> TrackContact | None:
    """The contact of a ball before this one."""
    return next((c for c in reversed(found) if particle in c.balls and c.time < contact.time), None)


def _know_end(
    particle: int, contact: TrackContact, found: Sequence[TrackContact], settings: FitSettings
) -> KnownEnd | None:
    """What the contact before shows of a ball's slide up to this one.

    The error of its slip is that in films of known truth.
    """
    last = _find_last(particle, contact, found)
    size = 0.0 if last is None else float(np.hypot(*last.slips[last.balls.index(particle)]))
    if last is None or not size > 0:
        return None
    share = 0.3 if _end_slide(particle, last, found, settings) > last.time else 0.1  # error of a slip over the kick
    relative = share * last.kick / size
    lasts = _slide_duration(last, settings, particle)
    return KnownEnd(
        towards=float(np.arctan2(*-last.slips[last.balls.index(particle)][::-1])),
        turn=min(relative, ANY_TURN),
        rolls=contact.time - last.time - lasts,
        rolls_std=lasts * float(np.hypot(relative, settings.local_friction_factor)),
    )


def _seen_slide(contact: TrackContact, found: Sequence[TrackContact], settings: FitSettings) -> float:
    """How long a ball slides after a contact before it has another, s."""
    after = [c for c in found if c.time > contact.time]
    ends = (min((c.time for c in after if ball in c.balls), default=np.inf) for ball in contact.balls)
    return min(_slide_duration(contact, settings), max(ends) - contact.time)


def _would_end_slide(
    contact: TrackContact, found: Sequence[TrackContact], settings: FitSettings, film_ends: float
) -> bool:
    """Decide whether the slide of a ball would end before its next contact, and no slide of both lasts from before."""
    if all(_end_slide(ball, contact, found, settings) > contact.time for ball in contact.balls):
        return False
    after = [c for c in found if c.time > contact.time]
    ends = [min((c.time for c in after if ball in c.balls), default=film_ends) for ball in contact.balls]
    return max(ends) - contact.time > _slide_duration(contact, settings)


def _still_slides(
    track: BallTrack, contact: TrackContact, found: Sequence[TrackContact], settings: FitSettings
) -> bool:
    """Decide whether a ball may slide from its contact before in the positions of a cut track."""
    return _end_slide(track.particle, contact, found, settings) > float(track.time.min(initial=np.inf))


def _end_slide(particle: int, contact: TrackContact, found: Sequence[TrackContact], settings: FitSettings) -> float:
    """The instant until which a ball may slide from its contact before this one, s."""
    last = _find_last(particle, contact, found)
    return -np.inf if last is None else last.time + 1.5 * _slide_duration(last, settings, particle)


def _cut(
    track: BallTrack, contact: TrackContact, found: Sequence[TrackContact], camera: Camera, settings: FitSettings
) -> BallTrack:
    """The positions of a ball between the contacts before and after this one, without those beside them.

    Those of the slide after the contact before are left out too, if enough others are left.
    """
    enough = 5  # positions
    times = np.array([c.time for c in found if track.particle in c.balls and c is not contact])
    low = times[times <= contact.time].max(initial=-np.inf)
    high = times[times > contact.time].min(initial=np.inf)
    beside = track.exposure / 2 + 0.5 / camera.fps
    rolls = _end_slide(track.particle, contact, found, settings)
    if np.count_nonzero((track.time > rolls) & (track.time < contact.time - beside)) >= enough:
        low = max(low, rolls - beside)
    return track.where((track.time > low + beside) & (track.time < high - beside))
