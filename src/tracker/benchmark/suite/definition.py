"""A suite: its definition in YAML, with films, scenes and axes; and on disk, with the truth in a separate folder."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.results import load_json

SUITE, DEFINITION, TRUTH, FILMS = "suite.json", "suite.yaml", "truth", "films"
DIGEST_WITHOUT_CROWDS = "truth_sha256_without_crowds"  # in suite.json
BOUNDS, QUANTITY_BOUNDS = "bounds.parquet", "quantity_bounds.parquet"
KEYS = "name version seed licence films axes headline near phase measured physics trackers sampled".split()
CROWDS = "crowds"  # a key that definitions before version 1.1 do not have


@dataclass(frozen=True)
class SuiteFilm:
    """A dataset with `clips` clips of each scene, and its encoded copies."""

    name: str
    clips: int
    scenes: Mapping[str, Mapping[str, Any]]
    encoded: Mapping[str, str]


@dataclass(frozen=True)
class SuitePart:
    """Clips of one scene in one film, which are scored together; truth: the film that holds their truth."""

    name: str
    film: str
    truth: str
    clips: tuple[int, ...]


@dataclass(frozen=True)
class SuiteDefinition:
    """A suite in one of its sizes; `text` is the content of the file."""

    text: str
    size: str
    data: Mapping[str, Any]
    films: tuple[SuiteFilm, ...]

    @property
    def version(self) -> str:
        """Version of the suite; that of a smaller size ends in its name."""
        return str(self.data["version"]) + ("" if self.size == "full" else f"-{self.size}")

    @property
    def digest(self) -> str:
        """SHA-256 of the text: suites with the same digest, size and seed have the same films."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def parts(self) -> dict[str, SuitePart]:
        """Parts by name, in the order of the file."""
        found = {}
        for film in self.films:
            for k, scene in enumerate(film.scenes):
                clips = tuple(range(k * film.clips, (k + 1) * film.clips))
                found[scene] = SuitePart(scene, film.name, film.name, clips)
            for name in film.encoded:
                found[name] = SuitePart(name, name, film.name, tuple(range(len(film.scenes) * film.clips)))
        return found

    def axes(self) -> Iterator[tuple[str, Mapping[str, Any], list[tuple[Any, str]]]]:
        """Yield name, settings and points (value, part) of each axis with two or more parts in this size."""
        known = self.parts
        for name, axis in self.data["axes"].items():
            points = [(value, part) for value, part in axis["points"] if part in known]
            if len(points) > 1:
                yield name, axis, points

    @property
    def headline(self) -> dict[str, str]:
        """Parts of the first figure, with their labels."""
        return {part: str(word) for part, word in self.data["headline"].items() if part in self.parts}

    @property
    def crowds(self) -> list[str]:
        """Parts with more than two balls, which are judged apart from the others."""
        named = self.data.get(CROWDS, {}).get("parts", {})
        return [part for part in named if part in self.parts]

    def crowd_axes(self) -> Iterator[tuple[Mapping[str, Any], list[tuple[float, str]]]]:
        """Yield settings and points (value, part) of each axis of crowds that has a part in this size."""
        known = self.crowds
        for axis in self.data.get(CROWDS, {}).get("axes", {}).values():
            if points := [(float(value), part) for value, part in axis["points"] if part in known]:
                yield axis, points

    def parts_of(self, key: str) -> list[str]:
        """Return the parts that a key names and that this size has."""
        named = self.data[key]
        return [part for part in ([named] if isinstance(named, str) else named) if part in self.parts]


def read_definition(path: Path | None = None, size: str = "full") -> SuiteDefinition:
    """Read the definition of a file, or the one of this package. Raises InputError."""
    path = path or Path(__file__).with_name("suite.yaml")
    sizes = ("full", "small")
    if size not in sizes:
        raise InputError(f"--size: expected one of {', '.join(sizes)}, not {size!r}")
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected the definition of a suite (YAML)")
    return parse_definition(path.read_text(encoding="utf-8"), size, str(path))


