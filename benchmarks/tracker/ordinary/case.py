"""A case: one input of a kind, the command that reads it, and what the command should give."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

from benchmarks.harness import ONE_THREAD

LIMIT_S = 60.0  # of processor time, after which a command has no end
CLOCKS = 6.0  # seconds by the clock for one of processor time, on a busy machine
Words = Sequence[str | os.PathLike[str]]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The end of a command: its exit status, what it printed, and the folder in which it ran.

    The status is None for a command that was ended because it took too long.
    """

    status: int | None
    out: str
    err: str
    folder: Path
    seconds: float = 0.0  # of processor time

    @property
    def said(self) -> str:
        """All that it printed, in one line without double blanks."""
        return " ".join(f"{self.err} {self.out}".split())

    @property
    def last_line(self) -> str:
        """The last line of its messages, or else of its output."""
        return ((self.err.strip() or self.out.strip()).splitlines() or [""])[-1]


@dataclass(frozen=True)
class Verdict:
    """A few words about the outcome, and whether it is right."""

    got: str
    right: bool


class Judge(Protocol):
    """Compares an outcome with what is right."""

    @property
    def right(self) -> str:
        """The right value or message, in a few words."""

    def __call__(self, outcome: Outcome) -> Verdict: ...


@dataclass(frozen=True)
class Program:
    """The sources whose commands are run: those of a checkout of this project."""

    root: Path

    @cached_property
    def environment(self) -> dict[str, str]:
        """Environment variables of its commands."""
        paths = [str(self.root / "src"), *filter(None, [os.environ.get("PYTHONPATH")])]
        own = {"PYTHONPATH": os.pathsep.join(paths), "PYTHONDONTWRITEBYTECODE": "", "COLUMNS": "200"}
        return os.environ | ONE_THREAD | own

    def start(self, words: Words, folder: Path, **streams: object) -> subprocess.Popen[bytes]:
        """Start a command of the project, or `python -c SCRIPT`, in a folder and a process group of its own."""
        name, *rest = [os.fspath(word) for word in words]
        line = [sys.executable, *(() if name == "python" else ("-m", name)), *rest]
        return subprocess.Popen(  # type: ignore[call-overload, no-any-return]
            line, cwd=folder, env=self.environment, start_new_session=True, **streams
        )


Runner = Callable[[Program, Path, Words], Outcome]


def run_to_the_end(program: Program, folder: Path, words: Words) -> Outcome:
    """Run a command, and end it with all its processes if it takes more than LIMIT_S of processor time."""
    used, begun = read_processor_time(), time.monotonic()
    with (folder / "stdout").open("w+b") as out, (folder / "stderr").open("w+b") as err:
        process = program.start(words, folder, stdin=subprocess.DEVNULL, stdout=out, stderr=err)
        try:
            while process.poll() is None:
                if read_time_of(process.pid) > LIMIT_S or time.monotonic() - begun > CLOCKS * LIMIT_S:
                    break
                time.sleep(0.02)
        finally:
            ended = process.poll() is not None
            end_group(process)
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read().decode(errors="replace"))
    for name in ("stdout", "stderr"):
        (folder / name).unlink()
    return Outcome(
        status=process.returncode if ended else None,
        out=texts[0],
        err=texts[1],
        folder=folder,
        seconds=read_processor_time() - used,
    )


def end_group(process: subprocess.Popen[bytes]) -> None:
    """End a process that `Program.start` started, and those that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def read_processor_time() -> float:
    """Seconds of processor time of all processes that this one started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def read_time_of(pid: int) -> float:
    """Seconds of processor time that a running process has used; NaN where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Case:
    """An input of one kind, the command that reads it, and the judge of what came out.

    `make` writes the input into an empty folder and returns the words of the command, which runs there. needs: a Python
    package without which the input cannot be made.
    """

    topic: str
    kind: str
    make: Callable[[Path], Words]
    judge: Judge
    run: Runner = run_to_the_end
    needs: str = ""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A line of the table."""

    topic: str
    kind: str
    command: str
    got: str
    right: str
    verdict: str  # "right", "NOT RIGHT" or "not made"
    seconds: float  # of processor time


def judge_case(case: Case, program: Program, folder: Path) -> Row:
    """Make the input of a case in a folder, run its command there, and compare. A fault of the case itself is a row."""
    command, seconds = "", 0.0
    try:
        words = case.make(folder)
        command = describe_command(words)
        outcome = case.run(program, folder, words)
        seconds, verdict = outcome.seconds, case.judge(outcome)
    except ImportError as fault:
        needed = bool(case.needs) and case.needs in str(fault)
        verdict = Verdict(f"needs {case.needs}" if needed else f"the case failed: {fault}", False)
        answer = "not made" if needed else "NOT RIGHT"
    except Exception as fault:
        verdict, answer = Verdict(f"the case failed: {type(fault).__name__}: {fault}", False), "NOT RIGHT"
    else:
        answer = "right" if verdict.right else "NOT RIGHT"
    return Row(topic=case.topic, kind=case.kind, command=command, got=clean(verdict.got), right=clean(case.judge.right),
               verdict=answer, seconds=round(seconds, 2))  # fmt: skip


def describe_command(words: Words) -> str:
    """A command in one line; a script is its first line, a long word its beginning."""
    texts = [clean(os.fspath(word)) for word in words]
    return " ".join(text if len(text) <= 60 else f"{text[:57]}..." for text in texts)


def clean(text: str) -> str:
    """A text in one line, which any file can hold."""
    return " ".join(text.split()).encode("utf-8", "backslashreplace").decode()
