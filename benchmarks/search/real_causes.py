"""Causes put into real tracks: whether the search of free stretches names them, with their size, and nothing else.

python -m benchmarks.search.real_causes CLONE [CLONE ...] [--only CAUSE,...] [--jobs N] [-o out/real_causes.jsonl]
python -m benchmarks.search.real_causes CLONE [CLONE ...] --prepare FOLDER
python -m benchmarks.search.real_causes FOLDER/SET.pkl [FOLDER/SET.pkl ...] --minutes 2 --jobs 16
python -m benchmarks.search.real_causes --table out/real_causes.jsonl
make bench-real-causes CLONES="CLONE ..."

Each CLONE is a clone of one of the repositories that `benchmarks.real.recordings` reads. Its hits are cut into free
stretches and corrected by the warp that they show. With --prepare these sets are written to a folder, from which
another machine searches them without the clones. Each set then gets one known cause:

- acceleration: a constant one, as of a tilted plate: in full on air and on a ball that slides, by 5/7 on a ball that
  rolls. A body that it makes faster also loses more speed, by the loss that the tracks without the cause show;
- lens: r (1 + k r^2) about the middle of the picture;
- aspect: one axis longer by a factor;
- time: all times longer by a factor;
- time of half: the times of every second recording longer by a factor.

Strengths are 5 and 10 times the detection limit of the search of the same tracks without the cause, but at most 0.8 of
the largest value that the effect may have. If that is below 3 limits, the strength is a few per cent. A line for each
set says what was put in, what was named, and with which value. Free stretches cannot show the time of all recordings,
as the effect `clock_error` proves: there the right answer is to name nothing. Neither can they show masses, which
`benchmarks.real.masses` changes.

A run that was stopped continues: sets whose line the output has are not searched again. Each line says by which commit
it was made. The tables of docs/background/real_causes.md are printed at the end, or from an output with --table.

--minutes is the limit of a search by the clock. A busy machine may reach it, and the search then names nothing. Such a
line says `cut_short`, the table counts it as not named, and a run that continues searches that set again.

The tracks have small accelerations and distortions of their own. `own` is what the set without a cause shows of the
effect, by one linear step from its base model. `z` is the error of the size, found less own, in its standard errors.
`own_std` is the standard error of own along the cause. The tables count the part of it that the size does not share
(`measure_distance`).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import pickle
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.real.recordings import RecordedHit, read_balls, read_billiards, read_discs, read_pucks
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C, V0
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.search import search
from discrepancy.wording import describe_search
from synthcam.library import library
from synthcam.model import Model, as_model
from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from tracker.calibration.camera_warp import fit_camera_warp
from tracker.calibration.free_stretches import find_free_stretches
from tracker.camera.camera import Camera
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import measure_path_noise

TIMES = (5.0, 10.0)  # strengths, in detection limits
LABORATORY_WORDS = {"3cushiontool": "billiards", "TIF083-Expfys1A": "pucks", "TIF083A": "discs"}
CAUSE_WORDS = {  # in the order of the tables
    "none": "none",
    **{f"acceleration to {degrees} deg": f"acceleration to {degrees}°" for degrees in (20, 110, 200)},
    "lens +1": "pincushion distortion",
    "lens -1": "barrel distortion",
    "aspect": "x axis longer",
    "time": "all times longer",
    "time of half": "every second time longer",
}
SHOWN = "set cause times strength shown named false size own own_std std z verdict seconds".split()
ROLLING_SHARE, SLIP_SHARE = 5 / 7, 2 / 7  # of a push, and of the slip in the velocity, for a solid ball
ON_CLOTH = {"restitution": 0.95, "sliding_friction": 0.2, "spin_transfer": 0.1, "rolling_decel": 0.04}
ON_AIR = {"restitution": 0.8, "sliding_friction": 0.0, "rolling_decel": 0.02}
LABORATORIES: dict[str, tuple[Callable[[Path], list[RecordedHit]], dict[str, float]]] = {
    "3cushiontool": (read_billiards, ON_CLOTH | {"rolling_drag": 0.01}),
    "TIF083-Expfys1A": (read_pucks, ON_AIR | {"rolling_drag": 0.03}),
    "TIF083A": (read_discs, ON_AIR | {"rolling_drag": 0.03}),
}


# --- Tracks ---


def read_clips(hits: Sequence[RecordedHit], warp_file: str | None) -> list[MeasuredCollision]:
    """Read hits as collisions whose contact is where the bodies are nearest, corrected by the warp of a camera file.

    Without a file it is the warp that the hits show; "none": no correction.
    """
    widths = [hit.camera["ball_diameter"] for hit in hits]  # discs differ; a search needs one width
    cameras = [Camera.of(hit.camera | {"ball_diameter": float(np.median(widths))}) for hit in hits]
    every = [read_balls(hit, camera) for hit, camera in zip(hits, cameras, strict=True)]
    clips = [_build(k, balls, camera) for k, (balls, camera) in enumerate(zip(every, cameras, strict=True))]
    if warp_file == "none":
        return clips
    try:
        if warp_file:
            warp = Camera.of(json.loads(Path(warp_file).read_text())).warp
        else:
            parts = [find_free_stretches(balls, c.ball_diameter) for balls, c in zip(every, cameras, strict=True)]
            found = fit_camera_warp(cameras[0], parts)
            print(*found.summary(), sep="\n", flush=True)
            warp = found.camera.warp
    except InputError as error:
        print(error, flush=True)
        return clips
    return clips if warp is None else [replace(c, xy=c.xy + warp.displace(c.xy)[0]) for c in clips]


def _build(number: int, balls: Sequence[BallTrack], camera: Camera) -> MeasuredCollision:
    """Build a collision; its striker is the ball that moves before the contact."""
    _, i, j = np.intersect1d(balls[0].frame, balls[1].frame, return_indices=True)
    at = int(np.argmin(np.hypot(*(balls[0].position[i] - balls[1].position[j]).T)))
    contact, noise = float(balls[0].time[i[at]]), measure_path_noise((ball.frame, ball.position) for ball in balls)
    early = [ball.position[ball.time < contact] for ball in balls]
    ways = [np.hypot(*(p[-1] - p[0])) if len(p) > 1 else 0.0 for p in early]
    target, striker = balls if ways[1] >= ways[0] else balls[::-1]
    before = striker.time < contact
    velocity = np.polyfit(striker.time[before][-8:], striker.position[before][-8:], 1)[0]
    place = (balls[0].position[i[at]] + balls[1].position[j[at]]) / 2
    launch = np.array([*place, contact, np.hypot(*velocity), np.arctan2(velocity[1], velocity[0]), 0.0])
    count = len(target) + len(striker)
    return MeasuredCollision(
        clip=number,
        striker="b" if striker.particle == 1 else "a",
        camera=camera,
        frame=np.concatenate([target.frame, striker.frame]),
        ball=np.repeat([0, 1], [len(target), len(striker)]),
        xy=np.concatenate([target.position, striker.position]),
        covariance=np.tile(noise**2 * np.eye(2), (count, 1, 1)),
        launch=launch,
        slide_ends=np.full(2, contact),
    )


def centre_clips(clips: Sequence[MeasuredCollision]) -> list[MeasuredCollision]:
    """Move the middle of all positions to that of the picture."""
    every = np.concatenate([clip.xy for clip in clips])
    shift = find_centre(clips[0]) - (every.min(axis=0) + every.max(axis=0)) / 2
    at = np.r_[shift, np.zeros(len(clips[0].launch) - 2)]
    return [replace(clip, xy=clip.xy + shift, launch=clip.launch + at) for clip in clips]


def find_centre(clip: MeasuredCollision) -> Array:
    """Find the position (2,) in the middle of the picture, m."""
    middle = np.array([[clip.camera.K[0, 2], clip.camera.K[1, 2]]])
    return np.asarray(clip.camera.unproject(middle)[0][0])


# --- Causes ---


@dataclass(frozen=True)
class Cause:
    """A known cause: what it does to a clip at a strength, and the claims that name it rightly.

    strengths: of the effect, one or x and y, whose values times `unit` are the strength. laws: free laws that say the
    same in general.
    """

    name: str
    apply: Callable[[MeasuredCollision, float], MeasuredCollision]
    effect: str
    strengths: tuple[str, ...]
    unit: float = 1.0
    laws: tuple[str, ...] = ()
    heading: float = 0.0  # rad, of two strengths
    otherwise: float = 0.03  # the strength if these tracks show no strength that the effect may have

    def find_limit(
        self, information: Sequence[Sequence[float]] | None, sigma: float = 5.0, least_times: float = 3.0
    ) -> float | None:
        """The strength that is seen with 5 sigma in its direction; None if the effect cannot have it three times.

        information (k, k): of the strengths of the effect, beside the base model; None if the model absorbs it.
        """
        if information is None:
            return None
        way = np.array([np.cos(self.heading), np.sin(self.heading)])[: len(information)]
        limit = sigma * abs(self.unit) / float(np.sqrt(way @ np.array(information) @ way))
        return limit if least_times * limit < self.largest else None

    @property
    def largest(self) -> float:
        """The largest strength that is put in: the effect may have more, since the tracks have some of their own."""
        return 0.8 * abs(self.unit) * library()[self.effect].parameters()[0].high


def accelerate(clip: MeasuredCollision, size: float, heading: float, model: Model) -> MeasuredCollision:
    """Add a constant acceleration, m/s^2 of a body without friction, to each path before and after the contact.

    model: if it has no sliding friction, the whole acts on all bodies. Else they are balls: the whole acts on a ball
    that slides, 5/7 on one that rolls. Its loss acts on the faster or slower body. Each slide is that of the path's own
    best fit.
    """
    push, contact = size * np.array([np.cos(heading), np.sin(heading)]), float(clip.launch[T_C])
    time, xy = clip.frame / clip.fps, clip.xy.copy()
    loss, glides = (model.rolling_decel, model.rolling_drag), model.sliding_friction == 0
    for ball, late in ((1, False), (1, True), (0, True)):
        rows = np.flatnonzero((clip.ball == ball) & ((time > contact) == late))
        if len(rows) < 3:
            continue
        since = time[rows] - (contact if late else time[rows[0]])
        start = BallStart.gliding(since, clip.xy[rows]) if glides else BallStart.of(since, clip.xy[rows])
        xy[rows] += start.move(since, push, loss) - start.move(since, np.zeros(2), loss)
    return replace(clip, xy=xy)


@dataclass(frozen=True)
class BallStart:
    """How a ball starts: its velocity, the acceleration of its slide (2,), m/s^2, and the end of it, s."""

    velocity: Array
    pull: Array
    end: float
    share: float = ROLLING_SHARE  # of a push, after the slide

    @classmethod
    def gliding(cls, since: Array, xy: Array) -> BallStart:
        """A body on air, whose path is a parabola."""
        return cls(np.polyfit(since, xy, min(2, len(since) - 1))[-2], np.zeros(2), 0.0, share=1.0)

    @classmethod
    def of(cls, since: Array, xy: Array, max_roll: float = 0.3) -> BallStart:
        """Fit parabolas of a slide on cloth and of the roll after it, which loses less than `max_roll`, m/s^2."""
        best = (np.inf, 0.0, np.zeros((4, 2)))
        for end in since[2:-3]:
            shapes = np.stack([np.ones_like(since), since, since**2 / 2, np.maximum(since - end, 0) ** 2 / 2], axis=-1)
            parts = np.linalg.lstsq(shapes, xy, rcond=None)[0]
            best = min(best, (float(((xy - shapes @ parts) ** 2).sum()), float(end), parts), key=lambda fit: fit[0])
        _, end, (_, velocity, pull, change) = best
        if np.hypot(*(pull + change)) > max_roll:  # it slides throughout
            pull, velocity, _ = np.polyfit(since, xy, 2) * [[2], [1], [1]]
            end = float(since[-1])
        if np.hypot(*pull) < max_roll or len(since) < 6:
            return cls(np.polyfit(since, xy, min(2, len(since) - 1))[-2], np.zeros(2), 0.0)
        return cls(velocity, pull, end)

    def move(self, since: Array, push: Array, loss: tuple[float, float]) -> Array:
        """Displacements (n, 2), m, under a push, with a rolling loss, m/s^2 and 1/s, against the motion.

        The velocity less 2/7 of the slip is that of a ball that rolls: friction does not change it.
        """
        rate = max(float(np.hypot(*self.pull)) / SLIP_SHARE, 1.0)  # friction takes so much slip away in a second
        slip = -self.end * self.pull / SLIP_SHARE
        tiny = 1e-3  # m/s: a slower slip, or ball, has ended

        def change(_: float, state: Array) -> Array:
            slip, rolling = state[:2], state[2:4]
            velocity = rolling + (1 - self.share) * slip
            speed = np.hypot(*velocity)
            lost = (loss[0] + loss[1] * speed) * velocity / np.hypot(speed, tiny)
            turned = push - rate * slip / np.hypot(np.hypot(*slip), tiny)
            return np.concatenate([turned, self.share * push - lost, velocity])

        start = np.concatenate([slip, self.velocity - SLIP_SHARE * slip, np.zeros(2)])
        ends = (0.0, float(since.max()) + tiny)
        path = solve_ivp(change, ends, start, method="LSODA", t_eval=since, rtol=1e-8, atol=1e-10)
        return np.asarray(path.y[4:].T)


def distort(clip: MeasuredCollision, k: float, sign: float) -> MeasuredCollision:
    """Distort positions about the middle of the picture, with the distance over that of the camera's focal length."""
    centre, focus = find_centre(clip), clip.camera.K[0, 0] * clip.camera.scale
    off = clip.xy - centre
    return replace(clip, xy=centre + off * (1 + sign * k * (off**2).sum(axis=1) / focus**2)[:, None])


