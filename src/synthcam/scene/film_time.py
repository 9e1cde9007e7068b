"""Film time: which moments of the motion a frame shows if the clock is wrong or the shutter rolls."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.pinhole import PinholeCamera
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import PLATE, solve
from synthcam.dynamics.tabletop import Table
from synthcam.dynamics.trajectory import Trajectory, average_over_spans
from synthcam.model import Model
from synthcam_shared.arrays import Array

# Fixed points are iterated until they change by less than the rounding of a time, s, or at most so often. Each turn
# gains a factor: the time in which a ball crosses a row over the time in which the shutter does.
TURNS_AND_ROUNDING_S = 20, 1e-14


@dataclass(frozen=True)
class FilmedMotion:
    """A motion as a camera films it. On the film's own clock, frame k opens at k/fps."""

    model: Model  # its effects on the clock are applied
    camera: PinholeCamera  # the real one, not the nominal one
    motion: Trajectory  # in true time

    @classmethod
    def solve(cls, model: Model, launch: Launch, camera: PinholeCamera, frames: int, table: Table = PLATE) -> Self:
        """Solve the motion for the duration of `frames` frames."""
        corners = np.array([[0.0], [frames / camera.fps]])
        rows = np.array([0.0, camera.size[1] - 1.0])
        times = np.asarray(model.laws("clock", corners + camera.line_time * rows, {"fps": camera.fps, "row": rows}))
        start, end = min(float(times.min()), 0.0), float(times.max())
        return cls(model, camera, solve(model, launch, start, end, table=table))

    def spans(self, frames: int | range) -> Array:
        """Film time at which each exposure opens and closes: (frames, 2), s. frames: their number, or which."""
        starts = np.array(range(frames) if isinstance(frames, int) else frames) / self.camera.fps
        return np.stack([starts, starts + self.camera.exposure], axis=1)

    @property
    def _has_own_clock(self) -> bool:
        return bool(self.camera.line_time) or self.model.laws.has_effect_on("clock")

    def times(self, film: Array) -> Array:
        """True times (balls, m) at which film times (m,) show each ball, s."""
        out = np.repeat(film[None], len(self.motion.legs), axis=0)
        by_row = self.camera.line_time or self.model.laws.needs("clock", "row")
        turns, rounding = TURNS_AND_ROUNDING_S
        for _ in range(turns if by_row else 1):
            before, out = out, self._clock(film, out)
            if np.abs(out - before).max(initial=0.0) < rounding:
                break
        return out

    def at(self, film: Array) -> Array:
        """States (balls, m, 9) at film times (m,), s."""
        return self.at_own_times(self.times(film))

    def at_own_times(self, times: Array, ask: Callable[[Array], NDArray[Any]] | None = None) -> NDArray[Any]:
        """States (balls, m, 9) of each ball at true times of its own (balls, m), s, as of `times`.

        ask: maps times (m,) to something else of all balls (balls, m, ...).
        """
        ask = ask or self.motion.at
        if not self._has_own_clock:  # one question instead of one for each ball
            return ask(times[0])
        return np.stack([ask(t)[k] for k, t in enumerate(times)])

    def breaks(self) -> Array:
        """Film times of all events, rising, s."""
        out, (turns, rounding) = [], TURNS_AND_ROUNDING_S
        balls_of = ((e, {e.i} if e.kind == "wall" else {e.i, e.j} - {-1}) for e in self.motion.events)
        pairs = [(event, ball) for event, balls in balls_of for ball in balls]
        if not self._has_own_clock:
            return np.sort(np.array([event.t for event, _ in pairs]))
        for event, ball in pairs:
            film = event.t
            for _ in range(turns):
                late = event.t - float(self.times(np.array([film]))[ball, 0])
                film += late
                if abs(late) < rounding:
                    break
            out.append(film)
        return np.sort(np.array(out))

    def mean(self, spans: Array, of: Callable[[Array], Array]) -> Array:
        """Average a function of the states over spans of film time (n, 2): (balls, n, k)."""
        return average_over_spans(self.at, self.breaks(), spans, of)

    def _clock(self, film: Array, times: Array) -> Array:
        if not self._has_own_clock:
            return times
        states = self.at_own_times(np.clip(times, self.motion.t0, self.motion.t1))
        rows = np.clip(self.camera.project(states[..., :3])[..., 1], 0, self.camera.size[1] - 1)
        bent = self.model.laws("clock", film + self.camera.line_time * rows, {"fps": self.camera.fps, "row": rows})
        return np.asarray(np.clip(bent, self.motion.t0, self.motion.t1))
