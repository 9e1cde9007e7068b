"""Cases of contacts: those that last, bodies that stay together, and what must not be `ok`."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.tracker.ordinary.case import Case, Judge, Outcome, Verdict, Words
from benchmarks.tracker.ordinary.judges import Measured, Refused, describe_end
from benchmarks.tracker.ordinary.sources import know_table, write_camera

lasting: Any = importlib.import_module("tracker_contacts")


class NotOk:
    """No collision of the folder `new` is `ok`, or the table is refused in one line."""

    right = "not ok, or refused"

    def __call__(self, outcome: Outcome) -> Verdict:
        path = outcome.folder / "new/estimates.parquet"
        if not path.is_file():
            return Verdict(describe_end(outcome), outcome.status == 2 and "Traceback" not in outcome.err)
        status = pd.read_parquet(path)["status"].tolist()
        return Verdict(f"{', '.join(map(str, status))}: {outcome.last_line[:120]}", "ok" not in status)


def measure_hit(hit: Any, seed: int = 0) -> Callable[[Path], Words]:
    """Tracks of a simulated hit in metres, and `tracker measure` of them."""

    def make(folder: Path) -> Words:
        write_camera(folder, hit.camera)
        hit.tracks(np.random.default_rng(seed)).to_csv(folder / "t.csv", index=False)
        return ["tracker", "measure", "t.csv", "--camera", "camera.json", "--unit", "m", "-o", "new", "--no-pages"]

    return make


def measure_straight(r: float) -> Callable[[Path], Words]:
    """Two discs without friction that part with r times the closing speed, px; r over 1 is impossible."""

    def make(folder: Path) -> Words:
        write_camera(folder, know_table())
        diameter = know_table()["ball_diameter"] / know_table()["scale"]
        rng, t = np.random.default_rng(3), np.arange(60)[:, None] - 24.4
        n, v = np.array([np.sqrt(1 - 0.09), 0.3]), np.array([3.0, 0.0])
        kick = (1 + r) / 2 * (v @ n) * n
        struck = np.array([90.0, 80.0]) + np.maximum(t, 0) * kick
        striker = np.array([90.0, 80.0]) - diameter * n + np.where(t < 0, t * v, t * (v - kick))
        xy = np.concatenate([struck, striker]) + 0.02 * rng.standard_normal((120, 2))
        rows = {"frame": np.tile(np.arange(60), 2), "particle": np.repeat([0, 1], 60), "x": xy[:, 0], "y": xy[:, 1]}
        pd.DataFrame(rows).to_csv(folder / "t.csv", index=False)
        return ["tracker", "measure", "t.csv", "--camera", "camera.json", "-o", "new", "--no-pages"]

    return make


def misread_thousands(folder: Path) -> Words:
    """Micrometres with commas between thousands and no other sign of it: 1,234 may be 1.234."""
    write_camera(folder, know_table())
    frame = np.arange(40)
    rows = [f"{k};{ball};{25 * x:,.0f};{25 * y:,.0f}" for k in frame
            for ball, x, y in ((0, 300.0, 240.0), (1, 100.0 + 10 * k, 255.2)) if 25 * x >= 1000]  # fmt: skip
    (folder / "t.csv").write_text("\n".join(["frame;particle;x;y", *rows]) + "\n")
    return ["tracker", "measure", "t.csv", "--camera", "camera.json", "-o", "new", "--no-pages"]


def list_cases() -> list[Case]:
    """Cases of contacts."""
    hit = lasting.SoftHit
    discs = {f"discs, contact of {ms} ms, r .9": hit(ms / 1e3) for ms in (0, 6, 14, 16, 18, 22)}
    slow = {"v0": 0.3}
    cases = [
        Case("contacts", kind, measure_hit(made), Measured(
            {**slow, "r": made.r}, or_no_error={"r_free": made.r, "r_paper": made.r}))
        for kind, made in discs.items()
    ]  # fmt: skip
    others: dict[str, tuple[Callable[[Path], Words], Judge]] = {
        "balls that roll, contact of 8 ms, r .85": (
            measure_hit(hit(0.008, r=0.85, friction=0.2)), Measured({**slow, "r": 0.85, "mu_k": 0.2}),
        ),
        "Hertz contact of 10 ms, r .7": (measure_hit(hit(0.01, r=0.7, law="hertz")), Measured({**slow, "r": 0.7})),
        "discs with tape that stay together": (
            measure_hit(hit(0.01, sticky=True, r=0.0)), Measured({**slow, "r": 0.0}, ("stay_together",), ("part in",)),
        ),
        "discs that part faster than they meet, r 1.1": (measure_straight(1.1), NotOk()),
        "thousands separator read as a decimal point": (misread_thousands, Refused(("--decimal",))),
        "a hit without friction, r .8": (
            measure_straight(0.8), Measured({"r": 0.8}, says=("the balls move straight after the hit",)),
        ),
    }  # fmt: skip
    return cases + [Case("contacts", kind, make, judge) for kind, (make, judge) in others.items()]
