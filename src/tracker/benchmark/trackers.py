"""Trackers by name: run on the films of a suite, and described for their entries."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from synthcam_shared.errors import InputError
from tracker.benchmark.judging.tracker_results import ALL_CLIPS, ClipSample, TrackerResults, read_clip_results
from tracker.benchmark.suite.definition import Suite
from tracker.camera.recordings import Recording, open_source
from tracker.detection.choose import choose_detector
from tracker.detection.detect import load_detector, load_linker, make_view
from tracker.pipeline import run
from tracker.recording import track_clip
from tracker.results import load_json, write_json

OWN_TRACKER = "synthcam"  # the detector of this package that suits the film
RUN_HERE = "run here"  # in an entry: not submitted


@dataclass(frozen=True)
class Entrant:
    """A tracker by its name, and the clips that it runs on."""

    name: str
    sample: ClipSample = ALL_CLIPS

    @property
    def detector(self) -> str | None:
        """Name of the detector; None where the film decides."""
        return None if self.name == OWN_TRACKER else self.name

    @property
    def own(self) -> str:
        """Who determines the centres: see `TrackerResults`."""
        return "centre" if self.name.partition("+")[0] in (OWN_TRACKER, "maximum_likelihood", "discs") else "glint"


def parse_names(names: str) -> list[str]:
    """Split names at commas, each once. Raises InputError for an unknown name, or where its package is missing."""
    wanted = list(dict.fromkeys(name.strip() for name in names.split(",") if name.strip()))
    for name in wanted:
        if name != OWN_TRACKER:
            load_detector(name)
    return wanted


def make_entrants(suite: Suite, names: str = "") -> tuple[list[Entrant], list[str]]:
    """Make trackers from names separated by commas; '': the list of the suite, without those that cannot run here.

    The second value has a line for each that was left out, with the reason. Raises InputError for a name that is
    unknown, or whose package is missing.
    """
    data, notes, out = suite.definition.data, [], []
    wanted, clip = parse_names(names), _first(suite)
    for name in wanted or map(str, data["trackers"]):
        sampled = data["sampled"].get(name, {})
        one = Entrant(name, ClipSample(sampled.get("clips"), tuple(sampled.get("without", ()))))
        try:
            if one.detector is not None:
                load_detector(one.detector)(make_view(clip, one.detector))
                load_linker(one.detector, clip.camera)
        except InputError as error:
            if wanted:
                raise
            notes.append(f"{name}: left out: {error}")
            continue
        out.append(one)
    return out, notes


def run_tracker(suite: Suite, one: Entrant, folder: Path, workers: int = 0, scheduler: str = "") -> TrackerResults:
    """Run a tracker on all films into FOLDER/FILM, except where results exist; scheduler: of Dask, for processes."""
    folder.mkdir(parents=True, exist_ok=True)
    for film in dict.fromkeys(part.film for part in suite.parts.values()):
        if only := one.sample.of_film(suite.parts.values(), film):
            source = open_source(suite.film(film))
            wanted = tuple(clip for clip in source.clips if clip[0] in only)
            run(replace(source, clips=wanted), folder / film, one.detector, workers, scheduler=scheduler)
    if not (folder / "pace.json").is_file():  # processor time of detection and linking in the first clip
        clip = _first(suite)
        name = one.detector or choose_detector(clip.frames, clip.camera)[0]
        started = time.process_time()
        track_clip(clip, name)
        spent = 1e3 * (time.process_time() - started) / len(clip.frames)
        write_json(folder / "pace.json", {"ms_per_frame": spent})
    return TrackerResults(partial(read_clip_results, folder), one.sample, one.own)


def describe_tracker_run(one: Entrant, folder: Path) -> Mapping[str, Any]:
    """Describe a tracker that was run here, for its entry."""
    spent = load_json(folder / "pace.json")["ms_per_frame"]
    limits = {"clips_of_each_part": one.sample.clips, "not_run_on": list(one.sample.without)}
    more = {} if one.sample == ALL_CLIPS else limits
    return {"name": one.name, "made": RUN_HERE, "ms_per_frame": spent, "point": one.own} | more


def _first(suite: Suite) -> Recording:
    return open_source(suite.film(suite.definition.films[0].name)).open_clip(0)
