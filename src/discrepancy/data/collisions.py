"""Measured collisions from a tracker's results: in metres, and with a first guess of each launch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from discrepancy.arrays import Array, Ints
from discrepancy.data.launch import HEADING, T_C, V0, B, equalise_launches, guess_spin
from discrepancy.data.outgoing_hit import HitGuess, guess_hit_from_outgoing
from discrepancy.data.strays import remove_strays
from discrepancy.data.track_checks import detect_wrong_units, find_exchange
from discrepancy.data.uneven_times import explain_too_uneven, find_clock_start, measure_unevenness, move_to_even_times
from discrepancy.policy import current_policy
from synthcam_shared.errors import InputError as InputError
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.collision.adequacy import MEASURED, MISFIT
from tracker.measurement.estimate import measure
from tracker.recording import Result
from tracker.results import read_clip
from tracker.tables.read import read_tracks
from tracker.tables.rows import split_tracks

UNCLAIMED = 0.01  # px: stands in where tracks claim no error; the noise is then read off all the same
GIVEN = "what tracker.track or tracker.measure gives"
ESTIMATES = "clip striker status t_c v0 b tau1 tau2 particle1 particle2".split()


@dataclass(frozen=True)
class MeasuredCollision:
    """One measured collision. Rows are sorted by ball, then frame; ball 0 is the target (1 in files), 1 the striker.

    Attributes
    ----------
    clip : int
    striker : str
    camera : Camera
    frame, ball : (n,) arrays of int
    xy : (n, 2) array
        Centres on the plate, m, means over the exposure.
    covariance : (n, 2, 2) array
        As claimed, m^2.
    launch : (6,) or (9,) array
        A first guess, columns as in `discrepancy.data.launch`.
    slide_ends : (2,) array
        When each ball is thought to stop sliding, s.
    offset : float
        Error of the target's place while it rests, alike in all frames and beside the covariance, each axis, m.
    max_shift_frames : float
        Frames by which places were moved to an even rate at most; 0 where times are even.
    """

    clip: int
    striker: str
    camera: Camera
    frame: Ints
    ball: Ints
    xy: Array
    covariance: Array
    launch: Array
    slide_ends: Array
    offset: float = 0.0
    max_shift_frames: float = 0.0

    @property
    def fps(self) -> float:
        return self.camera.fps

    @property
    def exposure(self) -> float:
        return self.camera.exposure

    def select(self, rows: Ints) -> MeasuredCollision:
        """Some of its rows."""
        some = {name: getattr(self, name)[rows] for name in ("frame", "ball", "xy", "covariance")}
        return replace(self, **some)

    def phases(self) -> Ints:
        """0 before the contact, 1 sliding, 2 rolling, -1 in an exposure that holds an event: (n,)."""
        opens = self.frame / self.fps
        closes = opens + self.exposure
        end = self.slide_ends[self.ball]
        out = np.full(len(self.frame), -1)
        out[closes <= self.launch[T_C]] = 0
        out[(opens >= self.launch[T_C]) & (closes <= end)] = 1
        out[(opens >= self.launch[T_C]) & (opens >= end)] = 2
        return out

    def smooth_stretches(self) -> Iterator[tuple[Array, Array, Ints]]:
        """Stretches of one ball in one phase: places (n, 2), claimed standard deviations (n,), m, and frames (n,)."""
        phase, claimed = self.phases(), self.claimed_std()
        for p in range(3):
            for b in range(2):
                rows = np.flatnonzero((phase == p) & (self.ball == b))
                for kept in _split_at_gaps(rows, self.frame[rows]):
                    yield self.xy[kept], claimed[kept], self.frame[kept]

    def paired_stretches(self) -> Iterator[tuple[Array, Array, Array, Array, Ints]]:
        """Of both balls, each in one phase: places (n, 2) and (n, 2), claimed (n,) and (n,), m, and frames (n,)."""
        phase, claimed = self.phases(), self.claimed_std()
        split = int(np.sum(self.ball == 0))
        frame, one, two = np.intersect1d(self.frame[:split], self.frame[split:], return_indices=True)
        two = two + split
        for p in range(3):
            for q in range(3):
                rows = np.flatnonzero((phase[one] == p) & (phase[two] == q))
                for kept in _split_at_gaps(rows, frame[rows]):
                    i, j = one[kept], two[kept]
                    yield self.xy[i], self.xy[j], claimed[i], claimed[j], frame[kept]

    def claimed_std(self) -> Array:
        """Standard deviation of each row that the tracks claim, (n,), m: rms of the axes."""
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=1, axis2=2) / 2))

    @cached_property
    def roots(self) -> Array:
        """Inverse Cholesky factors of the claimed covariances, (n, 2, 2)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)))

    @cached_property
    def resting_offset(self) -> Array:
        """The offset of the target where it rests, in claimed standard deviations, and zero elsewhere: (n,)."""
        return np.where((self.ball == 0) & (self.phases() == 0), self.offset / self.claimed_std(), 0.0)


