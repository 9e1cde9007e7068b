"""Example films for somebody who has none: made once by `synthcam generate`, into the user's cache."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from synthcam_shared.errors import InputError

SCENES = ("oblique", "head_on", "tray")  # of the package; each is drawn in seconds
OPTIONS = ("--set", "camera.size=[480,360]", "--compression", "zstd", "--seed", "3")


def make_examples() -> Path:
    """The dataset of the example films, made if it is not there yet. Raises InputError."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "synthcam" / "examples"
    if not folder.exists():
        print(f"tracker: making the example films in {folder}, once, in some seconds", file=sys.stderr, flush=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        words = [sys.executable, "-m", "synthcam", "generate", *SCENES, "-o", f"{folder}", *OPTIONS]
        made = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
        if made.returncode:
            last = (made.stderr.strip().splitlines() or ["no message"])[-1]
            raise InputError(f"{folder}: the example films could not be made ({last}); name a film of your own")
    return folder