def parse_definition(text: str, size: str, where: str) -> SuiteDefinition:
    """Parse the YAML of a definition. Raises InputError."""
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(f"{where}: damaged, expected YAML ({' '.join(str(error).split())[:120]})") from None
    _check(data, KEYS, where, "a suite", extra=[*KEYS, CROWDS])
    crowds = data.get(CROWDS, {"axes": {}, "parts": {}})
    _check(crowds, ["axes", "parts"], f"{where}: {CROWDS}", "crowds")
    films = tuple(film for name, given in data["films"].items() if (film := _film(name, given, size, where)).clips)
    names = [scene for film in films for scene in (*film.scenes, *film.encoded)]
    if len(set(names)) < len(names):
        raise InputError(f"{where}: films: a scene's name occurs twice, expected once")
    made = SuiteDefinition(text, size, data, films)
    known = {scene for given in data["films"].values() for scene in (*given["scenes"], *given.get("encoded", {}))}
    named = [part for axis in data["axes"].values() for _, part in axis["points"]]
    named += [*data["headline"], *data["phase"], *data["measured"], data["near"], data["physics"]]
    named += [*crowds["parts"], *(part for axis in crowds["axes"].values() for _, part in axis["points"])]
    if unknown := sorted(set(named) - known):
        raise InputError(f"{where}: {', '.join(unknown)}: no such scene, expected one of {', '.join(sorted(known))}")
    return made


def _film(name: str, given: Any, size: str, where: str) -> SuiteFilm:
    known = "clips small scene scenes encoded small_encoded".split()
    _check(given, known[:1], f"{where}: films.{name}", "a film", extra=known)
    less = given.get("small", {}) if size == "small" else {}
    chosen = less.get("scenes", list(given["scenes"]))
    scenes = {scene: merge_settings(given.get("scene", {}), given["scenes"][scene]) for scene in chosen}
    coded = dict(given.get("encoded", {}))
    if size == "small":
        coded = {one: coded[one] for one in given.get("small_encoded", [])}
    return SuiteFilm(name, int(less.get("clips", given["clips"])), scenes, coded)


def _check(data: Any, keys: list[str], where: str, what: str, extra: list[str] | None = None) -> None:
    if not isinstance(data, Mapping):
        raise InputError(f"{where}: expected {what}: {', '.join(keys)}")
    if missing := [key for key in keys if key not in data]:
        raise InputError(f"{where}: {missing[0]} is missing, expected {what}: {', '.join(keys)}")
    if unknown := [key for key in data if key not in (extra or keys)]:
        raise InputError(f"{where}: {unknown[0]}: unknown, expected {', '.join(extra or keys)}")


def merge_settings(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Merge the definition of a suite with settings, one section at a time; those of `other` win."""
    out = dict(one)
    for key, value in other.items():
        section = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = {**out[key], **value} if section else value
    return out


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

    def events(self, film: str, clip: int) -> pd.DataFrame:
        """Read the true events of a clip."""
        return _read(self.truth / film / "clips" / f"{clip:06d}" / "truth" / "events.parquet")

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


def truth_digest(truth: Path, definition: SuiteDefinition, without: Collection[str] = ()) -> str:
    """Compute the digest of the true files in the folder of a suite, without bounds, which follow from them.

    without: films that are left out.
    """
    mark = hashlib.sha256()
    for film in sorted({one.name for one in definition.films} - set(without)):
        for path in sorted(p for p in (truth / film).rglob("*") if p.is_file()):
            if path.name not in (BOUNDS, QUANTITY_BOUNDS):
                mark.update(f"{path.relative_to(truth).as_posix()}\n".encode())
                mark.update(hashlib.sha256(path.read_bytes()).digest())
    return mark.hexdigest()


def covariances(truth: pd.DataFrame) -> Array:
    """Turn the bounds in the folder of a suite into covariances (n, 2, 2), px^2."""
    xx, xy, yy = (truth[name].to_numpy(np.float64) for name in ("xx", "xy", "yy"))
    return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)


def _read(path: Path) -> pd.DataFrame:
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a part of the suite's truth")
    return pd.read_parquet(path)
