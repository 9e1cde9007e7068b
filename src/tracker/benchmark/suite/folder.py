"""A suite on disk: the films that a tracker gets, and the truth in a separate folder."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker.benchmark.suite.definition import SuiteDefinition, SuitePart, parse_definition
from tracker.camera.camera import Camera
from tracker.results import load_json

SUITE, DEFINITION, TRUTH, FILMS = "suite.json", "suite.yaml", "truth", "films"
BOUNDS, QUANTITY_BOUNDS = "bounds.parquet", "quantity_bounds.parquet"


@dataclass(frozen=True)
class Suite:
    """A suite on disk: `path` holds films/FILM, `truth` holds FILM and may be anywhere."""

    path: Path
    truth: Path
    definition: SuiteDefinition
    about: Mapping[str, Any]

    @property
    def parts(self) -> dict[str, SuitePart]:
        """Parts by name."""
        return self.definition.parts

    def film(self, name: str) -> Path:
        """Return the folder of a film, which a tracker gets."""
        return self.path / FILMS / name

    def camera(self, film: str, clip: int) -> Camera:
        """Read the camera of a clip."""
        return Camera.read(self.film(film) / "clips" / f"{clip:06d}" / "camera.json")

    def scalars(self, film: str) -> pd.DataFrame:
        """Read truth/clips.parquet of a film."""
        return _read(self.truth / film / "truth" / "clips.parquet")

    def tracks(self, film: str, clip: int) -> pd.DataFrame:
        """Read the true tracks of a clip, with the bound of each position as xx, xy, yy (px^2; NaN without a bound)."""
        truth = _read(self.truth / film / "clips" / f"{clip:06d}" / "truth" / "tracks.parquet")
        limits = self.bounds[film]
        own = limits[limits["clip"] == clip].drop(columns="clip")
        return truth.merge(own, on=["frame", "particle"], how="left")

    @cached_property
    def bounds(self) -> dict[str, pd.DataFrame]:
        """The Cramér-Rao bounds of all true positions, by film."""
        return {film.name: _read(self.truth / film.name / BOUNDS) for film in self.definition.films}

    def quantity_bounds(self, film: str) -> pd.DataFrame:
        """Read the bounds of the quantities of the collisions in a film."""
        return _read(self.truth / film / QUANTITY_BOUNDS)

    def has_bounds(self, part: SuitePart) -> bool:
        """Return whether positions of a part have a bound; those of matte balls have none."""
        limits = self.bounds[part.truth]
        return bool(limits.loc[limits["clip"].isin(part.clips), "xx"].notna().any())


def open_suite(path: Path, truth: Path | None = None) -> Suite:
    """Open a suite; truth: its folder, where it is withheld. Raises InputError where `path` is no suite."""
    if not (path / SUITE).is_file():
        raise InputError(f"{path / SUITE}: no such file, expected a suite of `tracker benchmark make`")
    about = load_json(path / SUITE)
    if not isinstance(about, dict) or not {"version", "size", "split", "truth_sha256"} <= set(about):
        raise InputError(f"{path / SUITE}: damaged, expected what `tracker benchmark make` writes")
    definition = parse_definition(
        (path / DEFINITION).read_text(encoding="utf-8"), str(about["size"]), str(path / DEFINITION)
    )
    return Suite(path, truth or path / TRUTH, definition, about)


def check_truth(suite: Suite) -> Suite:
    """Check the truth of a suite by the digest in its card. Raises InputError where it is missing or another one."""
    if not suite.truth.is_dir():
        withheld = suite.about["split"] == "withheld"
        more = "; the truth of this suite is withheld: give its folder with --truth TRUTH" if withheld else ""
        raise InputError(f"{suite.truth}: no such folder, expected the truth of the suite{more}")
    if truth_digest(suite.truth, suite.definition) != suite.about["truth_sha256"]:
        raise InputError(f"{suite.truth}: not the truth of {suite.path}: its SHA-256 differs from that in {SUITE}")
    return suite


def truth_digest(truth: Path, definition: SuiteDefinition) -> str:
    """Compute the digest of the true files in the folder of a suite, without bounds, which follow from them."""
    mark = hashlib.sha256()
    for film in sorted(one.name for one in definition.films):
        for path in sorted(p for p in (truth / film).rglob("*") if p.is_file()):
            if path.name not in (BOUNDS, QUANTITY_BOUNDS):
                mark.update(f"{path.relative_to(truth).as_posix()}\n".encode())
                mark.update(hashlib.sha256(path.read_bytes()).digest())
    return mark.hexdigest()


def covariances(truth: pd.DataFrame) -> NDArray[np.float64]:
    """Turn the bounds in the folder of a suite into covariances (n, 2, 2), px^2."""
    xx, xy, yy = (truth[name].to_numpy(np.float64) for name in ("xx", "xy", "yy"))
    return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)


def _read(path: Path) -> pd.DataFrame:
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a part of the suite's truth")
    return pd.read_parquet(path)
