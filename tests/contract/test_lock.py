"""requirements.lock installs on the day a newer release of any of its packages comes out."""

from importlib.metadata import distribution, distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

LOCK = Path(__file__).parents[2] / "requirements.lock"


def _locked() -> dict[str, set[str]]:
    """Name and extras of each package that this Python takes from the lock."""
    lines = [line.rstrip(" \\") for line in LOCK.read_text().splitlines() if line[:1].isalnum()]
    wanted = [Requirement(line) for line in lines]
    return {canonicalize_name(r.name): r.extras for r in wanted if r.marker is None or r.marker.evaluate()}


def test_extras_are_locked_with_their_package() -> None:
    """Pip (23.2 at least) looks for "a[b]" apart from "a==1" and then refuses the newest "a", which has no hash."""
    locked, missing = _locked(), list[str]()
    if absent := set(locked) - {canonicalize_name(found.name) for found in distributions()}:
        pytest.skip(f"the environment is older than the lock and lacks {', '.join(sorted(absent))}; type: make install")
    for name in locked:
        for line in distribution(name).requires or []:
            wanted = Requirement(line)
            if wanted.marker is None or any(wanted.marker.evaluate({"extra": extra}) for extra in ("", *locked[name])):
                lacks = wanted.extras - locked.get(canonicalize_name(wanted.name), set())
                missing += [f"{name} asks for {wanted.name}[{extra}]" for extra in sorted(lacks)]
    assert missing == []