def stretch_axis(clip: MeasuredCollision, share: float) -> MeasuredCollision:
    """Lengthen x by a share of it, about the middle of the picture."""
    centre = find_centre(clip)
    return replace(clip, xy=centre + (clip.xy - centre) * [1 + share, 1.0])


def slow_clock(clip: MeasuredCollision, share: float) -> MeasuredCollision:
    """Lengthen all times by a share."""
    launch = clip.launch.copy()
    launch[T_C] *= 1 + share
    launch[V0] /= 1 + share
    camera = replace(clip.camera, fps=clip.camera.fps / (1 + share))
    return replace(clip, camera=camera, launch=launch, slide_ends=clip.slide_ends * (1 + share))


def slow_half(clip: MeasuredCollision, share: float) -> MeasuredCollision:
    """Lengthen the times of every second recording."""
    return slow_clock(clip, share) if clip.clip % 2 else clip


def list_causes(model: Model) -> Iterator[Cause]:
    """List the causes for a laboratory."""
    g, glides = model.gravity, model.sliding_friction == 0
    unit = 5 / 7 * g if glides else g  # in the model a body without friction rolls
    for degrees in (20, 110, 200):
        name, heading = f"acceleration to {degrees} deg", float(np.radians(degrees))
        push = partial(accelerate, heading=heading, model=model)
        yield Cause(name, push, "plate_tilt", ("x", "y"), unit, ("force_place",), heading)
    for sign in (1.0, -1.0):
        yield Cause(f"lens {sign:+.0f}", partial(distort, sign=sign), "lens_distortion", ("k1",), sign)
    yield Cause("aspect", stretch_axis, "aspect_error", ("e",), otherwise=0.005)
    yield Cause("time", slow_clock, "clock_error", ("e",), otherwise=0.01)
    if not glides:  # on air nothing tells the time
        yield Cause("time of half", slow_half, "clock_error", ("e",), laws=("clock_clip",), otherwise=0.05)


