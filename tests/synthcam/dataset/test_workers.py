"""Workers: what they say, what they raise, and what is left when they are killed."""

import functools
import os
import signal
import time

import pytest

from synthcam.dataset.workers import each
from synthcam_shared.errors import InputError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills processes by signals")


def work(deadly, number):
    if number in deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 13:
        raise InputError("unlucky")
    return f"odd {os.getpid()}" if number % 2 else ""


def ready(deadly):
    return functools.partial(work, deadly)


def deaf(number):
    return str(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()))


def ready_deaf():
    return deaf


def dead():
    os._exit(3)


def running():
    return {k for k in os.listdir("/proc") if k.isdigit()} if os.path.isdir("/proc") else set()


def test_every_number_once():
    said = dict(each(range(10), 2, functools.partial(ready, ())))
    assert sorted(said) == list(range(10))
    assert [said[k] == "" for k in range(10)] == [True, False] * 5
    assert len({said[k] for k in (1, 3, 5, 7, 9)}) <= 2
    assert all(int(said[k].split()[1]) != os.getpid() for k in (1, 3))


def test_a_killed_worker_loses_its_number_only():
    said = dict(each(range(8), 2, functools.partial(ready, (2, 6))))
    assert said[2] == said[6] == "its worker was killed (SIGKILL)"
    assert [said[k] for k in (0, 4)] == ["", ""]
    assert all(said[k].startswith("odd") for k in (1, 3, 5, 7))


def test_this_process_works_beside_the_others():
    said = dict(each(range(100, 400), 1, functools.partial(ready, ()), ready(())))
    assert sorted(said) == list(range(100, 400))
    by = {int(said[k].split()[1]) for k in range(101, 400, 2)}
    assert os.getpid() in by
    assert len(by) == 2


def test_what_a_killed_worker_had_ahead_is_done_by_others():
    said = dict(each([2, 5, 4, 6, 8], 1, functools.partial(ready, (2,)), lambda number: f"here {number}"))
    assert said.pop(2) == "its worker was killed (SIGKILL)"
    assert sorted(said) == [4, 5, 6, 8]
    assert not any("killed" in text for text in said.values())


def test_without_workers_this_process_does_all():
    assert dict(each([1, 2], 0, dead, str)) == {1: "1", 2: "2"}


def test_workers_that_all_die_are_given_up():
    with pytest.raises(InputError, match=r"clip \d+: worker ended \(status 3\), the 3th in a row"):
        list(each(range(1000), 2, dead))


def test_what_work_raises_is_raised_here():
    with pytest.raises(InputError, match="unlucky"):
        list(each([12, 13, 14, 15, 16], 2, functools.partial(ready, ())))


def test_left_in_the_middle_no_worker_stays():
    pids = set()
    results = each(range(101, 1000, 2), 2, functools.partial(ready, ()))
    for _ in range(40):
        pids.add(next(results)[1].split()[1])
    results.close()
    deadline = time.monotonic() + 5
    while pids & running() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert pids
    assert not pids & running()


def test_workers_never_hear_ctrl_c():
    """Not even while they start: blocked from before they were, and here only for that long."""
    assert dict(each([1, 2], 2, ready_deaf)) == {1: "True", 2: "True"}
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
