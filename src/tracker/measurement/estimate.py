"""From the tracks of one clip to its physics: r, mu_k, C, slide times, energy, momentum, with standard errors.

Each quantity is measured in four ways:

- NAME: the tied fit, one physical model of impact, sliding and rolling.
- NAME_free: the free fit, with any velocities and slide times after the hit.
- NAME_local: free motion near the contact, with no law of the impact.
- NAME_paper: the finite differences of the paper.

If the first two disagree, the model is wrong; the local estimate still holds. `recommended` says which to use.
Quantities that a clip does not show are NaN.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from math import isfinite
from typing import Any

import numpy as np

from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.camera_json import BODIES
from tracker.detection.link import Tracks
from tracker.measurement.camera_errors import (
    add_camera_errors,
    add_camera_errors_to_lasting,
    add_contact_errors,
    camera_errors,
    differentiate_residuals,
    effects_to_json,
    measure_contact_distance,
)
from tracker.measurement.collision.adequacy import (
    CROWD,
    HIDDEN_SLIDE,
    MEASURED,
    MISFIT,
    NO_DIAMETER,
    NO_SCALE,
    NOTHING_ROLLS,
    ONE_BALL,
    TOGETHER,
    TOO_FEW,
    Flag,
    compute_p_value_of_free_fits,
    describe_failure,
    flag_contact_distance,
)
from tracker.measurement.collision.collision_fit import (
    AFTER_SLIDES,
    CollisionFits,
    HiddenSlide,
    fit_collision,
    fit_lasting_collision,
    name_quantities_of_slide,
)
from tracker.measurement.collision.collision_model import FREE, SPIN, TARGET, TIED, tied_to_free
from tracker.measurement.collision.contact_frames import count_contact_frames
from tracker.measurement.collision.contacts import (
    Contact,
    ContactCandidate,
    EarlierHit,
    MarkedContact,
    find_contacts,
    find_near_pairs,
    find_second_touch,
    find_slow_contacts,
    prepare_contact,
)
from tracker.measurement.collision.departures import LawDeparture, compare_losses, find_slope_of_friction
from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues
from tracker.measurement.collision.hidden_duration import measure_hidden_duration
from tracker.measurement.collision.lasting_contact import MIN_SIGNIFICANCE, LastingContact, shows_friction
from tracker.measurement.collision.least_squares import CollisionFit
from tracker.measurement.collision.noise_correlation import variance_of_residuals
from tracker.measurement.collision.staying_together import MAX_DISTANCE, StayingPair, find_staying_pairs
from tracker.measurement.collision.untested_laws import add_errors_of_untested_laws
from tracker.measurement.crowd.crowd_rows import estimate_contacts, shows_gliding
from tracker.measurement.crowd.track_contacts import find_track_contacts
from tracker.measurement.joint_fit import fit_all_jointly
from tracker.measurement.local.local_columns import make_empty_columns, make_local_columns
from tracker.measurement.local.local_estimate import LocalEstimate, estimate_locally
from tracker.measurement.local.recommendation import recommend
from tracker.measurement.lone_ball import PARAMETERS, add_camera_errors_to_lone_ball, fit_lone_ball
from tracker.measurement.noise.position_noise import ScatterRatio, measure_scatter
from tracker.measurement.painter_behringer import BEFORE, make_motion_table, make_paper_columns
from tracker.measurement.positions import BallTrack, to_ball_tracks
from tracker.settings import FitSettings

__all__ = ["fit_all_jointly", "fit_collision", "make_motion_table", "measure", "select_claims"]


# Largest standard errors that are reported of quantities that may be zero, in their own units; see `largest_error`.
_LARGEST_ERRORS = {"b": 0.05, "t_c": np.inf, "s": 0.1, "r": 0.05, "C": 0.05, "final_angle": 0.1}
_LARGEST_ERRORS |= {"energy_fraction": 0.05, "momentum_fraction": 0.05, "drag": 2.0, "decel": 0.2}
_SPINS_FROM_LAWS = ("w1n", "w1t", "w2n", "w2t")  # the free fit infers spins by laws that a misfit puts in doubt


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a fit of what is no collision may lead anywhere
def measure(
    tracks: Tracks, camera: Camera, settings: FitSettings | None = None, marked: Sequence[MarkedContact] = ()
) -> list[dict[str, Any]]:
    """Measure the physics of a clip: a row for each collision, never empty, as estimates.parquet without `clip`.

    marked: contacts that are measured even if nothing shows them. Raises InputError if they are those of a crowd.

    The `status` of a row is

    - "ok";
    - "misfit": the data reject the tied fit or its values are impossible, and NAME has no error;
    - "stay_together": the balls meet and do not part, so that r is 0;
    - "crowd": there are many balls, and each contact has the local estimate alone;
    - "no_collision": v0, drag and decel are those of the ball that rolls;
    - or the reason why nothing can be measured.
    """
    settings = settings or FitSettings()
    if not camera.metric:
        return [make_empty_row(camera, ONE_BALL if len(np.unique(tracks.particle)) == 1 else NO_SCALE)]
    balls = to_ball_tracks(tracks, camera)
    if not any(len(track) >= 2 for track in balls):
        return [make_empty_row(camera, "too few detections")]
    if marked and len(balls) >= settings.crowd_particles:
        raise InputError(f"contacts can be marked among fewer than {settings.crowd_particles} balls, not {len(balls)}")
    size = measure_scatter(balls, camera.ball_diameter) if balls[0].has_errors else None
    measure_balls = partial(_measure_balls, camera=camera, settings=settings, marked=marked)
    if size is None or abs(size.sigmas) < settings.noise_sigma:
        return measure_balls(balls)
    resized = [track.scale_errors(size) for track in balls]
    if len(balls) >= settings.crowd_particles:  # few contacts have fits of their own, which could confirm the size
        return measure_balls(resized if size.ratio > 1 else balls)
    rows = measure_balls(resized if size.ratio > 1 else balls)
    if size.ratio <= 1:
        correlated = any(row["noise"] == "scatter" for row in rows)  # such errors scatter little from frame to frame
        # whole fits confirm that errors are smaller than claimed
        confirmed = compute_p_value_of_free_fits(rows, size, size.ratio) > 1e-3
        return measure_balls(resized) if confirmed and not correlated else rows
    if not compute_p_value_of_free_fits(rows, size) > 1 - settings.rejection_level:
        return rows
    # The residuals of the free fits are smaller than the scatter, which included kinks of the paths, or is uneven. The
    # claimed errors are kept if the free fits accept them. Otherwise those residuals give the size of the errors.
    claimed = measure_balls(balls)
    if compute_p_value_of_free_fits(claimed, replace(size, dof=np.inf)) >= settings.rejection_level:
        return claimed
    square, dof = np.sum([(row["chi2_free"], row["dof_free"]) for row in rows if row["dof_free"] > 0], axis=0)
    left = ScatterRatio(size.ratio * float(square / dof), float(dof))
    return measure_balls([track.scale_errors(left) for track in balls])


def _measure_balls(
    balls: list[BallTrack], camera: Camera, settings: FitSettings, marked: Sequence[MarkedContact]
) -> list[dict[str, Any]]:
    """The rows of a clip, the size of its errors given."""
    noise = _noise_columns(balls[0], camera)
    nothing = make_empty_row(camera, "no_collision") | noise
    if len(balls) == 1:
        return [nothing | _lone_ball(balls, camera, settings)]
    if not camera.knows_diameter:
        return [nothing | {"status": NO_DIAMETER}]
    if len(balls) >= settings.crowd_particles:
        return _measure_crowd(balls, camera, settings) or [nothing]
    found = find_contacts(balls, camera.ball_diameter, marked=marked)
    near = find_near_pairs(balls, MAX_DISTANCE * camera.ball_diameter, 1.0)
    may_roll = not camera.glides and camera.body == BODIES["ball"]
    together = [stay for a, b in near for stay in find_staying_pairs(a, b, camera.ball_diameter, may_roll=may_roll)]
    candidates = [candidate for candidate in found if candidate.is_marked(marked)]
    together = [stay for stay in together if not any(_is_within(candidate, stay) for candidate in candidates)]
    stays = [stay for stay in together if not stay.bounces]
    found += [
        ContactCandidate(stay.struck, stay.striker, stay.first)
        for stay in together
        if stay.bounces and not any(_is_within(candidate, stay) for candidate in found)
    ]
    if found or stays:
        return _measure_collisions(found, stays, noise, camera, settings)
    if slow := find_slow_contacts(balls, camera.ball_diameter):
        return _measure_collisions(slow, [], noise, camera, settings)
    # A filter that smooths tracks keeps the balls apart, and so does a wrong scale: search within 1.5 diameters.
    found = find_contacts(balls, 1.5 * camera.ball_diameter, 2.0)
    rows = _measure_collisions(found, [], noise, camera, settings)
    if any(row["status"] in MEASURED for row in rows):
        return rows
    flags = {"flags": str(Flag.NO_TOUCH)} if found else {}
    return [nothing | _lone_ball(balls, camera, settings) | flags]


def _measure_crowd(balls: list[BallTrack], camera: Camera, settings: FitSettings) -> list[dict[str, Any]]:
    """A row for each contact of two balls, measured by the local estimate alone."""
    found, rows = find_track_contacts(balls, camera.ball_diameter, glides=camera.glides), []
    seen_to_glide = not camera.support and shows_gliding(found, balls, camera, settings)
    if seen_to_glide:  # contacts after which nothing slides lie elsewhere
        camera = replace(camera, support="air")
        found = find_track_contacts(balls, camera.ball_diameter, glides=True)
    pairs = [contact for contact in found if len(contact.balls) == 2]
    estimates = estimate_contacts(found, balls, camera, settings)
    for index, (seen, (contact, local)) in enumerate(zip(pairs, estimates, strict=True)):
        row = make_empty_row(camera, CROWD, index) | {"particle1": seen.one, "particle2": seen.other}
        row |= {"t_c": seen.time, "t_c_std": seen.time_std, "flags": str(Flag.GLIDES) if seen_to_glide else ""}
        if contact is not None:
            row |= _name_balls(contact.pair.struck, contact.pair.striker)
        row |= _noise_columns(balls[0], camera) | make_local_columns(local, settings=settings)
        rows.append(row | recommend(row))
    return rows


def _measure_collisions(
    found: list[ContactCandidate],
    stays: list[StayingPair],
    noise: dict[str, Any],
    camera: Camera,
    settings: FitSettings,
) -> list[dict[str, Any]]:
    """A row for each contact, in order of time; balls that stay together have no further contacts."""
    found = [candidate for candidate in found if not any(_is_within(candidate, stay) for stay in stays)]
    rows, earlier, letters = [], dict[int, EarlierHit](), dict[int, str]()
    every: list[tuple[int, ContactCandidate | StayingPair]] = [(candidate.frame, candidate) for candidate in found]
    every = sorted([*every, *((stay.first, stay) for stay in stays)], key=lambda event: event[0])
    for i, (_, event) in enumerate(every):
        if isinstance(event, StayingPair):
            row = make_empty_row(camera, TOGETHER, i) | _name_balls(event.struck, event.striker) | noise
            row |= {"v0": event.speed, "v0_std": event.speed_std, "b": event.offset, "b_std": event.offset_std}
            row |= {"r": 0.0, "r_std": event.r_std, "r_free": 0.0, "r_free_std": event.r_std}
            row |= {"flags": str(Flag.TOGETHER), "contact_first": event.first, "contact_last": event.last}
            row |= {"t_c": event.time}
            rows.append(row | recommend(row))
            earlier |= dict.fromkeys((event.struck.particle, event.striker.particle), EarlierHit(np.inf))
            continue
        try:
            row, left = _measure_collision(event, earlier, letters, camera, i, settings)
        except (ArithmeticError, ValueError, IndexError) as error:  # one collision never costs the others
            one, two = event.one.particle, event.other.particle
            row = make_empty_row(camera, describe_failure(error), i) | {"particle1": one, "particle2": two}
            left = dict.fromkeys((one, two), EarlierHit(np.inf))
        row |= recommend(row)
        rows.append(noise | row if row["noise"] == "scatter" else row | noise)
        earlier |= left
    return rows


def _is_within(candidate: ContactCandidate, stay: StayingPair) -> bool:
    """Test whether a contact is one of balls that stay together."""
    same = {candidate.one.particle, candidate.other.particle} == {stay.struck.particle, stay.striker.particle}
    return same and stay.first - 2 <= candidate.frame <= stay.last + 2


def _name_balls(struck: BallTrack, striker: BallTrack) -> dict[str, Any]:
    """The columns that name two balls and the frames in which they are measured."""
    frames = np.concatenate([struck.frame, striker.frame])
    first_and_last = {"frame_first": int(frames.min()), "frame_last": int(frames.max())}
    return {"particle1": struck.particle, "particle2": striker.particle} | first_and_last


def _noise_columns(track: BallTrack, camera: Camera) -> dict[str, Any]:
    """The columns of noise where the errors come from the tracks' own scatter; empty where the table's are kept."""
    if np.isinf(track.noise_dof):
        return {}
    size = float(np.sqrt(np.trace(track.cov[0]) / 2) / camera.scale)
    ratio = track.error_scale if track.has_errors else np.nan
    return {"noise": "scatter", "noise_px": size, "noise_ratio": ratio, "noise_rho": track.rho}


def _measure_collision(
    candidate: ContactCandidate,
    earlier: dict[int, EarlierHit],
    letters: dict[int, str],
    camera: Camera,
    index: int,
    settings: FitSettings,
) -> tuple[dict[str, Any], dict[int, EarlierHit]]:
    """The row of one collision, and by particle the state in which it leaves the balls.

    letters: "a" or "b" of camera.json by particle; a collision adds those of its balls.
    """
    again = find_second_touch(candidate, camera.ball_diameter)
    if again is not None:
        one, other = (track.where(track.frame < again) for track in (candidate.one, candidate.other))
        candidate = replace(candidate, one=one, other=other)
    contact = prepare_contact(candidate, camera.ball_diameter, earlier, settings)
    row = make_empty_row(camera, contact.reason or "ok", index)
    row |= _name_balls(contact.pair.struck, contact.pair.striker)
    unknown = {track.particle: EarlierHit(np.inf) for _, track in contact.pair.balls}
    if contact.reason:
        return row, unknown
    read, flags = _fit(contact, candidate, earlier, camera, settings)
    rolls = not camera.glides and camera.body == BODIES["ball"]
    lasting: LastingContact | HiddenSlide | None = read.lasting if isinstance(read, CollisionFits) else None
    if isinstance(read, HiddenSlide) and rolls:
        lasting = read
    seen = contact if lasting is None else replace(contact, first=lasting.first, last=lasting.last)
    masses = _find_masses(contact, camera, letters)
    foreign = _why_foreign(masses, camera, read.flags if isinstance(read, CollisionFits) else ())
    local = _estimate_locally(seen, masses, camera)
    row |= make_local_columns(local, camera.mass_ratio is not None, foreign, settings)
    if not isinstance(read, CollisionFits):
        return row | {"status": HIDDEN_SLIDE if isinstance(read, HiddenSlide) else read}, unknown
    read = _count_untested_laws(read, camera)
    row |= _value_columns(read, camera) | _noise_columns(read.contact.pair.striker, camera)
    row |= {"adequate": read.p_tied, "adequate_free": read.p_free, "agree": read.p_agree}
    row |= {"model_rejected": read.is_model_rejected}
    flags = [*flags, *([] if again is None else [Flag.TOUCH_AGAIN])]
    flags += [] if read.rejected_law is None else [read.rejected_law]
    row |= {"flags": "|".join([*read.flags, *flags, *read.impossible_values])}
    friction = float(np.nan_to_num(read.tied_values.value[QUANTITY_NAMES.index("mu_k")]))
    row |= make_paper_columns(contact, camera, friction, read.lasting)
    if read.tied_is_straight:  # differences of noise
        row |= {f"{name}_paper{kind}": np.nan for name in AFTER_SLIDES for kind in ("", "_std")}
    nothing_known = "the positions show no quantity well enough; check their unit, the scale and fps"
    if not read.is_misfit:
        known = any(np.isfinite(row[f"{name}{kind}"]) for name in QUANTITY_NAMES for kind in ("", "_free"))
        return row | {"status": "ok" if known else nothing_known}, _earlier_hits(read, earlier)
    # differences show these quantities whatever the balls do after the hit
    lost = [name for name in QUANTITY_NAMES if name not in ("t_c", "v0", "b", "r", "s")]
    if read.contact.pair.striker.encoded:
        row["flags"] = "|".join(filter(None, [row["flags"], Flag.ENCODED]))
    return row | {"status": MISFIT} | {f"{name}_paper_std": np.nan for name in lost}, unknown


def _estimate_locally(contact: Contact, masses: tuple[float, float], camera: Camera) -> LocalEstimate | str:
    """The local estimate, or the reason why there is none."""
    if contact.pair.settings.local_window_s == 0:
        return "the setting local_window_s is 0"
    try:
        return estimate_locally(contact, camera, masses)
    except (ArithmeticError, ValueError, IndexError) as error:  # the other estimates stand without it
        return describe_failure(error)


def _find_masses(contact: Contact, camera: Camera, letters: dict[int, str]) -> tuple[float, float]:
    """Masses of ball 1 and ball 2 of a contact, in any unit.

    letters: "a" or "b" of camera.json by particle, to which those of its balls are added. The first striker is the ball
    that was launched.
    """
    one, two, other = contact.pair.struck.particle, contact.pair.striker.particle, {"a": "b", "b": "a"}
    letters.setdefault(two, other[letters[one]] if one in letters else camera.striker)
    letters.setdefault(one, other[letters[two]])
    masses = {"a": 1.0 if camera.mass_ratio is None else camera.mass_ratio, "b": 1.0}
    return masses[letters[one]], masses[letters[two]]


def _why_foreign(masses: tuple[float, float], camera: Camera, flags: Collection[Flag]) -> str:
    """Say why the tied fit, of equal balls that roll, is not one of these bodies; "" if it is."""
    if abs(masses[0] / masses[1] - 1) > 0.002:
        return "the tied fit is that of equal masses"
    glides = camera.glides or camera.body != BODIES["ball"]
    return "the tied fit is that of balls that roll" if glides and Flag.STRAIGHT not in flags else ""


def _fit(
    contact: Contact,
    candidate: ContactCandidate,
    earlier: dict[int, EarlierHit],
    camera: Camera,
    settings: FitSettings,
) -> tuple[CollisionFits | HiddenSlide | str, list[Flag]]:
    """The fits of a collision with the camera's errors, or why there are none; flags of the contact's distance.

    A contact that lasts is tried first if balls are clearly within a diameter in some frames, and otherwise if an
    instantaneous one is doubtful.
    """
    min_frames_within = 3  # frames with the balls clearly within a diameter
    doubtful_sigma = 3.0  # least significance of a contact that lasts, where an instantaneous one is doubtful
    tries = partial(fit_lasting_collision, candidate, camera.ball_diameter, earlier, settings)
    lasting: CollisionFits | HiddenSlide | str | None = None
    if is_wide := count_contact_frames(candidate, camera.ball_diameter) >= min_frames_within:
        lasting = tries()
        if isinstance(lasting, CollisionFits) and lasting.lasting is not None:
            return add_camera_errors_to_lasting(lasting, camera), []
        if isinstance(lasting, HiddenSlide):
            return lasting, []
    read, flags, nearer, duration = fit_collision(contact), list[Flag](), np.nan, np.nan
    if not isinstance(read, str):
        tied, tied_values = add_camera_errors(read.tied, read.tied_values, camera)
        free, free_values = add_camera_errors(read.free, read.free_values, camera)
        read = replace(read, tied=tied, free=free, tied_values=tied_values, free_values=free_values)
        by_free, by_tied = (measure_contact_distance(fit, camera) for fit in (free, tied))
        duration, _ = measure_hidden_duration(tied.pair.diameter, tied_values, by_tied)
        if not read.is_misfit:
            read = replace(read, tied_values=add_contact_errors(tied, tied_values, camera, by_tied))
        read = replace(read, free_values=add_contact_errors(free, free_values, camera, by_free))
        flags = flag_contact_distance(*by_free, settings)
        read = read.with_departures(*_find_departures(tied, free, camera))
        nearer = max((1 - distance) / std for distance, std in (by_free, by_tied))
    if isinstance(read, str) or _may_last(read, nearer):
        lasting = tries(doubtful_sigma if isinstance(read, str) or read.is_misfit else MIN_SIGNIFICANCE)
        if isinstance(lasting, CollisionFits):
            return add_camera_errors_to_lasting(lasting, camera), []
        if isinstance(lasting, HiddenSlide) or (isinstance(lasting, str) and (is_wide or lasting != TOO_FEW)):
            return lasting, []
        is_long = nearer > doubtful_sigma and duration > float(np.median(np.diff(contact.pair.striker.start)))
        if (
            is_long
            and lasting is None
            and not isinstance(read, str)
            and not (read.is_misfit or shows_friction(read.tied_values, settings))
        ):
            return HIDDEN_SLIDE, []  # an impact is no fit of positions in contact, and no others show a slide
    return read, flags


def _find_departures(
    tied: CollisionFit, free: CollisionFit, camera: Camera
) -> tuple[dict[Flag, LawDeparture], dict[Flag, LawDeparture]]:
    """Find departures from laws that the fits assume, by the tied and by the free fit.

    Those that the parameters of a fit absorb are left out. The free fit hardly shows how friction changes.
    """
    errors = camera_errors(camera)
    known, known_free = (differentiate_residuals(fit, errors, camera) if errors else None for fit in (tied, free))
    by_tied, by_free = dict[Flag, LawDeparture](), dict[Flag, LawDeparture]()
    for flag, find in ((Flag.LOSSES_DIFFER, compare_losses), (Flag.FRICTION_CHANGES, find_slope_of_friction)):
        one = find(tied, known)
        other = find(free, known_free, one)
        by_tied |= {} if one is None else {flag: one}
        by_free |= {} if other is None else {flag: other}
    return by_tied, by_free


def _count_untested_laws(read: CollisionFits, camera: Camera) -> CollisionFits:
    """Let the errors of an accepted tied fit of an instant impact contain what laws that nothing tests may change."""
    if read.is_misfit or read.fits is not None:
        return read
    errors = camera_errors(camera)
    known = differentiate_residuals(read.tied, errors, camera) if errors else None
    return replace(read, tied_values=add_errors_of_untested_laws(read.tied, read.tied_values, known))


def _may_last(read: CollisionFits, nearer: float) -> bool:
    """Decide whether a contact may be other than instantaneous, or the balls may not slide.

    nearer: standard errors by which they touch within one diameter. Noise that is correlated from frame to frame may
    be that of the contact.
    """
    is_slide_unseen = not shows_friction(read.tied_values, read.settings)
    is_correlated = read.contact.pair.striker.rho > 0
    return bool(read.is_misfit or read.flags or is_correlated or is_slide_unseen or nearer > MIN_SIGNIFICANCE)


def _value_columns(read: CollisionFits, camera: Camera) -> dict[str, Any]:
    """The columns of both fits, with errors if the data accept the fit."""
    tied, free = select_claims(read)
    common = effects_to_json(camera, {"tied": tied.shared, "free": free.shared})
    row: dict[str, Any] = {"cov": _covariances_to_json({"tied": tied.cov, "free": free.cov}, QUANTITY_NAMES, common)}
    for suffix, values in (("", tied), ("_free", free)):
        for name, value, std in zip(QUANTITY_NAMES, values.value, values.std, strict=True):
            row[f"{name}{suffix}"], row[f"{name}{suffix}_std"] = value, std
    at = [TIED.index(name) for name in ("heading", "x", "y", *SPIN, *TARGET)]
    row |= dict(zip(("heading", "x1", "y1", *BEFORE), read.tied.parameters[at].tolist(), strict=True))
    for column, name in zip(BEFORE, SPIN, strict=False):
        known = name in read.contact.pair.fitted_spin and not read.is_misfit
        row[f"{column}_std"] = float(np.sqrt(read.tied.cov[TIED.index(name), TIED.index(name)])) if known else np.nan
    ends = [track.start[-1] + track.exposure for _, track in read.tied.pair.balls]
    row["time_left_s"] = float(min(ends) - read.tied.parameters[0])
    row["extrapolated"] = "|".join(_list_extrapolated(read, row["time_left_s"]))
    if read.lasting is not None:
        row |= {"contact_duration_s": read.lasting.duration, "contact_duration_s_std": read.lasting.duration_std}
        row |= {"contact_first": read.lasting.first, "contact_last": read.lasting.last}
    for suffix, fit in (("", read.tied), ("_free", read.free)):
        row |= {f"chi2{suffix}": fit.chi2, f"dof{suffix}": fit.dof, f"dropped{suffix}": fit.dropped}
    return row


def _list_extrapolated(read: CollisionFits, time_left: float) -> list[str]:
    """List the quantities of the tied fit that describe a time after the balls were last seen.

    A slide that may end then counts, also where its own time is too uncertain to be given. Without friction both balls
    would slide for ever, but the fit gives the energy that rolling ones would keep.
    """
    values = read.tied_values
    end = values.value + np.nan_to_num(values.std)
    late = [f"{ball}" for ball in (1, 2) if end[QUANTITY_NAMES.index(f"tau{ball}")] > time_left]
    names = {f"{kind}{ball}{f}" for ball in late for kind, f in (("tau", ""), ("v", "f"))}
    if late:
        names |= {"energy_fraction", "momentum_fraction", "final_angle"}
    return [name for name in QUANTITY_NAMES if name in names]


def _earlier_hits(read: CollisionFits, earlier: dict[int, EarlierHit]) -> dict[int, EarlierHit]:
    """The state of both balls after the hit: until when they slide, by the later of both fits, and their spin."""
    pair, tied = read.contact.pair, read.tied.parameters
    ends = [FREE.index(name) for name in ("log_tau1", "log_tau2")]
    both = (np.asarray(tied_to_free(tied, pair.spin), dtype=np.float64), read.free.parameters)
    late = np.max([free[0] + np.exp(free[ends]) for free in both], axis=0)
    beta, v0, c, side = (tied[TIED.index(name)] for name in ("beta", "v0", "C", "side"))
    turn = -c * (v0 * np.sin(beta) + pair.spin + side)  # R dw = (5/2) n x J/m, the same for both
    return {
        ball.particle: EarlierHit(float(end), earlier.get(ball.particle, EarlierHit()).spin + float(turn + spin))
        for ball, end, spin in zip((pair.struck, pair.striker), late, (0.0, side), strict=True)
    }


def select_claims(read: CollisionFits) -> tuple[DerivedValues, DerivedValues]:
    """Select what the row of estimates may claim from each fit, tied and free.

    A value is NaN where the clip does not show it; it has no error where the data reject the fit. The free fit of a
    misfit has none either if other laws of sliding and rolling fit better. Whatever breaks the laws of the tied fit may
    break these too.
    """
    # The factor by which errors of outlined balls in lossy video exceed those of residuals. A fit absorbs part of what
    # the codec moves. Without it, rms z of mu_k in 40 drawn films of eight codecs was 1.58 +- .12, that of v0 1.29.
    encoded_outlines = 1.5
    settings, pair = read.settings, read.contact.pair
    # without an end in view, slide time and final velocity trade freely: no minimum, and none is needed
    if read.unseen is not None:
        unseen = set(read.unseen)
    elif all(read.slide_ends_seen) and not read.free.converged:
        unseen = set(QUANTITY_NAMES)
    else:
        unseen = set[str]()
        for ball, seen in enumerate(read.slide_ends_seen, 1):
            k = FREE.index(f"log_tau{ball}")
            if not seen:
                unseen |= name_quantities_of_slide(ball)
            elif read.free.cov[k, k] > settings.max_relative_error**2:  # too short to show the velocity after the hit
                unseen |= {"r", "s", "mu_k", "C", f"w{ball}n", f"w{ball}t"}
        b = QUANTITY_NAMES.index("b")
        if not abs(read.free_values.value[b]) > 10 * read.free_values.std[b]:  # s is a ratio by b
            unseen |= {"s"}
        if pair.fitted_spin:
            unseen |= {"C"}  # the free fit has no spin of the striker before the hit
    assumed = unseen if read.tied_is_straight else set[str]()  # nothing follows from laws of slides
    tied = _within_limits(read.tied_values, False, assumed, settings)
    free = _within_limits(read.free_values, True, unseen, settings)
    if read.is_misfit:
        tied, free = tied.without_errors(QUANTITY_NAMES), free.without_errors(("C", *_SPINS_FROM_LAWS))
    if pair.striker.encoded and read.is_misfit:  # the residuals show what the codec does to the paths near the contact
        wider = replace(free, cov=free.cov * variance_of_residuals(read.free))
        return tied, wider.without_errors([name for name in QUANTITY_NAMES if name not in ("v0", "b", "t_c", "r")])
    if pair.striker.encoded and pair.striker.outlined:
        tied, free = (replace(values, cov=values.cov * encoded_outlines**2) for values in (tied, free))
    is_trusted = read.is_free_accepted and not (read.is_misfit and read.p_motion < 0.01)
    return tied, free if is_trusted else free.without_errors(QUANTITY_NAMES)


def largest_error(name: str, value: Array, is_free: bool, max_relative_error: float = 0.2) -> Array:
    """Find the largest standard error with which a quantity is reported.

    Quantities that may be zero have limits in their own units, spins have none, and all others have
    `max_relative_error` of their value.
    """
    if name == "r" and is_free:
        return np.full_like(value, 0.02)
    if name in _SPINS_FROM_LAWS or name in _LARGEST_ERRORS:
        return np.full_like(value, _LARGEST_ERRORS.get(name, np.inf))
    return max_relative_error * np.abs(value)


def _within_limits(values: DerivedValues, is_free: bool, unseen: set[str], settings: FitSettings) -> DerivedValues:
    """The values with NaN for those that are unseen or whose errors are too large."""
    value, lost = values.value.copy(), []
    for i, name in enumerate(QUANTITY_NAMES):
        std = values.std[i]
        limit = largest_error(name, value[i], is_free, settings.max_relative_error)
        folded = name == "final_angle" and value[i] < 3 * std  # an angle cannot be negative: near zero it is biased
        if name in unseen or not np.isfinite(value[i]) or not std <= limit or folded:
            value[i] = np.nan
            lost.append(name)
    return replace(values, value=value).without_errors(lost)


def _lone_ball(balls: list[BallTrack], camera: Camera, settings: FitSettings) -> dict[str, Any]:
    """The columns of a ball that rolls without a collision: its speed when first seen, drag and decel."""
    fits = sorted((f for f in map(fit_lone_ball, balls) if f is not None), key=lambda f: -float(f.parameters[3]))
    if not fits:
        return {}
    wider = [add_camera_errors_to_lone_ball(f, camera) for f in fits]
    # a ball that meets a wall, or a track of pieces, may be faster than the ball that rolls
    rolling = (one for one in wider if one[0].moves and one[0].rolls_freely(settings.lone_ball_sigma))
    best, common = next(rolling, wider[0])
    if not best.rolls_freely(settings.lone_ball_sigma):
        return {"status": NOTHING_ROLLS, "chi2": best.chi2, "dof": best.dof}
    out: dict[str, Any] = {"particle2": best.track.particle, "chi2": best.chi2, "dof": best.dof}
    for i in (3, 4, 5):
        name, value, std = PARAMETERS[i], float(best.parameters[i]), float(np.sqrt(best.cov[i, i]))
        within = std <= _LARGEST_ERRORS.get(name, np.inf)
        out[name], out[f"{name}_std"] = (value, std) if within else (np.nan, np.nan)
    blocks = {"rolling": best.cov[-3:, -3:], "rolling_loss": np.array([best.loss])}
    out["cov"] = _covariances_to_json(blocks, PARAMETERS[-3:], common)
    return out


def make_empty_row(camera: Camera, status: str, index: int = 0) -> dict[str, Any]:
    """Make a row of estimates in which nothing is measured."""
    row: dict[str, Any] = {"collision": index, "striker": camera.striker, "status": status}
    for name in QUANTITY_NAMES:
        for kind in ("", "_free", "_paper"):
            row[f"{name}{kind}"] = row[f"{name}{kind}_std"] = np.nan
    row |= dict.fromkeys(("particle1", "particle2", "frame_first", "frame_last"), -1)
    row |= make_empty_columns() | {"cov": "{}", "heading": np.nan, "x1": np.nan, "y1": np.nan}
    row |= dict.fromkeys((*BEFORE, *(f"{name}_std" for name in BEFORE[: len(SPIN)])), np.nan)
    row |= {"noise": "given", "noise_px": np.nan, "noise_ratio": np.nan}
    row |= {"noise_rho": 0.0, "adequate": np.nan, "adequate_free": np.nan, "agree": np.nan}
    row |= {"model_rejected": False, "flags": "", "extrapolated": ""}
    row |= dict.fromkeys(("time_left_s", "contact_duration_s", "contact_duration_s_std"), np.nan)
    row |= {"contact_first": -1, "contact_last": -1}
    row |= {"chi2": np.nan, "dof": 0, "dropped": 0}
    return row | {"chi2_free": np.nan, "dof_free": 0, "dropped_free": 0}


def _covariances_to_json(blocks: dict[str, Array], names: tuple[str, ...], shared: dict[str, Any]) -> str:
    """Covariances by fit as JSON, in the order of `names`.

    Seven digits keep a matrix positive definite. Errors of the camera file need all digits, because they may be far
    larger than the rest.
    """
    out: dict[str, Any] = {"names": list(names)}
    digits = 17 if shared else 7
    for fit, cov in blocks.items():
        out[fit] = [[float(f"{v:.{digits}g}") if isfinite(v) else None for v in line] for line in cov.tolist()]
    return json.dumps(out | ({"shared": shared} if shared else {}), separators=(",", ":"))
