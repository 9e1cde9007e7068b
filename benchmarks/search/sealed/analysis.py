"""The analysis of a box, in a process of its own: tracks and camera in, an answer out; it sees nothing else.

analysis.py MEASURED CAMERA|- MODEL.yaml FOLDER -> FOLDER/answer.json and FOLDER/kept_out.npz
"""

from __future__ import annotations

import json
import math
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.reading import read_collisions
from discrepancy.results import SearchResult
from discrepancy.search import search
from synthcam.model import list_model_settings, read_model
from synthcam_shared.errors import InputError

DIGITS = 7  # of an answer's numbers
LONGEST = 600.0  # s, of a search, that is then cut short: as the command's


def plain(value: Any) -> Any:
    """For JSON: no numpy, NaN as null, numbers to seven digits."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, float | np.floating):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def answer(found: SearchResult) -> dict[str, Any]:
    """Build the answer for the ledger: the document of the report and both models."""
    models = {"base": list_model_settings(found.gap_fits.before.model), "model": list_model_settings(found.model)}
    return found.document() | models


def keep(clips: list[MeasuredCollision] | tuple[MeasuredCollision, ...], path: Path) -> None:
    """The clips that no fit has seen, for the oracle."""
    arrays: dict[str, Any] = {}
    for c in clips:
        arrays |= {f"{c.clip}/{k}": getattr(c, k) for k in ("frame", "ball", "xy", "covariance", "launch")}
    np.savez(path, **arrays)


def analyse(measured: Path, camera: Path | None, model: Path, folder: Path) -> dict[str, Any]:
    """The answer to one box; the clips that no fit saw go into `folder`."""
    try:
        clips, left_out = read_collisions(measured, camera)
        given = read_model(model)
        began, spent = time.monotonic(), time.process_time()
        found = search(clips, given, seconds=LONGEST)
        said = answer(found) | {"seconds": time.monotonic() - began, "cpu": time.process_time() - spent}
        keep(found.data.held_out, folder / "kept_out.npz")
        return dict(plain(said | {"clips_used": len(clips), "left_out": list(map(str, left_out))}))
    except InputError as e:
        return {"verdict": "refused", "why": str(e)}
    except Exception as e:  # the study goes on, and the page says so
        where = [f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in traceback.extract_tb(e.__traceback__)]
        return {"verdict": "crashed", "why": repr(e), "trace": where}


def main() -> None:
    measured, model, folder = (Path(sys.argv[k]) for k in (1, 3, 4))
    camera = None if sys.argv[2] == "-" else Path(sys.argv[2])
    said = analyse(measured, camera, model, folder)
    (folder / "answer.json").write_text(json.dumps(said, allow_nan=False))


if __name__ == "__main__":
    main()
