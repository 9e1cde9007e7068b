"""Clips side by side: where it pays, and nowhere else."""

from __future__ import annotations

import itertools
import operator
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from processes import alive, until

from tracker import parallel


def test_what_tasks_gave_is_put_in_order_as_soon_as_it_can_be():
    def given():
        yield from [(7, "seven"), (5, "five"), (9, "nine")]
        raise AssertionError("asked for more before it was needed")

    ordered = parallel.in_order(given(), [5, 7, 9, 11])
    assert [next(ordered) for _ in range(3)] == ["five", "seven", "nine"]
    with pytest.raises(AssertionError):
        next(ordered)


@pytest.mark.parametrize(("seconds", "elsewhere"), [(0.0, 0), (2.0, 2)])
def test_processes_start_where_there_is_much_to_do(monkeypatch, seconds, elsewhere):
    """With three of five clips to come, each of so many seconds; this process does the third of them."""
    clock = itertools.count(0, seconds)
    monkeypatch.setattr(parallel.time, "process_time", lambda: next(clock))
    monkeypatch.setattr(parallel, "_cores", lambda: 2)
    monkeypatch.setattr(
        parallel, "ProcessPoolExecutor", lambda most, mp_context, **first: ThreadPoolExecutor(most, **first)
    )
    done = list(parallel.in_parallel(lambda clip: (clip, threading.current_thread()), range(5), 0, Path()))
    assert sorted(clip for clip, _ in done) == [*range(5)]
    assert sum(thread is not threading.main_thread() for _, thread in done) == elsewhere


class Counted:
    """Work that counts how often it is sent to another process, where it is int.bit_length."""

    sent = 0

    def __call__(self, number: int) -> int:
        return number.bit_length()

    def __reduce__(self) -> tuple[object, tuple[str]]:
        Counted.sent += 1
        return operator.methodcaller, ("bit_length",)


def test_work_is_sent_once_to_a_process_not_with_each_number(monkeypatch):
    """Of ten thousand clips it names ten thousand files."""
    monkeypatch.setattr(Counted, "sent", 0)
    done = list(parallel.in_parallel(Counted(), range(60), 2, Path()))
    assert sorted(done) == sorted(n.bit_length() for n in range(60))
    assert Counted.sent == 1


BUSY = """
import time
from pathlib import Path
from tracker.parallel import in_parallel

if __name__ == "__main__":
    list(in_parallel(time.sleep, [0.01] * 2 + [60] * 4, 3, Path()))
"""


@pytest.mark.skipif(not Path("/proc").exists(), reason="reads /proc")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_workers_do_not_outlive_a_killed_parent(how, tmp_path):
    (tmp_path / "busy.py").write_text(BUSY)
    first = subprocess.Popen([sys.executable, str(tmp_path / "busy.py")], start_new_session=True)
    assert until(lambda: len(alive(first.pid)) >= 3)
    first.send_signal(how)
    first.wait()
    assert until(lambda: not alive(first.pid))
