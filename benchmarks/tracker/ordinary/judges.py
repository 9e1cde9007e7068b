"""Judges of outcomes: values beside the truth, refusals in one line, notes, found balls, printed values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.tracker.ordinary.case import Judge, Outcome, Verdict

ERRORS = 3.0  # a value is right within so many of its standard errors
NEAR_PX = 1.0  # a ball is found where a position is so near its true centre


def list_missing(words: tuple[str, ...], text: str) -> list[str]:
    """Those of the words that the text lacks, in any case of letters."""
    return [word for word in words if word.lower() not in text.lower()]


def describe_end(outcome: Outcome) -> str:
    """The exit status and the last line that was printed."""
    status = "no end in time" if outcome.status is None else f"status {outcome.status}"
    return f"{status}: {outcome.last_line[:200]}" if outcome.last_line else status


@dataclass(frozen=True)
class Measured:
    """The first collision of the folder `new` has one of the statuses, and values within 3 errors of the truth.

    truth: by the name of a column of estimates.parquet. says: words that the command must print. or_no_error: columns
    that have no error, or are right within 3 errors.
    """

    truth: Mapping[str, float]
    status: tuple[str, ...] = ("ok",)
    says: tuple[str, ...] = ()
    or_no_error: Mapping[str, float] = field(default_factory=dict)
    off: float = 0.0  # by which a rounded truth may be off

    @property
    def right(self) -> str:
        values = ", ".join(f"{name} {value:.4g}" for name, value in {**self.truth, **self.or_no_error}.items())
        return "; ".join(filter(None, [" or ".join(self.status), values, *map(repr, self.says)]))

    def __call__(self, outcome: Outcome) -> Verdict:
        path = outcome.folder / "new" / "estimates.parquet"
        if outcome.status != 0 or not path.is_file():
            return Verdict(describe_end(outcome), False)
        rows = pd.read_parquet(path)
        if rows.empty:
            return Verdict(f"no collision: {outcome.last_line}", False)
        row: dict[str, Any] = {str(name): value for name, value in rows.iloc[0].items()}
        parts, fine = [str(row["status"])], row["status"] in self.status
        for name, true in {**self.truth, **self.or_no_error}.items():
            value, error = read_number(row.get(name)), read_number(row.get(f"{name}_std"))
            parts.append(f"{name} {value:.4g} +- {error:.1g}" if np.isfinite(error) else f"{name} {value:.4g}")
            near = abs(value - true) <= ERRORS * error + self.off
            fine = fine and bool(near or (name in self.or_no_error and not np.isfinite(error)))
        missing = list_missing(self.says, outcome.said)
        parts += [f"without {word!r}" for word in missing] or [f"{word!r}" for word in self.says]
        return Verdict(", ".join(parts), fine and not missing)


@dataclass(frozen=True)
class Either:
    """One of two judges is content."""

    first: Judge
    second: Judge

    @property
    def right(self) -> str:
        return f"{self.first.right}; or {self.second.right}"

    def __call__(self, outcome: Outcome) -> Verdict:
        verdict = self.first(outcome)
        return verdict if verdict.right else self.second(outcome)


def read_number(value: object) -> float:
    """A cell as a float; NaN for none."""
    return float("nan") if value is None else float(value)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Refused:
    """Exit status 2 and one line with these words, or with one of several sets of them; nothing is written."""

    says: tuple[str, ...]
    status: int = 2

    @property
    def right(self) -> str:
        return f"status {self.status}, one line: {', '.join(map(repr, self.says))}"

    def __call__(self, outcome: Outcome) -> Verdict:
        lines = outcome.err.strip().count("\n") + bool(outcome.err.strip())
        missing = list_missing(self.says, outcome.err)
        written = (outcome.folder / "new").exists()
        fine = outcome.status == self.status and lines == 1 and not missing and not written
        got = describe_end(outcome) + (f" ({lines} lines)" if lines > 1 else "") + (" (new written)" if written else "")
        return Verdict(got, fine)


@dataclass(frozen=True)
class Said:
    """Exit status 0 (or another) and these words, wherever they are printed; `not_said` must not be."""

    says: tuple[str, ...]
    status: int = 0
    not_said: tuple[str, ...] = ("Traceback",)
    files: tuple[str, ...] = ()

    @property
    def right(self) -> str:
        return f"status {self.status}: {', '.join([*map(repr, self.says), *self.files])}"

    def __call__(self, outcome: Outcome) -> Verdict:
        missing = list_missing(self.says, outcome.said)
        wrong = [word for word in self.not_said if word in outcome.said]
        absent = [name for name in self.files if not any(outcome.folder.glob(name))]
        fine = outcome.status == self.status and not missing and not wrong and not absent
        if fine:
            return Verdict("; ".join(find_sentence(word, outcome.said) for word in self.says) or "status 0", True)
        lacks = "".join(f"; without {word!r}" for word in [*missing, *absent])
        return Verdict(describe_end(outcome) + lacks, False)


def find_sentence(word: str, text: str, most: int = 140) -> str:
    """The part of a text around a word."""
    at = text.lower().find(word.lower())
    begin = max(text.rfind(". ", 0, at), text.rfind("tracker: ", 0, at), text.rfind("synthcam: ", 0, at), 0)
    return text[max(begin, at - most // 2) : at + most].lstrip(". ")


@dataclass(frozen=True)
class Found:
    """The balls of a film in folder `new`: how many true positions were found, and how many found ones are none.

    places: true centres (balls, frames, 2), px. share: of the true positions to be found at least. false: at most.
    """

    places: Any
    says: tuple[str, ...] = ()
    share: float = 1.0
    false: int = 0
    near_px: float = NEAR_PX
    first: int = 0  # number of the first frame

    @property
    def right(self) -> str:
        count = self.places.shape[0] * self.places.shape[1]
        least = "all" if self.share == 1 else f"{self.share:.0%} at least of"
        return "; ".join([f"{least} {count} found, {self.false} false at most", *map(repr, self.says)])

    def __call__(self, outcome: Outcome) -> Verdict:
        path = outcome.folder / "new/clips/000000/tracks.parquet"
        if outcome.status != 0 or not path.is_file():
            return Verdict(describe_end(outcome), False)
        table = pd.read_parquet(path)
        found = false = 0
        for frame in range(self.places.shape[1]):
            seen = table.loc[table["frame"] == self.first + frame, ["x", "y"]].to_numpy(float)
            apart = np.hypot(*np.moveaxis(self.places[:, frame, None] - seen[None], -1, 0))
            found += int((apart < self.near_px).any(axis=1).sum())
            false += int((~(apart < self.near_px).any(axis=0)).sum())
        missing = list_missing(self.says, outcome.said)
        count = self.places.shape[0] * self.places.shape[1]
        got = f"{found} of {count} found, {false} false" + "".join(f", without {word!r}" for word in missing)
        return Verdict(got, found >= self.share * count and false <= self.false and not missing)


@dataclass(frozen=True)
class Scored:
    """Figures of the only tracker in `new/score.json`, by their name."""

    figures: Mapping[str, float]
    says: tuple[str, ...] = ()

    @property
    def right(self) -> str:
        return ", ".join([*(f"{name} {value:g}" for name, value in self.figures.items()), *map(repr, self.says)])

    def __call__(self, outcome: Outcome) -> Verdict:
        path = outcome.folder / "new/score.json"
        if outcome.status != 0 or not path.is_file():
            return Verdict(describe_end(outcome), False)
        (score,) = json.loads(path.read_text())["detectors"].values()
        every = {**score["localisation"], **score["tracking"]}
        got = {name: every[name] for name in self.figures}
        missing = list_missing(self.says, outcome.said)
        text = ", ".join(f"{name} {value:g}" for name, value in got.items()) + "".join(
            f", without {w!r}" for w in missing
        )
        return Verdict(text, got == dict(self.figures) and not missing)


@dataclass(frozen=True)
class Printed:
    """A script of Python prints one line of JSON, in which these values stand; near: how far numbers may be off."""

    values: Mapping[str, Any]
    near: float = 0.0

    @property
    def right(self) -> str:
        return ", ".join(f"{name} {value}" for name, value in self.values.items())

    def __call__(self, outcome: Outcome) -> Verdict:
        try:
            got = json.loads(outcome.out.strip().splitlines()[-1])
        except (IndexError, json.JSONDecodeError):
            return Verdict(describe_end(outcome), False)
        fine = outcome.status == 0 and all(self._is_near(got.get(name), value) for name, value in self.values.items())
        return Verdict(", ".join(f"{name} {got.get(name)}" for name in self.values), fine)

    def _is_near(self, got: Any, value: Any) -> bool:
        if isinstance(value, str):
            return isinstance(got, str) and value.lower() in got.lower()
        if isinstance(value, float):
            return isinstance(got, int | float) and abs(got - value) <= self.near
        return bool(got == value)


@dataclass(frozen=True)
class Unchanged:
    """A refusal as `Refused`, after which files of the user are what they were."""

    says: tuple[str, ...]
    files: Mapping[str, bytes]

    @property
    def right(self) -> str:
        return f"{Refused(self.says).right}; {', '.join(self.files)} unchanged"

    def __call__(self, outcome: Outcome) -> Verdict:
        verdict = Refused(self.says)(outcome)
        lost = [name for name, data in self.files.items() if read_bytes(outcome.folder / name) != data]
        return Verdict(verdict.got + "".join(f"; {name} is overwritten" for name in lost), verdict.right and not lost)


def read_bytes(path: Path) -> bytes:
    """The bytes of a file; none for one that is gone."""
    return path.read_bytes() if path.is_file() else b""
