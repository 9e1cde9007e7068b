"""Clips side by side: where it pays, and nowhere else."""

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tracker import parallel


@pytest.mark.parametrize(("seconds", "elsewhere"), [(0.0, 0), (2.0, 2)])
def test_processes_start_where_there_is_much_to_do(monkeypatch, seconds, elsewhere):
    """With three of five clips to come, each of so many seconds; this process does the third of them."""
    clock = itertools.count(0, seconds)
    monkeypatch.setattr(parallel.time, "process_time", lambda: next(clock))
    monkeypatch.setattr(parallel, "_cores", lambda: 2)
    monkeypatch.setattr(parallel, "ProcessPoolExecutor", lambda most, mp_context: ThreadPoolExecutor(most))
    done = list(parallel.in_parallel(lambda clip: (clip, threading.current_thread()), range(5), 0, Path()))
    assert sorted(clip for clip, _ in done) == [*range(5)]
    assert sum(thread is not threading.main_thread() for _, thread in done) == elsewhere
