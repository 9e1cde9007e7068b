"""A solved motion as the library returns it: tables of states and events, and a plot of the paths."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from synthcam.dynamics.contacts.walls import Wall
from synthcam.dynamics.orientation import OrientationHistory
from synthcam.dynamics.trajectory import Trajectory
from synthcam.scene import ground_truth
from synthcam.scene.materials import ScreenColours
from synthcam.scene.table_drawing import DrawnBodies, draw_paths, write_animation
from synthcam_shared.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


@dataclass(frozen=True, repr=False)
class Motion:
    """The exact motion of the balls of one clip.

    Attributes
    ----------
    trajectory : Trajectory
        Its legs and events; ``trajectory.at(t)`` returns arrays (balls, times, 9).
    fps : float
        Frame rate of the clip's camera, 1/s, for events counted in frames.
    radius : tuple of float
        Of the bodies, m.
    walls : tuple of Wall
        Between which they move.
    colours : tuple
        Of the bodies on a screen, as the scene's surface gives them; None of balls of steel.
    orientation : OrientationHistory, optional
        Of discs with a pattern, whose axis an animation shows.

    Examples
    --------
    >>> import synthcam
    >>> launch, timing = {"v0": 0.3, "heading": 0.0}, {"contact_frame": 25}
    >>> motion = synthcam.Scene.read("painter_behringer", launch=launch, timing=timing).draw(seed=1).solve()
    >>> motion
    Motion of 2 balls from 0 to 0.4 s: contact 0.1, slide_end 0.122, slide_end 0.148 s
    >>> motion.at([0.0, 0.1])[["t_s", "particle", "vx", "state"]].round(3)
       t_s  particle     vx  state
    0  0.0         0  0.000   rest
    1  0.1         0  0.275  slide
    2  0.0         1  0.305   roll
    3  0.1         1  0.025  slide
    """

    trajectory: Trajectory
    fps: float
    radius: tuple[float, ...] = ()
    walls: tuple[Wall, ...] = ()
    colours: tuple[ScreenColours | None, ...] = ()
    orientation: OrientationHistory | None = None

    def __repr__(self) -> str:
        balls, events = len(self.trajectory.legs), self.trajectory.events
        happened = ", ".join(f"{e.kind} {e.t:.3g}" for e in events)
        if len(events) > 12:
            counts = Counter(e.kind for e in events)
            happened = ", ".join(f"{n} x {kind}" for kind, n in counts.items()) + f", the last at {events[-1].t:.3g}"
        summary = f": {happened} s" if events else ", without events"
        start, end = self.trajectory.t0, self.trajectory.t1
        return f"Motion of {balls} ball{'s' * (balls > 1)} from {start:g} to {end:g} s{summary}"

    def _repr_html_(self) -> str:
        return f"<p>{self!r}</p>{self.events[['t_s', 'kind', 'i', 'j']].to_html(index=False)}"

    def at(self, t: ArrayLike) -> pd.DataFrame:
        """Compute the states at any times.

        Parameters
        ----------
        t : float or array_like of shape (n,)
            Times from the start of frame 0's exposure, s.

        Returns
        -------
        DataFrame
            A row for each ball and time, ball by ball; at an event, the state just after it. The columns:

            - t_s: time, s
            - particle: 0 is ball 1 (the target), 1 is ball 2 (the striker)
            - x, y, z: centre, m
            - vx, vy, vz: velocity, m/s
            - wx, wy, wz: spin, rad/s
            - state: rest, roll, slide, fly, glide or push

        Raises
        ------
        InputError
            If a time is not a number, or outside the solved interval.
        """
        import pandas as pd  # here alone: slow to load

        try:
            times = np.atleast_1d(np.asarray(t, dtype=float)).ravel()
            states, kinds = self.trajectory.at(times), self.trajectory.motion(times)
        except (ValueError, TypeError) as error:
            raise InputError(f"t: {error}") from None
        balls = len(states)
        columns: dict[str, Any] = {"t_s": np.tile(times, balls), "particle": np.repeat(np.arange(balls), len(times))}
        columns |= dict(zip(ground_truth.STATE_COLUMNS, states.reshape(-1, 9).T, strict=True))
        return pd.DataFrame(columns | {"state": kinds.ravel()})

    @cached_property
    def events(self) -> pd.DataFrame:
        """All events in order of time, with the columns of ``truth/events.parquet``.

        - t_s: time, s; frame_float: the same time in frames
        - kind: contact, contact_end, together, apart, wall, slide_end, stop, start, land, launch, release or stretch
        - i, j: the particles; j is the number of the wall, or -1 for another event of one ball
        - nx, ny: at a contact, the unit vector n from the centre of ball j, or from the wall, to that of ball i
        - impulse_n, impulse_t: impulse on ball i along n, and along z x n, N s
        """
        return ground_truth.make_true_events(self.trajectory, self.fps)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot the paths from above, with the events on them.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw on; default: a new figure.

        Returns
        -------
        Axes
            x and y on the plate, mm, on equal scales.
        """
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(layout="constrained")[1]
        draw_paths(ax, self.trajectory, self.walls, self.colours)
        return ax

    def animate(self, path: str | Path, fps: float = 25.0, slower: float = 1.0) -> None:
        """Write an animation of the bodies from above, with a title that shows the time.

        Parameters
        ----------
        path : str or Path
            A file that ends in .gif or .mp4.
        fps : float
            Frames of the animation per second.
        slower : float
            How many times slower than the motion it plays.

        Raises
        ------
        InputError
            If the file's name ends otherwise, or the animation would have one frame or none.
        """
        bodies = DrawnBodies(np.array(self.radius), self.colours, self.orientation)
        write_animation(Path(path), self.trajectory, bodies, self.walls, fps, slower)
