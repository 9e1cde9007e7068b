"""Cases of contacts: those that last, bodies that stay together, and what must not be `ok`."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.tracker.ordinary.case import Case, Judge, Outcome, Verdict, Words
from benchmarks.tracker.ordinary.judges import Either, Measured, Refused, describe_end, list_missing
from benchmarks.tracker.ordinary.sources import RADIUS, Filmed, discs, know_table, measure, track, write_camera

lasting: Any = importlib.import_module("tracker_contacts")
video: Any = importlib.import_module("tracker_video")
REST = np.array([90.0, 80.0])  # of the struck ball in tables, px


@dataclass(frozen=True)
class NotOk:
    """No collision of the folder `new` is `ok`, and the command says these words."""

    says: tuple[str, ...]

    @property
    def right(self) -> str:
        return "; ".join(["not ok", *map(repr, self.says)])

    def __call__(self, outcome: Outcome) -> Verdict:
        path = outcome.folder / "new/estimates.parquet"
        if outcome.status != 0 or not path.is_file():
            return Verdict(describe_end(outcome), False)
        status, missing = pd.read_parquet(path)["status"].tolist(), list_missing(self.says, outcome.said)
        said = [f"without {word!r}" for word in missing] or [repr(word) for word in self.says]
        return Verdict(", ".join([*map(str, status), *said]), bool(status) and "ok" not in status and not missing)


def measure_hit(hit: Any, seed: int = 0, decimals: int = 15) -> Callable[[Path], Words]:
    """Tracks of a simulated hit in metres, and `tracker measure` of them."""

    def make(folder: Path) -> Words:
        write_camera(folder, hit.camera)
        hit.tracks(np.random.default_rng(seed)).round({"x": decimals, "y": decimals}).to_csv(
            folder / "t.csv", index=False
        )
        return ["tracker", "measure", "t.csv", "--camera", "camera.json", "--unit", "m", "-o", "new", "--no-pages"]

    return make


@dataclass(frozen=True)
class Impact:
    """A striker that rolls at 3 px a frame into a ball at rest, at the impact parameter .3 of a diameter.

    The laws need not be possible: r may be over 1, and the spin transfer C outside 0 to 5/7. mu: friction of the plate,
    without which both are discs that move straight.
    """

    r: float
    mu: float = 0.0
    C: float = 0.0

    @property
    def truth(self) -> dict[str, float]:
        """The values of a hit with friction."""
        return {"r": self.r, "mu_k": self.mu, "C": self.C}

    def positions(self, t: NDArray[Any]) -> NDArray[Any]:
        """Centres (2, n, 2) of struck ball and striker, px, at times t since the contact, frames."""
        n, v = np.array([np.sqrt(1 - 0.09), 0.3]), np.array([3.0, 0.0])
        normal = (v @ n) * n
        kick = (1 + self.r) / 2 * normal + 0.4 * self.C * (v - normal)  # change of the struck ball's velocity
        spun = -self.C * normal  # change of the velocities at which the balls would roll
        diameter = know_table()["ball_diameter"] / know_table()["scale"]
        struck = REST + self._slide(kick, spun, t)
        striker = REST - diameter * n + np.where(t[:, None] < 0, np.outer(t, v), self._slide(v - kick, v + spun, t))
        return np.stack([struck, striker])

    def _slide(self, v: NDArray[Any], rolling: NDArray[Any], t: NDArray[Any]) -> NDArray[Any]:
        """Paths from the contact on, at the velocity v at first and at (5 v + 2 rolling) / 7 after the slide."""
        late, slip = np.maximum(t, 0)[:, None], v - rolling
        gravity = 9.81 / know_table()["scale"] / know_table()["fps"] ** 2  # px a frame^2
        path: NDArray[Any] = late * v
        if not self.mu:
            return path
        lasts = np.hypot(*slip) / (3.5 * self.mu * gravity)
        sliding = np.minimum(late, lasts)
        pull = self.mu * gravity * slip / np.hypot(*slip)
        path -= pull * (sliding**2 / 2 + np.maximum(late - lasts, 0) * lasts)
        return path


def measure_impact(impact: Impact, last: int = 59) -> Callable[[Path], Words]:
    """Positions in the frames up to the last, px, with noise, and `tracker measure` of them."""

    def write(path: Path) -> None:
        t = np.arange(last + 1) - 24.4
        xy = impact.positions(t).reshape(-1, 2) + 0.02 * np.random.default_rng(3).standard_normal((2 * len(t), 2))
        frame, ball = np.tile(np.arange(len(t)), 2), np.repeat([0, 1], len(t))
        pd.DataFrame({"frame": frame, "particle": ball, "x": xy[:, 0], "y": xy[:, 1]}).to_csv(path, index=False)

    return measure("t.csv", write)


@cache
def film_impact() -> Filmed:
    """A film of two discs that move straight, of a diameter of 16 px."""
    grown, impact = 2 * RADIUS * know_table()["scale"] / know_table()["ball_diameter"], Impact(0.8)
    places = np.array([100.0, 90.0]) + grown * (impact.positions((np.arange(60) - 24.4) / 2) - REST)
    ground = discs.plate(np.random.default_rng(0), size=(180, 240))
    frames = discs.film(np.random.default_rng(1), places, ground=ground, radius=RADIUS)
    camera = {**know_table(), "size": [240, 180], "scale": know_table()["ball_diameter"] / (2 * RADIUS)}
    return Filmed(frames=frames, camera=camera, truth={"r": impact.r}, places=places)


def track_impact(name: str, codec: str, pixels: str, **options: str) -> Callable[[Path], Words]:
    """A copy of that film in a codec, and `tracker track` of it."""

    def write(folder: Path) -> Path:
        frames = film_impact().frames
        return Path(video.encode(folder / name, frames, codec, pixels, rate=250, options=options, full=True))

    return track(write, film_impact)


def write_thousands(path: Path) -> None:
    """Write micrometres with commas between thousands and no other sign of it: 1,234 may be 1.234."""
    rows = [f"{k};{ball};{25 * x:,.0f};{25 * y:,.0f}" for k in range(40)
            for ball, x, y in ((0, 300.0, 240.0), (1, 100.0 + 10 * k, 255.2)) if 25 * x >= 1000]  # fmt: skip
    path.write_text("\n".join(["frame;particle;x;y", *rows]) + "\n")


def list_cases() -> list[Case]:
    """Cases of contacts."""
    hit = lasting.SoftHit
    discs = {f"discs, contact of {ms} ms, r .9": hit(ms / 1e3) for ms in (0, 6, 14, 16, 18, 22)}
    slow, turned = {"v0": 0.3}, Impact(0.85, mu=0.2, C=0.35)
    late = ("* extrapolated: a ball slides for longer",)
    left = 0.09 + 0.91 * (1 + 0.8**2) / 2  # share of the energy that discs keep
    cases = [
        Case("contacts", kind, measure_hit(made), Measured(
            {**slow, "r": made.r}, or_no_error={"r_free": made.r, "r_paper": made.r}))
        for kind, made in discs.items()
    ]  # fmt: skip
    energy = {"energy_fraction": left, "energy_fraction_free": left}
    marked = Measured({"r": 0.8}, says=late)
    straight = Either(
        Measured({"r": 0.8}, or_no_error=energy),
        Either(marked, Measured({"r_free": 0.8}, ("misfit",), ("the codec", "compression"), or_no_error=energy)),
    )
    others: dict[str, tuple[Callable[[Path], Words], Judge]] = {
        "balls that roll, contact of 8 ms, r .85": (
            measure_hit(hit(0.008, r=0.85, friction=0.2)), Measured({**slow, "r": 0.85, "mu_k": 0.2}),
        ),
        "discs of a simulation without noise, to 10 nm": (
            measure_hit(hit(0.0, b=0.3, noise=0.0), decimals=8), Measured({**slow, "r": 0.9}, off=1e-6),
        ),
        "Hertz contact of 10 ms, r .7": (measure_hit(hit(0.01, r=0.7, law="hertz")), Measured({**slow, "r": 0.7})),
        "discs with tape that stay together": (
            measure_hit(hit(0.01, sticky=True, r=0.0)), Measured({**slow, "r": 0.0}, ("stay_together",), ("part in",)),
        ),
        "discs that part faster than they meet, r 1.1": (measure_impact(Impact(1.1)), NotOk(("r over 1",))),
        "spin transfer .35, which is possible": (measure_impact(turned), Measured(turned.truth)),
        "spin transfer .9, over 5/7": (measure_impact(replace(turned, C=0.9)), NotOk(("C over 5/7",))),
        "spin transfer -.2": (measure_impact(replace(turned, C=-0.2)), NotOk(("C under 0",))),
        "thousands separator read as a decimal point": (measure("t.csv", write_thousands), Refused(("--decimal",))),
        "the same, --decimal ,": (measure("t.csv", write_thousands, "--decimal", ","), Refused(("x, y", "--unit"))),
        "a hit without friction, r .8": (
            measure_impact(Impact(0.8)), Measured(
                {"r": 0.8, "r_free": 0.8}, or_no_error={"r_paper": 0.8, "energy_fraction": left},
                says=("the balls move straight after the hit", "finite differences")),
        ),
        "a hit without friction, four frames after it": (
            measure_impact(Impact(0.8), 28), Either(
                Measured({"r": 0.8, "energy_fraction": left}), marked),
        ),
        "the same in a film without loss": (track_impact("film.mkv", "ffv1", "gray"), straight),
        "the same in MJPEG": (track_impact("film.avi", "mjpeg", "yuvj420p", qmin="3", qmax="3"), straight),
        "the same in H.264": (track_impact("film.mp4", "libx264", "yuv420p", crf="23"), straight),
        "the same in mp4v": (track_impact("film.mp4", "mpeg4", "yuv420p", qmin="5", qmax="5"), straight),
        "balls that slide until the film ends": (
            measure_impact(turned, 30), Measured(turned.truth, says=(*late, "– free fit: ", "– finite differences: ")),
        ),
    }  # fmt: skip
    return cases + [Case("contacts", kind, make, judge) for kind, (make, judge) in others.items()]