# --- Searches ---


@dataclass(frozen=True)
class CausedSet:
    """A set of recordings with a cause of a strength put in; without one it has the name "none"."""

    name: str  # of the set; it begins with that of the laboratory
    clips: Sequence[MeasuredCollision]
    model: Model
    cause: Cause | None = None
    times: float = 0.0  # the detection limit
    strength: float = 0.0

    @classmethod
    def of(cls, name: str, clips: Sequence[MeasuredCollision]) -> CausedSet:
        """The set without a cause; its clips are numbered from zero, since a cause may be in every second one.

        The middle of all positions moves to that of the picture. The origin of a table in metres may be anywhere, and
        a distortion about a point outside the recorded area is not that of a lens.
        """
        clips = centre_clips([replace(clip, clip=k) for k, clip in enumerate(clips)])
        law = next(law for laboratory, (_, law) in LABORATORIES.items() if name.startswith(laboratory))
        return cls(name, clips, as_model({"ball": {"diameter": clips[0].camera.ball_diameter}, "model": law}))


def run_set(given: CausedSet, minutes: float) -> dict[str, Any]:
    """Search one set; the line says what was found."""
    begun = time.process_time()  # wall time tells of the load of the machine
    line: dict[str, Any] = {"set": given.name, "cause": given.cause.name if given.cause else "none"}
    line |= {"times": given.times, "strength": given.strength}
    found = search(given.clips, given.model, seconds=60 * minutes, stretches=True)
    line |= {"verdict": str(found.verdict), "seconds": round(time.process_time() - begun, 1)}
    line["cut_short"] = found.interrupted is not None
    line["claims"] = [
        {"effect": c.effect, "aliases": c.aliases[1:], "sigma": round(c.sigma, 1), "values": c.values, "std": c.std}
        for c in found.claims
    ]
    line["law"] = found.free_law.law.name if found.free_law else None
    line["identifiable"] = [s.effect for s in found.scores if s.identifiable]
    seen = [s for s in found.scores if math.isfinite(s.limit)]
    line["loss"] = {name: found.base_fit.model.value(name) for name in ("rolling_decel", "rolling_drag")}
    line["information"] = {s.effect: _measure_information(found.base_fit, s.columns).tolist() for s in seen}
    line["own"] = {s.effect: np.linalg.lstsq(*found.base_fit.information(s.columns))[0].tolist() for s in seen}
    line["scatter"] = vars(found.data.scatter)
    line["gap"] = [round(x, 3) for x in (found.gap.before, found.gap.after, found.gap.floor)]
    line["stretches"] = [len(found.data.clips), len(found.data.held_out)]
    line["withdrawn"] = [test.name for test in found.rejected]
    return line | {"sentence": describe_search(found)}


