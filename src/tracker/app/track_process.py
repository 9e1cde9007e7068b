"""Runs a command of the package as a child process: its progress, its end, and how it is cancelled."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import IO, Any, Literal

from synthcam_shared.application import PROGRESS_INTERVAL
from synthcam_shared.errors import InputError

State = Literal["idle", "running", "done", "failed", "cancelled"]
PROGRESS = re.compile(r"(\w+): (\d+) of (\d+) after \d+ s(?:, about (\d+) s left)?")
PROGRAM = re.compile(r"^(tracker|discrepancy|synthcam): ")


@dataclass(frozen=True)
class RunStatus:
    """A run of a command as the page shows it. summary: what the command prints with --json; lines: its messages.

    done, total, left_s: the progress that it last wrote, and the time that it estimates. began: by the monotonic clock.
    """

    command: str = ""
    number: int = 0
    state: State = "idle"
    what: str = ""
    done: int = 0
    total: int = 0
    left_s: int | None = None
    began: float = 0.0
    lines: tuple[str, ...] = ()
    error: str = ""
    summary: dict[str, Any] = field(default_factory=dict)


class TrackProcess:
    """One child process at a time. Its callbacks come from another thread.

    changed: called when the status changes. take: called with the status of a run that has ended, before it is shown,
    to take what the run made. If it fails, the run fails.
    """

    def __init__(
        self,
        changed: Callable[[], None] = lambda: None,
        program: Sequence[str] = (),
        take: Callable[[RunStatus], None] = lambda status: None,
    ) -> None:
        self.status = RunStatus()
        self._changed, self._program, self._take = changed, program, take
        self._child: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        self._cancelled = False

    @property
    def seconds(self) -> float:
        """Time since the run has begun, s."""
        return time.monotonic() - self.status.began

    @property
    def is_running(self) -> bool:
        """True until the child has ended, its output is read, and what it made is taken."""
        return self.status.state == "running"

    def start(self, number: int, words: list[str]) -> None:
        """Start a command of the package as a process group of its own."""
        assert not self.is_running
        self._cancelled = False
        printed = tempfile.TemporaryFile("w+")  # noqa: SIM115  # a pipe that nobody empties would stop the child
        self._child = subprocess.Popen(
            [*(self._program or (sys.executable, "-m", words[0])), *words[1:], "--json"],
            stdin=subprocess.DEVNULL,
            stdout=printed,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env={**os.environ, PROGRESS_INTERVAL: "0.2"},
            start_new_session=True,
        )
        self._set(RunStatus(command=words[1], number=number, state="running", began=time.monotonic()))
        self._reader = threading.Thread(target=self._read, args=(self._child, printed), daemon=True)
        self._reader.start()

    def cancel(self, patience_s: float = 10.0) -> None:
        """Interrupt the child as Ctrl-C does, and kill it if that does not end it."""
        child = self._child
        if child is None or not self.is_running:
            return
        self._cancelled = True
        self._signal(child, signal.SIGINT)
        threading.Timer(patience_s, self._signal, (child, signal.SIGKILL)).start()

    def close(self) -> None:
        """Cancel, and wait until the child has ended."""
        self.cancel(3.0)
        if self._reader is not None:
            self._reader.join()

    @staticmethod
    def _signal(child: subprocess.Popen[str], number: int) -> None:
        if child.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(child.pid, number)

    def _set(self, status: RunStatus) -> None:
        self.status = status
        self._changed()

    def _read(self, child: subprocess.Popen[str], printed: IO[str]) -> None:
        assert child.stderr is not None
        max_lines = 200  # of the child's messages that are kept
        with printed, child.stderr:
            for line in child.stderr:
                if match := PROGRESS.match(line):
                    what, done, total = match[1], int(match[2]), int(match[3])
                    left = int(match[4]) if match[4] else None
                    self._set(replace(self.status, what=what, done=done, total=total, left_s=left))
                else:
                    text = PROGRAM.sub("", line.strip())
                    lines = (*self.status.lines, text)[-max_lines:]
                    self._set(replace(self.status, lines=lines))
            code = child.wait()
            printed.seek(0)
            summary: Any = None
            with suppress(ValueError):  # it printed anything else than JSON, as after a plug-in that prints
                summary = json.loads(printed.read())
        if code == 0 and summary is not None:
            self._finish(replace(self.status, state="done", summary=summary))
        elif self._cancelled:
            self._finish(replace(self.status, state="cancelled"))
        else:
            last = self.status.lines[-1] if self.status.lines else f"tracker {self.status.command}"
            ended = f" (ended by signal {-code})" if code < 0 else f" (exit status {code})"
            says_all = code == 2  # an error of the input
            self._finish(replace(self.status, state="failed", error=last + ended * (not says_all)))

    def _finish(self, status: RunStatus) -> None:
        """Show that the run has ended, when what it made is taken."""
        try:
            self._take(status)
        except Exception as error:  # a run that never ends would block all others
            said = f"{error}" if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
            status = replace(status, state="failed", error=said)
        self._set(status)
