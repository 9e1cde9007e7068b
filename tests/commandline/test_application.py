"""How a command ends: its exit status, and the one line that it leaves."""

import sys

import pytest

from commandline.application import command_line, run
from commandline.errors import InputError

app = command_line("tool", "Does nothing.")


@app.command()
def keep() -> None:
    raise KeyboardInterrupt


@app.command()
def drop() -> None:
    raise KeyboardInterrupt


@app.command()
def refuse() -> None:
    raise InputError("film.mp4: no such file")


@pytest.mark.parametrize(
    ("command", "status", "line"),
    [
        ("keep", 130, "tool: interrupted; the same command goes on where it stopped"),
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