def judge(line: dict[str, Any], cause: Cause, bare: dict[str, Any]) -> dict[str, Any]:
    """Compare the claims of a line with its cause; bare: the line of the set without a cause."""
    right = [c for c in line["claims"] if cause.effect in (c["effect"], *c["aliases"])]
    law = line["law"] if line["law"] in cause.laws else None
    wrong = [c["effect"] for c in line["claims"] if c not in right]
    if line["law"] and law is None:
        wrong.append(line["law"])
    own = cause.unit * np.array(bare["own"].get(cause.effect, np.zeros(len(cause.strengths))))[: len(cause.strengths)]
    out: dict[str, Any] = {
        "shown": cause.effect in bare.get("identifiable", ()),
        "named": bool(right or law),
        "false": wrong,
    }
    out["own"] = own.tolist()
    way = np.array([np.cos(cause.heading), np.sin(cause.heading)])[: len(own)]
    if cause.find_limit(bare["information"].get(cause.effect)) is not None:
        out["own_std"] = abs(cause.unit) * float(np.sqrt(way @ np.linalg.inv(bare["information"][cause.effect]) @ way))
    if right and right[0]["effect"] == cause.effect:
        values, stds = (
            cause.unit * np.array([right[0][kind].get(f"{cause.effect}.{s}", np.nan) for s in cause.strengths])
            for kind in ("values", "std")
        )
        std = float(np.sqrt(np.nanmean(stds**2)))
        out |= {"size": float(values @ way), "found": values.tolist(), "std": std}
        out["z"] = float((values - own) @ way - line["strength"]) / std if std else None
    return line | out


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "sources", nargs="*", type=Path, default=[Path(p) for p in os.environ.get("CLONES", "").split()]
    )
    parser.add_argument("--only", default="", help="only causes whose name begins with one of these")
    parser.add_argument("--warp", help="camera.json of tracker warp; none: no correction; default: fitted to the hits")
    parser.add_argument("--hits", type=int, default=20, help="recordings of a set")
    parser.add_argument("--parts", type=int, default=2, help="sets of recordings of a laboratory")
    parser.add_argument("--every", type=int, default=1, help="keep every so many-th frame of bodies on air")
    parser.add_argument("--minutes", type=float, default=20, help="time limit of a search")
    parser.add_argument("--table", type=Path, help="print the table of this output, and search nothing")
    parser.add_argument("--prepare", type=Path, help="write the sets to this folder, and search nothing")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/real_causes.jsonl"))
    given = parser.parse_args()
    if given.table:
        print(render_tables(read_lines(given.table)))
        return
    if not given.sources:
        raise SystemExit(f"expected paths to clones of {', '.join(LABORATORIES)}, or sets written with --prepare")
    sets = [one for source in given.sources for one in read_sets(source, given)]
    if given.prepare:
        given.prepare.mkdir(parents=True, exist_ok=True)
        for one in sets:
            (given.prepare / f"{one.name}.pkl").write_bytes(pickle.dumps(one.clips))
        return
    given.output.parent.mkdir(parents=True, exist_ok=True)
    known = [line for line in read_lines(given.output) if not line.get("cut_short")] if given.output.exists() else []
    done = {(line["set"], line["cause"], line["times"]): line for line in known}
    commit = find_commit()
    with given.output.open("a") as file:
        for line in run_all(sets, tuple(given.only.split(",")), given.minutes, given.jobs, done):
            show(line | {"commit": commit}, file)
    print(render_tables(read_lines(given.output)))


