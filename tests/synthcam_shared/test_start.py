"""The start and the end of a process: when Python looks for garbage, and what still runs."""

import os
import subprocess
import sys

import pytest

HEAD = """
import atexit, gc, os, sys, threading, time
from synthcam_shared.start import defer_garbage_collection, skip_teardown
"""
BUFFERED = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}


def run_python(code):
    command = [sys.executable, "-c", HEAD + code]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=BUFFERED)


def test_garbage_is_first_sought_when_many_objects_exist_and_then_as_usual():
    code = """
usual, searches = gc.get_threshold(), []
gc.callbacks.append(lambda phase, about: searches.append((phase, about["generation"])))
defer_garbage_collection(20_000)
few = [[] for _ in range(15_000)]
print(searches)
many = [[] for _ in range(10_000)]
print(("start", 0) in searches, gc.get_threshold() == usual, len(gc.get_objects(generation=2)) > 20_000)
"""
    done = run_python(code)
    assert done.stdout.splitlines() == ["[]", "True True True"], done.stderr


@pytest.mark.parametrize(("status", "freed"), [("0", []), ("2", []), (None, ["freed"])])
def test_nothing_but_the_teardown_is_skipped(status, freed):
    """Threads, functions of `atexit` and buffered output come to their end; an object that lives on is not freed."""
    code = f"""
class Kept:
    def __del__(self, write=sys.stdout.write):
        write("freed")
kept = Kept()
end_at_once = skip_teardown()
atexit.register(print, "registered")
threading.Thread(target=lambda: (time.sleep(0.1), print("thread"))).start()
if {status} is not None:
    end_at_once({status})
sys.exit({status})
"""
    done = run_python(code)
    assert done.stdout.split() == ["thread", "registered", *freed], done.stderr
    assert done.returncode == int(status or 0)


@pytest.mark.parametrize(("close", "status"), [("sys.stdout.close()", 0), ("os.close(1)", 120)])
def test_a_closed_output_ends_as_python_ends_it(close, status):
    done = run_python(f"end_at_once = skip_teardown()\nprint(1)\n{close}\nend_at_once(0)\n")
    assert (done.returncode, "atexit" in done.stderr) == (status, False), done.stderr
