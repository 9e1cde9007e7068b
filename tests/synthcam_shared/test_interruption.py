"""Ctrl-C: 130 and one line, also where a library loses it."""

import os
import signal
import subprocess
import sys
import threading
import time
import tomllib

import pytest
from repository import ROOT

from synthcam.dataset import generate
from synthcam_shared import jobs
from synthcam_shared.application import make_command_line, print_progress, run
from synthcam_shared.errors import InputError
from synthcam_shared.interruption import hold_ctrl_c, raise_if_interrupted, watch_ctrl_c
from synthcam_shared.jobs import run_jobs

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends signals")


def lose_ctrl_c(number=0):
    """Press Ctrl-C and swallow it, as a callback of a C library does."""
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)
    except KeyboardInterrupt:
        return number
    raise AssertionError("not heard")


def turn_ctrl_c_into_an_error(number=0):
    """Press Ctrl-C, and raise an error in its place, as ctypes does in a conversion."""
    try:
        lose_ctrl_c()
        raise KeyboardInterrupt
    except KeyboardInterrupt:
        raise InputError("argument 1: KeyboardInterrupt") from None


class Dying:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)


def die_with_it():
    """Press Ctrl-C in a finaliser, whose exceptions Python prints and drops."""
    thing = Dying()
    del thing
    print_progress("clips")(1, 2)


WAYS = {
    "in a job": lambda: list(run_jobs(lose_ctrl_c, range(5), 1)),
    "in a trial job": lambda: list(run_jobs(lose_ctrl_c, range(5))),
    "before progress": lambda: print_progress("clips")(lose_ctrl_c(1), 2),
    "as an error": turn_ctrl_c_into_an_error,
    "in a finaliser": die_with_it,
}


@pytest.mark.parametrize("way", WAYS)
def test_a_lost_ctrl_c_still_ends_the_command(way, monkeypatch, capsys):
    app = make_command_line("tool", "Does nothing.")
    app.command("work")(WAYS[way])
    app.command("other")(lambda: None)
    monkeypatch.setattr(sys, "argv", ["tool", "work"])
    with pytest.raises(SystemExit) as ended:
        run(app, "tool", (InputError,))
    assert ended.value.code == 130
    assert capsys.readouterr().err == "tool: interrupted; nothing was written\n"


def test_a_clip_that_ctrl_c_broke_is_not_reported_as_impossible(tmp_path, monkeypatch):
    monkeypatch.setattr(generate.GenerationPlan, "clip", lambda plan, number: turn_ctrl_c_into_an_error())
    plan = generate.GenerationPlan((), 1, 0)
    with watch_ctrl_c(), pytest.raises(KeyboardInterrupt):
        generate.make_clip(plan, 0, tmp_path)
    assert not list((tmp_path / "clips").glob("*"))


def test_held_back_it_comes_at_the_end_whatever_thread_hears_it():
    """A thread that leaves the signal unblocked must not break the start of a process."""
    done = []

    def press_from_a_thread():
        with watch_ctrl_c(), hold_ctrl_c():
            other = threading.Thread(target=lambda: os.kill(os.getpid(), signal.SIGINT))
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
            other.start()
            other.join()
            time.sleep(0.05)
            done.append("started")

    with pytest.raises(KeyboardInterrupt):
        press_from_a_thread()
    assert done == ["started"]


def test_a_worker_starts_whole_though_ctrl_c_comes_meanwhile(monkeypatch):
    started = []
    real = jobs.multiprocessing.process.BaseProcess.start

    def start(process):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # as another thread has it
        os.kill(os.getpid(), signal.SIGINT)
        real(process)
        started.append(process)

    monkeypatch.setattr(jobs.multiprocessing.process.BaseProcess, "start", start)
    with pytest.raises(KeyboardInterrupt):
        list(run_jobs(str, range(3), 2))
    assert len(started) == 1
    started[0].kill()
    started[0].join()


def test_a_handler_is_put_back():
    before = signal.getsignal(signal.SIGINT), sys.unraisablehook
    with watch_ctrl_c():
        raise_if_interrupted()
    assert (signal.getsignal(signal.SIGINT), sys.unraisablehook) == before


@pytest.mark.parametrize("name", ["synthcam", "tracker", "discrepancy"])
@pytest.mark.parametrize("imported", ["typing", "typer", "{}.cli"])
def test_ctrl_c_during_the_imports_of_a_command(name, imported):
    """Ctrl-C is pressed while a command as it is installed imports a module: the first ones and the last one."""
    entry = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"][name]
    module, _, function = entry.partition(":")
    script = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    @staticmethod\n"
        "    def find_spec(fullname, path, target=None):\n"
        f"        if fullname == {imported.format(name)!r}: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder)\n"
        f"from {module} import {function}\n"
        f"{function}()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, f"{name}: interrupted; nothing was written\n")