def show(line: dict[str, Any], file: IO[str]) -> None:
    """Append a line to a file and print what matters of it."""
    file.write(json.dumps(line, default=float) + "\n")
    file.flush()
    print({k: line.get(k) for k in SHOWN}, flush=True)


def find_commit() -> str:
    """Find the commit of this program, with a plus if files differ from it."""
    asked = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty=+"]
    return subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Read the lines of an output; of a set that was searched again, the last one."""
    every = [json.loads(line) for line in path.read_text().splitlines()]
    return list({(line["set"], line["cause"], line["strength"]): line for line in every}.values())


# --- Tables ---


def render_tables(lines: Sequence[dict[str, Any]]) -> str:
    """Render the lines of sets as a table of results, one of their sums, and the commits that made them."""
    commits = ", ".join(sorted({line.get("commit", "unknown") for line in lines}))
    return "\n\n".join([render_results(lines), render_sums(lines), f"commits: {commits}"])


def render_results(lines: Sequence[dict[str, Any]]) -> str:
    """Render a row for each set and cause, with its strengths side by side."""
    rows = ["| set | cause | 5 times the limit | 10 times the limit |", "|---|---|---|---|"]
    for (name, cause), group in _group(lines, lambda line: (line["set"], line["cause"])).items():
        weak, *strong = sorted(group, key=lambda line: float(line["strength"]))
        cells = [_describe_result(line) for line in (weak, *strong)] + [""] * (not strong)
        rows.append(f"| {_name_set(name)} | {CAUSE_WORDS[cause]} | {' | '.join(cells)} |")
    return "\n".join(rows)


def measure_distance(line: Mapping[str, Any]) -> float | None:
    """Measure how far a size, less own, is from the strength put in, in standard errors; None without a size.

    The size and own come from the same noise. Let the errors of the size and of own be s and o. If one is an efficient
    estimate, the difference has the variance |o^2 - s^2| (Hausman, Econometrica 46 (1978) 1251). A strong distortion
    spreads the outermost positions, so s may be a fifth of o. The error that counts is the larger one of s and that of
    the difference.
    """
    if line.get("z") is None:
        return None
    own_std = line.get("own_std", line["std"])
    return float(line["z"] * line["std"] / math.sqrt(max(line["std"] ** 2, own_std**2 - line["std"] ** 2)))


def _describe_result(line: Mapping[str, Any]) -> str:
    """Describe a result, with the size over the true one, less own, and its distance in errors."""
    if line.get("cut_short"):
        return "cut short"
    false = f"false: {', '.join(line['false'])}" if line["false"] else ""
    if not line["named"]:
        return false or f"nothing named (`{line['verdict']}`)"
    parts = []
    if (distance := measure_distance(line)) is not None:
        parts = [f"{1 + line['z'] * line['std'] / line['strength']:.2f}", f"{abs(distance):.1f}"]
    if line["shown"] and not any(math.isclose(line["times"], times) for times in TIMES):
        parts.append(f"{line['times']:.1f} times")
    named = f"named ({', '.join(parts)})" if parts else "named"
    return f"{named}, {false}" if false else named


def render_sums(lines: Sequence[dict[str, Any]]) -> str:
    """Render what was named in each laboratory, and how far sizes, less own, are from those put in."""
    rows = [
        "| sets | number | false names | with a limit | named | sizes | rms distance | within 1 error | within 1.96 |"
    ]
    rows.append("|---|---|---|---|---|---|---|---|---|")
    groups = _group(lines, lambda line: f"{LABORATORY_WORDS[find_laboratory(line['set'])]}, {_name_kind(line)}")
    for title, group in {**groups, "all": lines}.items():
        shown = [line for line in group if line["shown"]]
        z = np.array([z for line in shown if (z := measure_distance(line)) is not None])
        counts = [
            len(group),
            sum(bool(line["false"]) for line in group),
            len(shown),
            sum(line["named"] for line in shown),
        ]
        sizes = [f"{np.sqrt(np.mean(z**2)):.1f}", (abs(z) <= 1).sum(), (abs(z) <= 1.96).sum()] if len(z) else [""] * 3
        rows.append("| " + " | ".join(map(str, [title, *counts, len(z) or "", *sizes])) + " |")
    return "\n".join(rows)


def _name_kind(line: Mapping[str, Any]) -> str:
    if line["cause"] == "none":
        return "no cause"
    if not line["shown"]:
        return "no limit"
    return "accelerations" if line["cause"].startswith("acceleration") else "distortions"


def _name_set(name: str) -> str:
    laboratory, _, part = name.rpartition("-")
    return f"{LABORATORY_WORDS[laboratory]} {int(part) + 1}"


def _group(lines: Iterable[dict[str, Any]], key: Callable[[dict[str, Any]], Any]) -> dict[Any, list[dict[str, Any]]]:
    """Group lines by a key, in the order of the laboratories, sets, causes and strengths."""

    def order(line: dict[str, Any]) -> tuple[str, int]:
        return _name_set(line["set"]), list(CAUSE_WORDS).index(line["cause"])

    groups: dict[Any, list[dict[str, Any]]] = {}
    for line in sorted(lines, key=order):
        groups.setdefault(key(line), []).append(line)
    return groups


def find_laboratory(source: Path) -> str:
    """Find the laboratory of a clone or of a set."""
    return max((name for name in LABORATORIES if name in str(source)), key=len)


def read_sets(source: Path, given: argparse.Namespace) -> list[CausedSet]:
    """Read the sets of a clone, or the one of a file."""
    if source.is_file():
        return [CausedSet.of(source.stem, pickle.loads(source.read_bytes()))]
    name = find_laboratory(source)
    clips = read_clips(LABORATORIES[name][0](source), given.warp)
    if name != "3cushiontool":
        clips = [clip.select(np.flatnonzero(clip.frame % given.every == 0)) for clip in clips]
    return [CausedSet.of(f"{name}-{k}", clips[k :: given.parts][: given.hits]) for k in range(given.parts)]


def run_all(
    sets: Sequence[CausedSet],
    only: tuple[str, ...],
    minutes: float,
    jobs: int,
    done: Mapping[tuple[str, str, float], dict[str, Any]],
) -> Iterator[dict[str, Any]]:
    """Search all sets without a cause, and then with each; the lines come as they are ready.

    done: the lines that an earlier run has written, by set, cause and times.
    """
    bare = {name: line for (name, cause, _), line in done.items() if cause == "none"}
    running = dict[Future[dict[str, Any]], CausedSet]()
    with ProcessPoolExecutor(jobs) as pool:

        def submit(some: Iterable[CausedSet]) -> None:
            for one in some:
                if (one.name, one.cause.name if one.cause else "none", one.times) not in done:
                    running[pool.submit(run_set, one, minutes)] = one

        submit(sets)
        for one in sets:
            if one.name in bare:
                submit(put_causes(one, bare[one.name], only))
        while running:
            for job in wait(running, return_when=FIRST_COMPLETED).done:
                one, line = running.pop(job), job.result()
                if one.cause is not None:
                    yield judge(line, one.cause, bare[one.name])
                    continue
                bare[one.name] = line
                false = [c["effect"] for c in line["claims"]] + ([line["law"]] if line["law"] else [])
                yield line | {"shown": False, "named": False, "false": false}
                submit(put_causes(one, line, only))


def put_causes(bare: CausedSet, line: dict[str, Any], only: tuple[str, ...]) -> Iterator[CausedSet]:
    """Put each cause into a set, with strengths by the line of the set without one."""
    for cause in list_causes(bare.model.replace(line["loss"])):
        limit, done = cause.find_limit(line["information"].get(cause.effect)), 0.0
        for times in TIMES if cause.name.startswith(only) else ():
            strength = cause.otherwise * times / 5
            if limit is not None and cause.name != "time of half":
                strength = min(times * limit, cause.largest)
                times = strength / limit
            if strength == done:
                continue
            done = strength
            clips = [cause.apply(clip, strength) for clip in bare.clips]
            yield replace(bare, clips=clips, cause=cause, times=times, strength=strength)


def _measure_information(fit: ModelFit, columns: Sequence[Array]) -> Array:
    """Information on an effect's strengths, without the stretch that shows most: alone it makes no claim."""
    left = [c - q @ (q.T @ c) for c, q in zip(columns, fit.linearisation.launch_bases, strict=True)]
    each = np.array([float((c**2).sum()) for c in left])
    return np.asarray(fit.information(columns)[0] * (1 - each.max() / max(each.sum(), 1e-300)))


if __name__ == "__main__":
    main()