def _split_at_gaps(rows: Ints, frame: Ints) -> Iterator[Ints]:
    """Rows in runs in which few frames are missing at a time, less a margin at either end."""
    for part in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(frame) > current_policy().max_frame_gap) + 1):
        if len(part):
            off = frame[part] - frame[part[0]]
            yield rows[
                part[
                    (off >= current_policy().event_margin_frames)
                    & (off <= off[-1] - current_policy().event_margin_frames)
                ]
            ]


def read_collisions(
    measured: Path | Sequence[Result], camera: Path | None = None
) -> tuple[list[MeasuredCollision], list[str]]:
    """Read the collisions of a tracker's RESULTS, of a table of tracks, or of results in memory.

    Parameters
    ----------
    measured : Path or sequence of Result
    camera : Path, optional
        camera.json of a table; RESULTS have their own.

    Returns
    -------
    clips : list of Measured
    left_out : list of str
        A line for each clip that cannot be used.

    Raises
    ------
    InputError
    """
    if not isinstance(measured, Path):
        source, measured = _read_memory(measured), Path("results")
    elif measured.is_dir():
        if camera is not None:
            raise InputError(f"--camera {camera}: {measured} holds its own; expected it with a table of tracks only")
        source = _read_results(measured)
    elif camera is None:
        if not measured.exists():
            raise InputError(f"{measured}: no such file or folder, expected RESULTS of a tracker or a table of tracks")
        raise InputError(f"{measured}: expected --camera camera.json with a table of tracks")
    else:
        source = _read_table(measured, camera)
    kept, rejected, left_out = [], [], []
    for number, tracks, own, measured_rows, strays in source:
        if (frame := find_exchange(tracks, own)) is not None:
            left_out.append(f"clip {number}: the balls have exchanged their names at frame {frame}")
            continue
        if why := explain_too_uneven(tracks, own):
            left_out.append(f"clip {number}: {why}")
            continue
        rows = measured_rows()
        if len(rows) > 1:
            left_out.append(f"clip {number}: {len(rows)} collisions in one recording")
            continue
        outcome = build_collision(tracks, {"clip": number} | rows[0], own)
        if isinstance(outcome, MeasuredCollision):
            kept.append(outcome)
            rejected.append(rows[0]["status"] == MISFIT)
            if strays:
                frames = ", ".join(map(str, strays))
                left_out.append(
                    f"clip {number}: places of another ball, in frame {frames}, to which a ball jumps and back"
                )
        else:
            left_out.append(f"clip {number}: {outcome}")
    if not kept:
        raise InputError(f"{measured}: no clip with a measured collision" + "".join(f"; {x}" for x in left_out[:1]))
    typical = float(np.median([c.launch[V0] for c in kept]))
    if typical > current_policy().max_launch_speed_m_s:
        raise InputError(f"{measured}: speeds of {typical:.3g} m/s; are scale and fps of the camera right?")
    launches = equalise_launches([c.launch for c in kept], rejected)
    return [replace(c, launch=one) for c, one in zip(kept, launches, strict=True)], left_out


# number, tracks, camera, what measures when asked, and the frames of places taken out as another ball's
Source = Iterator[tuple[int, Tracks, Camera, Callable[[], list[dict[Any, Any]]], list[int]]]


def _read_memory(results: Sequence[Result]) -> Source:
    """As if written and read again, for the same numbers to the last bit. Clips that share a number are counted."""
    if not isinstance(results, Sequence):
        raise InputError(f"results: of type {type(results).__name__}, expected a list of {GIVEN}")
    for k, result in enumerate(results):
        if not isinstance(result, Result):
            kind = type(result).__name__
            raise InputError(
                f"results: number {k} is of type {kind}, expected what tracker.track or tracker.measure gives"
            )
    own = len({r.number for r in results}) == len(results)
    for k, result in sorted(enumerate(results), key=lambda pair: pair[1].number if own else pair[0]):
        ((_, (tracks, _)),) = split_tracks(result.tracks, f"results: number {k}").items()
        known = Camera.from_dict(result.camera.to_dict())
        number = result.number if own else k
        yield number, tracks, known, partial(result.estimates.assign(clip=number).to_dict, "records"), []


