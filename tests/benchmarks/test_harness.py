"""Benchmarks that continue after they were stopped."""

import json
import os
import signal
import subprocess
import sys

import pytest

from benchmarks.harness import ROOT, keep

PARTS = ("one", "two", "three")
PROGRAM = """
import os, signal, sys
from pathlib import Path
from benchmarks.harness import keep
kept, deadly = Path(sys.argv[1]), sys.argv[2]
def measure(part):
    if part == deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    print(part)
    return {"length": len(part)}
print({part: keep(kept, part, lambda: measure(part))["length"] for part in ("one", "two", "three")})
"""


def run(kept, deadly):
    command = [sys.executable, "-c", PROGRAM, str(kept), deadly]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)


def test_a_run_that_was_killed_measures_only_what_is_left(tmp_path):
    kept = tmp_path / "deep" / "figures.jsonl"
    assert run(kept, "two").returncode == -signal.SIGKILL
    assert [json.loads(line)["part"] for line in kept.read_text().splitlines()] == ["one"]
    again = run(kept, "none")
    assert again.stdout.split("\n")[:-1] == ["two", "three", "{'one': 3, 'two': 3, 'three': 5}"], again.stderr


@pytest.mark.parametrize("cut", [1, 5, 30])
def test_a_line_without_its_end_is_measured_again(tmp_path, cut):
    kept, measured = tmp_path / "figures.jsonl", []

    def measure(part):
        measured.append(part)
        return len(measured)

    for part in PARTS:
        keep(kept, part, lambda part=part: measure(part))
    os.truncate(kept, kept.stat().st_size - cut)
    assert [keep(kept, part, lambda part=part: measure(part)) for part in PARTS] == [1, 2, 4]
    assert [json.loads(line)["figures"] for line in kept.read_text().splitlines()] == [1, 2, 4]
