"""The changes of an experiment that a plan compares: of launches, of film and camera, and of the plate."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from discrepancy.data.launch import HEADING, SIDE, SLIP, V0, B, X, Y
from discrepancy.fitting.parameters import list_candidates
from discrepancy.planning.experiment import PlannedExperiment
from synthcam_shared.arrays import Array

ALL_LAUNCHES_CHANGED = (
    "balls exchanged, oblique hits, many speeds and headings, all over the picture, films twice as long: all at once"
)
ChangedExperiment = tuple[str, PlannedExperiment]  # the change in words, and the experiment, not yet observed


@dataclass(frozen=True)
class DesignChange:
    """A change of an experiment.

    make: takes an experiment and random numbers. It returns the change in words and the changed experiment, not yet
    observed, or None if the change is impossible. launches: True if only the launches change, so that it can be
    combined with all others of that kind.
    """

    name: str
    make: Callable[[PlannedExperiment, np.random.Generator], ChangedExperiment | None]
    launches: bool = False


def apply_change(change: DesignChange, experiment: PlannedExperiment) -> ChangedExperiment | None:
    """Apply a change to a planned experiment. Returns the change in words and the experiment; None if impossible.

    At least half of the collisions must stay in view. Raises ValueError if the model has no motion for it.
    """
    if (made := change.make(experiment, np.random.default_rng(0))) is None:
        return None
    words, changed = made
    filmed = changed.observe()
    return (words, filmed) if 2 * len(filmed.clips) >= len(experiment.clips) else None


def change_all_launches(experiment: PlannedExperiment, rng: np.random.Generator) -> ChangedExperiment:
    """Apply all changes of launches to a planned experiment at once."""
    for change in CHANGES:
        if change.launches and (made := change.make(experiment, rng)):
            experiment = made[1]
    return ALL_LAUNCHES_CHANGED, experiment


def _spread_evenly(
    experiment: PlannedExperiment, rng: np.random.Generator, values: dict[int, Array]
) -> PlannedExperiment:
    """Spread columns of the launches evenly over the collisions. values: lowest and highest value by column."""
    launches = experiment.launches.copy()
    for column, ends in values.items():
        share = rng.permutation(len(launches)) / max(len(launches) - 1, 1)
        launches[:, column] = ends[0] + (ends[1] - ends[0]) * share
    return dataclasses.replace(experiment, launches=launches)


def _exchange_balls(experiment: PlannedExperiment, rng: np.random.Generator) -> ChangedExperiment:
    order = rng.permutation(len(experiment.clips))
    clips = tuple(dataclasses.replace(c, striker="ab"[k % 2]) for c, k in zip(experiment.clips, order, strict=True))
    return "the balls exchanged in half of the collisions", dataclasses.replace(experiment, clips=clips)


def _vary_speeds(experiment: PlannedExperiment, rng: np.random.Generator) -> ChangedExperiment:
    ends = np.median(experiment.launches[:, V0]) * np.array([0.3, 1.8])  # the paper's 0.1 to 0.6 m/s
    speeds = _spread_evenly(experiment, rng, {V0: ends}).launches[:, V0]
    return f"speeds from {ends[0]:.2g} to {ends[1]:.2g} m/s", _set_speeds(experiment, speeds)


def _set_speeds(experiment: PlannedExperiment, speeds: Array) -> PlannedExperiment:
    """Set the strikers' speeds (clips,), m/s; slips and spins change in proportion."""
    launches = experiment.launches.copy()
    launches[:, V0] = speeds
    launches[:, SLIP.start : SIDE + 1] *= (speeds / experiment.launches[:, V0])[:, None]
    return dataclasses.replace(experiment, launches=launches)


def _vary_headings(experiment: PlannedExperiment, rng: np.random.Generator) -> ChangedExperiment:
    turn = 2 * np.pi * (1 - 1 / max(len(experiment.clips), 1))
    return "headings all round", _spread_evenly(experiment, rng, {HEADING: np.array([0.0, turn])})


def _vary_positions(experiment: PlannedExperiment, rng: np.random.Generator) -> ChangedExperiment:
    camera, launches = experiment.camera, experiment.launches.copy()
    number, aside = rng.permutation(len(launches)), 0.25  # of the picture's size, from its middle
    corner = np.stack([np.where(number & 1, aside, -aside), np.where(number & 2, aside, -aside)], axis=-1)
    launches[:, [X, Y]] = camera.unproject((0.5 + corner) * np.array(camera.size))[0]
    return "collisions spread over the picture", dataclasses.replace(experiment, launches=launches)


