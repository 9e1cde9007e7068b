"""What the page asks of synthcam: pictures of scenes whose numbers are moved, and the example films."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from synthcam_shared.errors import InputError

SCENES = ("oblique", "head_on", "tray")  # of the package, for the example films; each is drawn in seconds


class ScenePreviews:
    """One process, `synthcam serve`, that draws scenes, started at the first request; any thread may `ask`.

    patience_s: for one picture. Then the process ends, so that the page does not wait for ever.
    """

    def __init__(
        self, program: Sequence[str] = (sys.executable, "-m", "synthcam", "serve"), patience_s: float = 60.0
    ) -> None:
        self._program, self._patience_s = program, patience_s
        self._child: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()
        self._closed = False

    def ask(self, request: Any) -> dict[str, Any]:
        """The answer to one request. Raises InputError where there is none, or it says why there is no picture."""
        with self._lock:
            if self._closed:
                raise InputError("make: closed")
            if self._child is None:
                self._messages = tempfile.TemporaryFile("w+")  # noqa: SIM115  # a pipe that nobody empties would stop it
                pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self._messages}
                self._child = subprocess.Popen(self._program, **pipes, text=True, start_new_session=True)
            line = self._exchange(json.dumps(request))
            if not line:
                raise InputError(self._end())
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise InputError(answer["error"])
        return answer

    def _exchange(self, line: str) -> str:
        """The child's answer to a line; "" where it has ended."""
        assert self._child is not None
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        watch = threading.Timer(self._patience_s, self._child.kill)
        watch.start()
        try:
            self._child.stdin.write(f"{line}\n")
            self._child.stdin.flush()
            return self._child.stdout.readline()
        except OSError:
            return ""
        finally:
            watch.cancel()

    def _end(self) -> str:
        """Wait for the child's end, and explain it."""
        assert self._child is not None
        killed, last = False, "no message"
        with self._messages, suppress(BrokenPipeError):
            self._child.communicate()
            killed = self._child.returncode < 0 and not self._closed
            self._messages.seek(0)
            last = (self._messages.read().strip().splitlines() or ["no message"])[-1]
        self._child = None
        if "No module named" in last:
            return "make: synthcam, which draws scenes, is not installed here; type: pip install synthcam"
        if killed:
            return f"make: synthcam serve was ended, after {self._patience_s:g} s for one picture or from outside"
        return f"make: synthcam serve has ended ({last})"

    def close(self) -> None:
        """End the process, also while it answers a request."""
        self._closed = True
        if (child := self._child) is not None:
            child.kill()
        with self._lock:
            if self._child is not None:
                self._end()


def make_examples() -> Path:
    """The dataset of films for a user who has none, made once, into the user's cache. Raises InputError."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "synthcam" / "examples"
    if not folder.exists():
        print(f"tracker: making the example films in {folder}, once, in some seconds", file=sys.stderr, flush=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        options = ["--set", "camera.size=[480,360]", "--compression", "zstd", "--seed", "3"]
        words = [sys.executable, "-m", "synthcam", "generate", *SCENES, "-o", f"{folder}", *options]
        made = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
        if made.returncode:
            last = (made.stderr.strip().splitlines() or ["no message"])[-1]
            raise InputError(f"{folder}: the example films could not be made ({last}); name a film of your own")
    return folder
