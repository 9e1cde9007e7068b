"""A child process: progress, end, failure, and how it is cancelled."""

import sys

import pytest
from processes import until

from tracker.app.track_process import TrackProcess

CHILDREN = {
    "done": "print('frames: 1 of 9 after 1 s', 'frames: 3 of 9 after 2 s, about 4 s left', 'tracker: a note',"
    " sep='\\n', file=e); print('{\"clips\": 1}')",
    "failed": "print('tracker: film.mp4: no frames', file=e); sys.exit(2)",
    "crashed": "sys.exit(3)",
    "killed": "os.kill(os.getpid(), 9)",
    "waits": "signal.signal(2, signal.default_int_handler); print('frames: 1 of 9 after 1 s', file=e); e.flush()"
    "; time.sleep(60)",
    "deaf": "signal.signal(2, signal.SIG_IGN); print('frames: 1 of 9 after 1 s', file=e); e.flush(); time.sleep(60)",
    "wordy": "print('{\"x\": \"' + 'y' * 300_000 + '\"}')",
}


def run_child(name):
    program = f"import os, signal, sys, time; e = sys.stderr; {CHILDREN[name]}"
    process = TrackProcess(program=(sys.executable, "-c", program))
    process.start(4, ["tracker", "track"])
    return process


@pytest.mark.parametrize(
    ("name", "state", "error"),
    [
        ("done", "done", ""),
        ("failed", "failed", "film.mp4: no frames"),
        ("crashed", "failed", "tracker track (exit status 3)"),
        ("killed", "failed", "tracker track (ended by signal 9)"),
        ("wordy", "done", ""),
    ],
)
def test_a_child_that_ends(name, state, error):
    process = run_child(name)
    assert until(lambda: not process.is_running)
    status = process.status
    assert (status.number, status.state, status.error) == (4, state, error)
    if name == "done":
        assert (status.what, status.done, status.total, status.left_s) == ("frames", 3, 9, 4)
        assert 0 < process.seconds < 60
        assert (status.lines, status.summary) == (("a note",), {"clips": 1})


@pytest.mark.parametrize("name", ["waits", "deaf"])
def test_a_child_is_cancelled_and_if_need_be_killed(name):
    process = run_child(name)
    assert until(lambda: process.status.done == 1)
    process.cancel(patience_s=0.1)
    assert until(lambda: not process.is_running)
    assert process.status.state == "cancelled"


def test_closing_ends_the_child():
    process = run_child("waits")
    assert until(lambda: process.status.done == 1)
    process.close()
    assert process.status.state == "cancelled"
