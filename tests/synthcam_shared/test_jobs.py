"""Jobs: what they return, what they raise, what is left when workers are killed, and when processes are worth it."""

import functools
import itertools
import operator
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from processes import alive, until
from work_of_jobs import LoadsOnlyHere, die, elsewhere, hears_ctrl_c, kill, work

from synthcam_shared import jobs
from synthcam_shared.errors import InputError
from synthcam_shared.job_result import JobValue, LostJob
from synthcam_shared.jobs import run_all_jobs, run_jobs, yield_in_order

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills processes by signals")


def test_every_number_once_by_this_process_and_others():
    results = list(run_jobs(work, range(100, 400), 2))
    assert sorted(result.number for result in results) == list(range(100, 400))
    by = {result.value for result in results}
    assert os.getpid() in by
    assert len(by) == 2


def test_a_killed_worker_loses_its_number_only():
    results = {r.number: r for r in run_jobs(elsewhere(functools.partial(kill, (2, 6))), range(12), 3)}
    assert sorted(results) == list(range(12))
    lost = {number: r for number, r in results.items() if isinstance(r, LostJob)}
    assert lost
    assert set(lost) <= {2, 6}
    assert all(r.reason == "its worker was killed (SIGKILL)" for r in lost.values())


def test_what_a_killed_worker_had_ahead_is_done_by_others():
    results = [*run_jobs(elsewhere(functools.partial(kill, (2, 3))), [2, 3, 4, 6, 8, 10, 12], 2)]
    assert sorted(r.number for r in results) == [2, 3, 4, 6, 8, 10, 12]
    assert {r.number for r in results if isinstance(r, LostJob)} <= {2, 3}
    assert 1 <= sum(isinstance(r, LostJob) for r in results) <= 2


def test_one_worker_is_this_process():
    assert list(run_jobs(str, [1, 2], 1)) == [JobValue(1, "1"), JobValue(2, "2")]


def test_a_lost_job_is_an_error_where_all_are_needed():
    results = run_all_jobs(elsewhere(functools.partial(kill, (2,))), range(12), 3, "film.tif")
    with pytest.raises(InputError, match=r"film\.tif: clip 2: its worker was killed \(SIGKILL\); is there enough"):
        list(results)


def test_workers_that_all_die_are_given_up():
    with pytest.raises(InputError, match=r"clip \d+: worker ended \(status 3\), the third in a row"):
        list(run_jobs(elsewhere(die), range(1000), 3))


def test_what_work_raises_is_raised_here():
    with pytest.raises(InputError, match="unlucky"):
        list(run_jobs(elsewhere(work), [12, 13, 14, 15, 16], 2))


def test_work_that_a_process_cannot_load_is_an_error_and_nobody_waits():
    with pytest.raises(ModuleNotFoundError, match="mine"):
        list(run_jobs(LoadsOnlyHere(), range(50), 2))


def test_left_in_the_middle_no_worker_stays():
    results = run_jobs(elsewhere(work), range(101, 1000), 3)
    pids = set()
    while len(pids) < 2:  # until both others have answered
        pids |= {next(results).value} - {os.getpid()}
    results.close()
    assert until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids))


def test_workers_never_hear_ctrl_c():
    """Not even while they start: blocked from before they were, and here only for that long."""
    results = {r.number: r.value for r in run_jobs(elsewhere(hears_ctrl_c), [1, 2, 3, 4, 5], 3)}
    assert False in results.values()
    assert True not in {value for value in results.values() if isinstance(value, bool)}
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.parametrize(("seconds", "others"), [(0.0, 0), (2.0, 1)])
@pytest.mark.parametrize(("trials", "left"), [(2, [2, 3, 4, 5]), (3, [2, 3, 5])])
def test_processes_start_where_there_is_much_to_do(monkeypatch, seconds, others, trials, left):
    """The first, the last and perhaps a middle job show how long one takes."""
    clock, asked = itertools.count(0, seconds), []

    def run_in_processes(work, numbers, others, ready):
        asked.append((list(numbers), others))
        return [JobValue(number, work(number)) for number in numbers]

    monkeypatch.setattr(jobs.time, "process_time", lambda: next(clock))
    monkeypatch.setattr(jobs, "count_cores", lambda: 2)
    monkeypatch.setattr(jobs, "_run_in_processes", run_in_processes)
    results = list(run_jobs(str, range(1, 7), trials=trials))
    assert sorted(r.number for r in results) == [1, 2, 3, 4, 5, 6]
    assert asked == [(left, others)]