def _read_results(folder: Path) -> Source:
    path = folder / "estimates.parquet"
    if not path.is_file():
        raise InputError(f"{folder}: expected RESULTS of a tracker (no estimates.parquet)")
    try:
        table = pd.read_parquet(path)
    except (OSError, ValueError) as e:  # pyarrow's are ValueErrors
        raise InputError(f"{path}: cannot be read as Parquet ({str(e).partition(chr(10))[0][:100]})") from None
    missing = [name for name in ESTIMATES if name not in table]
    if missing:
        raise InputError(f"{path}: no column {', '.join(missing)}")
    for number, rows in table.groupby("clip"):
        clip = int(str(number))
        yield clip, *read_clip(folder, clip), partial(rows.to_dict, "records"), []


def _read_table(path: Path, camera: Path) -> Source:
    given = read_tracks(path, camera)
    base, tables = given.camera, given.clips
    if why := detect_wrong_units((tracks, base) for tracks, _ in tables.values()):
        raise InputError(f"{path}: {why}")
    for number, (tracks, striker) in sorted(tables.items()):
        own = replace(base, striker=striker) if striker is not None else base
        tracks, strays = remove_strays(tracks, own)
        yield number, tracks, own, partial(measure, tracks, own), strays


def build_collision(tracks: Tracks, row: Mapping[Any, Any], camera: Camera) -> MeasuredCollision | str:
    """The collision that `row` of the estimates describes, or why it cannot be used.

    Where the tracker has none, tracks that start at the hit may still show it.
    """
    measured, start = (
        row["status"] in MEASURED,
        find_clock_start(tracks, camera),
    )  # what a misfit lacks is what we look for
    hit = _hit_from_estimates(row, start) if measured else guess_hit_from_outgoing(tracks, camera)
    if hit is None:
        return "no estimate of the contact" if measured else str(row["status"])
    if hit.launch is None and _count_frames_before(tracks, hit, camera) < current_policy().min_frames_before_contact:
        hit = guess_hit_from_outgoing(tracks, camera, hit.t_c)
        if hit is None:
            return (
                f"a ball is seen in fewer than {current_policy().min_frames_before_contact} frames before the contact"
            )
    tracks = replace(tracks, time=tracks.time - start)
    if (moved := measure_unevenness(tracks, camera)) > current_policy().max_uneven_frames:
        balls = [np.flatnonzero(tracks.particle == name) for name in hit.names]
        tracks = move_to_even_times(tracks, balls, hit.t_c, hit.slide_ends, camera)
    pair = [tracks.particle == name for name in hit.names]
    early = tracks.frame / camera.fps + camera.exposure <= hit.t_c
    rows = np.concatenate([np.flatnonzero(ball) for ball in pair])
    frame, early = tracks.frame[rows], early[rows]
    ball = np.repeat([0, 1], [pair[0].sum(), pair[1].sum()])
    xy, slope = camera.unproject(tracks.xy[rows])
    spread, steady = tracks.cov[rows], tracks.fixed[rows]
    if not np.all(np.linalg.eigvalsh(np.nan_to_num(spread - steady))[:, 0] > 0):  # NaN too
        spread, steady = np.tile(UNCLAIMED**2 * np.eye(2), (len(rows), 1, 1)), np.zeros_like(spread)
    resting = early & (ball == 0)
    covariance, fixed = (slope @ c @ np.swapaxes(slope, 1, 2) for c in (spread, steady))
    covariance[resting] -= fixed[resting]
    launch = hit.launch
    if launch is None:
        coming = early & (ball == 1)
        launch = _guess_launch(hit, row, frame[coming], xy[coming], xy[resting].mean(axis=0), camera)
    return MeasuredCollision(
        clip=int(row["clip"]),
        striker=str(row["striker"]),
        camera=camera,
        frame=frame,
        ball=ball,
        xy=xy,
        covariance=covariance,
        launch=launch,
        slide_ends=hit.slide_ends,
        offset=float(np.sqrt(np.trace(fixed[resting], axis1=1, axis2=2).mean() / 2)) if resting.any() else 0.0,
        max_shift_frames=moved if moved > current_policy().max_uneven_frames else 0.0,
    )


def _count_frames_before(tracks: Tracks, hit: HitGuess, camera: Camera) -> int:
    """The frames in which each ball is seen before the contact."""
    early = tracks.frame / camera.fps + camera.exposure <= hit.t_c
    return int(min((early & (tracks.particle == name)).sum() for name in hit.names))


