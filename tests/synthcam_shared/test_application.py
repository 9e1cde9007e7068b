"""The end of a command: its exit status, and its one line of output."""

import errno
import os
import subprocess
import sys

import pytest

from synthcam_shared import application
from synthcam_shared.application import make_command_line, print_progress, run
from synthcam_shared.errors import InputError

app = make_command_line("tool", "Does nothing.")


@app.command()
def keep() -> None:
    raise KeyboardInterrupt


@app.command()
def drop() -> None:
    raise KeyboardInterrupt


@app.command()
def refuse() -> None:
    raise InputError("film.mp4: no such file")


@app.command()
def show() -> None:
    raise BrokenPipeError(errno.EPIPE, "Broken pipe")


@pytest.mark.parametrize(
    ("command", "status", "line"),
    [
        ("keep", 130, "tool: interrupted; the same command continues where it stopped"),
        ("drop", 130, "tool: interrupted; nothing was written"),
        ("refuse", 2, "tool: film.mp4: no such file"),
    ],
)
def test_a_command_that_fails_leaves_one_line(command, status, line, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["tool", command])
    with pytest.raises(SystemExit) as ended:
        run(app, "tool", (InputError,), ("keep",))
    assert ended.value.code == status
    assert capsys.readouterr().err == f"{line}\n"


def test_a_closed_pipe_is_no_error(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["tool", "show"])
    monkeypatch.setattr(sys, "stdout", sys.stdout)  # typer replaces it
    monkeypatch.setattr(sys, "stderr", sys.stderr)
    with pytest.raises(SystemExit) as ended:
        run(app, "tool", (InputError,))
    assert ended.value.code == 1
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("package", "given"), [("synthcam", None), ("tracker", None), ("discrepancy", None), ("tracker", "3")]
)
def test_a_command_computes_on_one_thread_unless_told_otherwise(package, given):
    asked = f"import {package}.cli, os, sys; print(os.environ['OPENBLAS_NUM_THREADS'])"
    early = "import synthcam_shared.application, sys; assert 'numpy' not in sys.modules; "
    others = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    own = others | ({"OPENBLAS_NUM_THREADS": given} if given else {})
    done = subprocess.run([sys.executable, "-c", early + asked], env=own, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == (given or "1")


def test_the_time_left_counts_from_the_first_step(monkeypatch, capsys):
    """A survey of 100 s before the first frame says nothing of the frames: these take 2 s each."""
    now = iter([0.0, 100.0, 140.0])
    monkeypatch.setattr(application.time, "monotonic", lambda: next(now))
    progress = print_progress("frames")
    progress(1, 101)
    progress(21, 101)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["frames: 1 of 101 after 100 s", "frames: 21 of 101 after 140 s, about 160 s left"]