def test_the_trial_jobs_are_announced():
    heard = []
    list(run_jobs(str, range(8), 1, trials=3, announce=heard.append))
    assert [(t.numbers, t.jobs_left, t.workers) for t in heard] == [((0, 4, 7), 5, 1)]
    assert 0 <= heard[0].seconds < 1


def test_values_are_put_in_order_as_soon_as_it_can_be():
    def given():
        yield from [(7, "seven"), (5, "five"), (9, "nine")]
        raise AssertionError("asked for more before it was needed")

    ordered = yield_in_order(given(), [5, 7, 9, 11])
    assert [next(ordered) for _ in range(3)] == ["five", "seven", "nine"]
    with pytest.raises(AssertionError):
        next(ordered)


class Counted:
    """Work that counts how often it is sent to another process, where it is int.bit_length."""

    sent = 0

    def __call__(self, number: int) -> int:
        return number.bit_length()

    def __reduce__(self) -> tuple[object, tuple[str]]:
        Counted.sent += 1
        return operator.methodcaller, ("bit_length",)


def test_work_is_sent_once_to_a_process_not_with_each_number(monkeypatch):
    """Ten thousand clips have ten thousand file names."""
    monkeypatch.setattr(Counted, "sent", 0)
    assert sorted(run_all_jobs(Counted(), range(60), 2, "")) == sorted(n.bit_length() for n in range(60))
    assert Counted.sent == 1


COPIES = """
import functools, os, sys, threading
import work_of_jobs
from synthcam_shared.jobs import run_jobs

if __name__ == "__main__":
    work_of_jobs.known = "what the parent knew"
    if sys.argv[1:] == ["beside a thread"]:
        threading.Thread(target=threading.Event().wait, daemon=True).start()
    recalled = run_jobs(work_of_jobs.elsewhere(work_of_jobs.recall), range(8), 3, fork=True)
    values = [result.value for result in recalled]
    print(len(values), {value[0] for value in values if value != os.getpid()})
    killed = run_jobs(work_of_jobs.elsewhere(functools.partial(work_of_jobs.kill, (0,))), range(8), 2, fork=True)
    print(sorted((result.number, type(result).__name__) for result in killed)[0])
"""


@pytest.mark.skipif(not Path("/proc").exists(), reason="reads /proc")
@pytest.mark.parametrize(("case", "knew"), [("alone", "what the parent knew"), ("beside a thread", "nothing")])
def test_processes_are_copies_of_this_one_where_it_has_one_thread(case, knew, tmp_path):
    """A process that is started anew has what the module says."""
    (tmp_path / "copies.py").write_text(COPIES)
    words = [sys.executable, str(tmp_path / "copies.py"), case]
    done = subprocess.run(
        words, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["8 {" + repr(knew) + "}", "(0, 'LostJob')"]


LEFT = """
import multiprocessing, signal, sys, time
from synthcam_shared.jobs import run_jobs

if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda number, frame: None)
    jobs = run_jobs(time.sleep, [0, 60, 60], 3, fork=True)
    started = len(multiprocessing.active_children())
    if sys.argv[1:] == ["later"]:
        next(jobs)
    jobs.close()
    print(started, len(multiprocessing.active_children()))
"""


@pytest.mark.skipif(not Path("/proc").exists(), reason="reads /proc")
@pytest.mark.parametrize("when", ["at once", "later"])
def test_copies_end_with_the_jobs_whatever_the_parent_does_at_a_signal(when, tmp_path):
    (tmp_path / "left.py").write_text(LEFT)
    words = [sys.executable, str(tmp_path / "left.py"), when]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(words, env=env, capture_output=True, text=True, timeout=30)
    assert (done.stdout, done.stderr) == ("2 0\n", "")


BUSY = """
import time
from synthcam_shared.jobs import run_jobs

if __name__ == "__main__":
    for _ in run_jobs(time.sleep, [60] * 6, 3, fork={fork}): pass
"""


@pytest.mark.skipif(not Path("/proc").exists(), reason="reads /proc")
@pytest.mark.parametrize(("how", "fork"), [(signal.SIGKILL, False), (signal.SIGTERM, False), (signal.SIGKILL, True)])
def test_workers_do_not_outlive_a_killed_parent(how, fork, tmp_path):
    (tmp_path / "busy.py").write_text(BUSY.format(fork=fork))
    first = subprocess.Popen([sys.executable, str(tmp_path / "busy.py")], start_new_session=True)
    assert until(lambda: len(alive(first.pid)) >= 3)
    first.send_signal(how)
    first.wait()
    assert until(lambda: not alive(first.pid))