def _hit_from_estimates(row: Mapping[Any, Any], start: float) -> HitGuess | None:
    """The hit by the tracker's estimates, its clock begun at `start`, s; None where they leave something open."""
    guess = np.array([_choose_estimate(row, name) for name in ("t_c", "v0", "b", "tau1", "tau2")])
    if not np.all(np.isfinite(guess)):
        return None
    t_c = guess[0] - start
    return HitGuess((row["particle1"], row["particle2"]), t_c, guess[1], guess[2], t_c + guess[3:])


def _guess_launch(
    hit: HitGuess, row: Mapping[Any, Any], frame: Ints, coming: Array, resting: Array, camera: Camera
) -> Array:
    """The launch (9,) of a striker seen in frames (n,) at places `coming` (n, 2), m, and a ball resting there."""
    heading = _fit_heading(frame, coming)
    d, b = np.array([np.cos(heading), np.sin(heading)]), hit.b
    n = np.sqrt(max(1 - b * b, 0.0)) * d - b * np.array([-d[1], d[0]])
    spins = guess_spin(row, heading, hit.v0, _fit_acceleration(frame / camera.fps, coming))
    return np.array([*(resting - camera.radius * n), hit.t_c, hit.v0, heading, b, *spins])


def _choose_estimate(row: Mapping[Any, Any], name: str) -> float:
    """A first guess of a quantity: where the tied fit is rejected the free fit comes nearer, if it tells it."""
    free = float(row.get(f"{name}_free", np.nan)) if row["status"] == MISFIT else np.nan
    return free if np.isfinite(free) else float(row[name])


def _fit_heading(frame: Ints, xy: Array) -> float:
    velocity = np.polyfit(frame - frame.mean(), xy, 1)[0]
    return float(np.arctan2(velocity[1], velocity[0]))


def _fit_acceleration(times: Array, xy: Array) -> Array:
    """Of a ball, (2,) m/s^2, by a parabola through its places; zero where they are few."""
    if len(times) < current_policy().min_frames_before_contact + 2:
        return np.zeros(2)
    return np.asarray(2 * np.polyfit(times - times.mean(), xy, 2)[0])


def find_uniform_conditions(clips: Sequence[MeasuredCollision]) -> list[str]:
    """A line for each thing that these clips can hardly tell, however many, because they are all alike in it."""
    speeds, headings, b = np.array([c.launch for c in clips]).T[[V0, HEADING, B]]
    said, normal = [], speeds * np.sqrt(1 - b**2)
    laws = {"restitution": normal, "spin transfer": speeds}  # the speeds that they hang on; friction's falls in a clip
    if same := [law for law, v in laws.items() if v.max() < current_policy().same_speed_ratio * v.min()]:
        said.append(
            f"all clips are at {np.median(speeds):.2g} m/s: how {' or '.join(same)} changes with the speed can hardly "
            "be told"
        )
    if np.ptp(b) < current_policy().same_impact_parameter:
        said.append(
            f"all clips have b near {np.median(b):.2f}: nothing that changes with it can be told, and "
            "hop and mass_mismatch look alike"
        )
    mean = np.exp(1j * headings).mean()
    if np.abs(np.angle(np.exp(1j * headings) / mean)).max() < np.radians(current_policy().same_heading_deg):
        said.append(
            "all clips go one way: a tilt of the plate, a grain or a tilted camera can hardly be told from drag"
        )
    return said


def split_held_out(clips: Sequence[MeasuredCollision]) -> tuple[list[MeasuredCollision], list[MeasuredCollision]]:
    """(to fit, to keep out): one in so many is kept out, evenly over the speeds.

    With clips enough the fastest and the most oblique are among it: what the fit never saw.
    """
    order = sorted(range(len(clips)), key=lambda k: float(clips[k].launch[V0]))
    count = max(len(clips) // current_policy().hold_out_one_in, 1)
    kept_out: set[int] = set()
    if len(clips) >= current_policy().min_clips_to_hold_out_extremes:
        kept_out = {order[-1], max(order[:-1], key=lambda k: abs(float(clips[k].launch[B])))}
    rest = [k for k in order if k not in kept_out]
    more = max(count - len(kept_out), 0)
    kept_out |= {rest[(2 * k + 1) * len(rest) // (2 * more)] for k in range(more)}
    fitted, held = ([c for k, c in enumerate(clips) if (k in kept_out) is out] for out in (False, True))
    return fitted, held
