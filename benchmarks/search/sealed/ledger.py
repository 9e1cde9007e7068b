"""Sealed boxes: the hash of a truth is on record before the analysis, and each box is opened once.

A study NAME has these files:

- NAME.ledger.jsonl: first the hash of the secret from which the boxes are drawn. Then a line when a box is sealed (the
  truth's hash), and one when it is answered (the answer's hash).
- NAME.sealed/: the truths with their salt, and the answers.
- NAME.jsonl: the opened boxes.

The line that opens a box is its result. So a run that is killed leaves a box without an answer, with its one answer, or
done.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

Json = dict[str, Any]


class Broken(Exception):
    """The protocol was not kept."""


def digest(value: Json) -> str:
    """SHA-256 of the canonical JSON."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def sealing(secret: str) -> str:
    """SHA-256 of a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()


class Ledger:
    """The files of one study."""

    def __init__(self, folder: Path, name: str) -> None:
        self.record, self.results = folder / f"{name}.ledger.jsonl", folder / f"{name}.jsonl"
        self.sealed = folder / f"{name}.sealed"
        self.sealed.mkdir(parents=True, exist_ok=True)

    def opened(self) -> list[Json]:
        """The boxes opened so far."""
        return list(lines(self.results))

    def commit(self, secret: str) -> None:
        """Put the hash of the secret on record, before any box. Raises Broken when it is another than on record."""
        said, known = sealing(secret), list(lines(self.record))
        if not known:
            append(self.record, {"secret": said})
        elif known[0].get("secret") != said:
            raise Broken(f"{self.record.name}: these boxes were drawn from another secret")

    def seal(self, box: int, truth: Json) -> None:
        """Put the truth of a box on record. A box sealed before, and not opened, stays as it was."""
        if self._hash(box, "truth") is None:
            salted = truth | {"salt": secrets.token_hex(16)}
            _write(self._path(box), salted)
            append(self.record, {"box": box, "truth": digest(salted)})

    def answer(self, box: int, answer: Json) -> None:
        """Put the one answer on record, before the truth is looked at. Raises Broken."""
        if self._hash(box, "truth") is None:
            raise Broken(f"box {box}: answered before it was sealed")
        if self._hash(box, "answer") is not None:
            raise Broken(f"box {box}: answered before")
        _write(self._path(box, ".answer"), answer)
        append(self.record, {"box": box, "answer": digest(answer)})

    def recall_answer(self, box: int) -> Json | None:
        """Return the recorded answer, checked against its hash, for a run that resumes after a kill. Raises Broken."""
        if self._hash(box, "answer") is None:
            return None
        answer: Json = json.loads(self._path(box, ".answer").read_text())
        self._hold(box, answer)
        return answer

    def open(self, box: int, answer: Json, beside: Json) -> Json:
        """Open a box and write its result, `beside` with it; the truth. Raises Broken."""
        if any(row["box"] == box for row in self.opened()):
            raise Broken(f"box {box}: opened before")
        self._hold(box, answer)
        truth = self.truth(box)
        append(self.results, {"box": box, "truth": truth, "answer": answer} | beside)
        return truth

    def truth(self, box: int) -> Json:
        """The sealed truth, for what makes the tracks, held against its hash. Raises Broken."""
        truth: Json = json.loads(self._path(box).read_text())
        if digest(truth) != self._hash(box, "truth"):
            raise Broken(f"box {box}: the truth is not the one that was sealed")
        return truth

    def _hold(self, box: int, answer: Json) -> None:
        if self._hash(box, "answer") != digest(answer):
            raise Broken(f"box {box}: this is not the answer on record")

    def _path(self, box: int, what: str = "") -> Path:
        return self.sealed / f"{box:05d}{what}.json"

    def _hash(self, box: int, what: str) -> str | None:
        """The first hash on record of a box's truth or answer."""
        return next((str(line[what]) for line in lines(self.record) if line.get("box") == box and what in line), None)


def lines(path: Path) -> Iterator[Json]:
    """The whole lines of a file; a last one cut off by a kill is no line."""
    if not path.exists():
        return
    for line in path.read_text().splitlines(keepends=True):
        if line.endswith("\n"):
            yield json.loads(line)


def _write(path: Path, value: Json) -> None:
    """The whole file, or none."""
    beside = path.with_suffix(f".{os.getpid()}.tmp")
    beside.write_text(json.dumps(value, allow_nan=False))
    beside.replace(path)


def append(path: Path, value: Json) -> None:
    """One line, whole or not at all, whoever else writes."""
    with path.open("a+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        size = file.seek(0, os.SEEK_END)
        if size:
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":  # a line cut off by a kill
                text = path.read_bytes()
                file.truncate(text.rfind(b"\n") + 1)
        file.write(json.dumps(value, allow_nan=False).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())
