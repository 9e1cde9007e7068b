"""A suite of two scenes, two clips each, small enough for tests; made once, by the command as any suite is."""

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from tracker.benchmark.judging.defects import simulate_at_bound
from tracker.benchmark.judging.tracker_results import ALL_CLIPS, ClipSample
from tracker.benchmark.suite.definition import covariances, parse_definition
from tracker.benchmark.suite.make import make_suite
from tracker.scoring.score import NO_TRACKS

TINY = """
name: tiny
version: "0.1"
seed: 5
licence: CC0-1.0
films:
  axes:
    clips: 2
    small: {clips: 1}
    scene:
      launch: {v0: 0.25, b: 0.1, heading: {uniform: [0.2, 1.2]}, contact: [0, 0]}
      timing: {frames: 36, contact_frame: 14}
      camera: {size: [200, 160]}
      lamp: {position: [0.2, 0.1, 0.45]}
    scenes:
      bright: {}
      dim: {sensor: {glint_peak: 12}}
axes:
  brightness: {title: Brightness, label: peak, log: true, points: [[12, dim], [200, bright]]}
headline: {bright: bright, dim: dim}
near: bright
phase: [bright]
measured: [bright]
physics: bright
trackers: [synthcam, centroid]
sampled: {}
"""


def tiny(size="full"):
    return parse_definition(TINY, size, "tiny.yaml")


@cache
def suite():
    folder = Path(mkdtemp()) / "suite"
    return make_suite(folder, tiny(), workers=1)


@cache
def simulated(part, clip):
    """A clip of the suite at its bound, which every score of this suite needs; measured once a process."""
    return simulate_at_bound(suite(), next(p for p in suite().parts.values() if p.name == part), clip)


@dataclass
class Given:
    """The results of a tracker whose tracks are the truth, altered by `change`, which takes (table, rng)."""

    suite: object
    change: object = lambda table, rng: table
    sample: ClipSample = ALL_CLIPS
    own: str = "centre"
    rows: list = field(default_factory=list)

    def of(self, film, clip):
        if clip not in {c for part in self.suite.parts.values() if part.film == film for c in part.clips}:
            return NO_TRACKS, []
        truth = self.suite.tracks(film, clip)
        truth = truth[truth["visible"] & np.isfinite(truth["xx"])].reset_index(drop=True)
        table = truth.assign(x=truth["x_mean_px"], y=truth["y_mean_px"], glint_x=np.nan, glint_y=np.nan)
        return self.change(table, np.random.default_rng(clip)), [dict(row) for row in self.rows]


def noisy(table, rng):
    """The noise of the bound, claimed as it is."""
    cov = covariances(table)
    off = np.einsum("nij,nj->ni", np.linalg.cholesky(cov), rng.standard_normal((len(table), 2)))
    errors = {"x_std": np.sqrt(cov[:, 0, 0]), "y_std": np.sqrt(cov[:, 1, 1]), "cov_xy": cov[:, 0, 1]}
    return table.assign(x=table["x"] + off[:, 0], y=table["y"] + off[:, 1], **errors)