def _double_length(experiment: PlannedExperiment, rng: np.random.Generator) -> ChangedExperiment:
    films = tuple(range(f.start, f.start + 2 * len(f)) for f in experiment.films)
    return "films twice as long", dataclasses.replace(experiment, films=films)


def _double_frame_rate(experiment: PlannedExperiment, rng: np.random.Generator) -> ChangedExperiment | None:
    """Film the same time in twice as many frames, with the same exposure if it fits between them."""
    camera = experiment.camera
    fps = 2 * camera.fps
    cut = _set_exposure(experiment, min(camera.exposure, 1 / fps))
    if cut is None:
        return None
    films = tuple(range(2 * f.start, 2 * f.stop) for f in cut.films)
    shorter = f", {1e3 * cut.camera.exposure:.3g} ms each" if cut.camera.exposure < camera.exposure else ""
    changed = dataclasses.replace(cut.through_camera(dataclasses.replace(cut.camera, fps=fps)), films=films)
    return f"{fps:g} frames a second{shorter}", changed


def _set_possible_exposure(experiment: PlannedExperiment, exposure: float) -> ChangedExperiment | None:
    camera = experiment.camera
    if not 0 < exposure <= 1 / camera.fps:
        return None
    changed = _set_exposure(experiment, exposure)
    return None if changed is None else (f"exposures of {1e3 * exposure:.3g} ms", changed)


def _set_exposure(experiment: PlannedExperiment, exposure: float) -> PlannedExperiment | None:
    """Set the exposure, with light in proportion; None if its effect on the errors is unknown."""
    camera = experiment.camera
    if exposure == camera.exposure:
        return experiment
    if (errors := experiment.errors.brighter(exposure / camera.exposure)) is None:
        return None
    return dataclasses.replace(experiment, errors=errors).through_camera(dataclasses.replace(camera, exposure=exposure))


def _magnify(experiment: PlannedExperiment, times: float) -> PlannedExperiment:
    camera, matrix = experiment.camera, experiment.camera.K.copy()
    matrix[:2, :2] *= times
    return experiment.through_camera(dataclasses.replace(camera, K=matrix, scale=camera.scale / times))


def _tilt_plate(experiment: PlannedExperiment, rng: np.random.Generator) -> ChangedExperiment | None:
    """Tilt the plate by half of the steepest tilt at which a ball stays at rest. The fit then finds the tilt."""
    model = experiment.model
    steepest = 7 / 5 * model.rolling_decel / model.gravity
    slopes = ("plate_tilt.x", "plate_tilt.y")
    level = any(c.strengths == slopes and not any(c.held) for c in list_candidates(model, experiment.names))
    if steepest == 0 or not level:
        return None
    tilted = model.replace({slopes[0]: steepest / 2})
    changed = dataclasses.replace(experiment, model=tilted, names=(*experiment.names, *slopes))
    return f"the plate tilted by about {1e3 * steepest / 2:.2g} mrad along x", changed


CHANGES = (
    DesignChange("exchanged", _exchange_balls, launches=True),
    DesignChange(
        "oblique",
        lambda e, rng: ("oblique collisions, |b| up to 0.6", _spread_evenly(e, rng, {B: np.array([-0.6, 0.6])})),
        launches=True,
    ),
    DesignChange("speeds", _vary_speeds, launches=True),
    DesignChange("headings", _vary_headings, launches=True),
    DesignChange("longer", _double_length, launches=True),
    DesignChange("aside", _vary_positions, launches=True),
    DesignChange("faster", lambda e, _: ("balls twice as fast", _set_speeds(e, 2 * e.launches[:, V0]))),
    DesignChange("slower", lambda e, _: ("balls half as fast", _set_speeds(e, e.launches[:, V0] / 2))),
    DesignChange("frame_rate", _double_frame_rate),
    DesignChange("exposure_longer", lambda e, _: _set_possible_exposure(e, 2 * e.camera.exposure)),
    DesignChange("exposure_shorter", lambda e, _: _set_possible_exposure(e, e.camera.exposure / 2)),
    DesignChange("field_wider", lambda e, _: ("a field of view twice as wide", _magnify(e, 0.5))),
    DesignChange("field_narrower", lambda e, _: ("a field of view half as wide", _magnify(e, 2.0))),
    DesignChange("more", lambda e, _: ("twice as many collisions", e.select([*range(len(e.clips))] * 2))),
    DesignChange("tilted", _tilt_plate),
)
TOGETHER = DesignChange("together", change_all_launches)
