"""Draws a tabletop from above: walls, paths and events, and an animation of the bodies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from synthcam.dynamics.contacts.walls import Rim, StraightWall, Wall
from synthcam.dynamics.orientation import OrientationHistory
from synthcam.dynamics.trajectory import Trajectory
from synthcam.scene.materials import ScreenColours
from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TWO_BALLS = ("#2166ac", "#b2182b")
Colours = Sequence[ScreenColours | None]


class DrawnBodies(NamedTuple):
    """What an animation shows of bodies."""

    radius: Array  # (N,), m
    colours: Colours = ()  # of matte bodies
    orientation: OrientationHistory | None = None  # of discs with a pattern


def choose_colours(count: int, own: Colours = ()) -> list[Any]:
    """Choose the colours of the bodies, main and second, in the drawing of a table.

    Bodies that have colours of their own keep them. Others get one that distinguishes them, and black.
    """
    usual: list[Any] = list(TWO_BALLS[:count])
    if count > len(TWO_BALLS):
        from matplotlib import colormaps

        usual = list(colormaps["tab20"](np.arange(count) % 20))
    return [
        (theirs.main, theirs.second or "k") if theirs else (other, "k")
        for theirs, other in zip(own or [None] * count, usual, strict=True)
    ]


def draw_walls(ax: Axes, walls: Sequence[Wall]) -> None:
    """Draw walls in mm."""
    angle = np.linspace(0, 2 * np.pi, 181)
    for wall in walls:
        if isinstance(wall, StraightWall):
            x, y = np.array([wall.start, wall.end]).T
        elif isinstance(wall, Rim):
            x, y = (wall.centre[k] + wall.radius * f(angle) for k, f in enumerate((np.cos, np.sin)))
        else:
            continue
        ax.plot(1e3 * x, 1e3 * y, color="0.35", lw=1.5, zorder=0)


def draw_paths(ax: Axes, motion: Trajectory, walls: Sequence[Wall], colours: Colours = ()) -> None:
    """Draw the paths of all bodies, the walls, and the events unless they are too many, in mm.

    Bodies with a pattern have paths in its colour. Matte bodies that all look the same get colours that distinguish
    them.
    """
    max_marked_events, max_legend_bodies = 60, 6  # more would hide the paths
    from matplotlib.patheffects import withStroke

    breaks = [e.t for e in motion.events]
    times = np.unique(np.concatenate([np.linspace(motion.t0, motion.t1, 400), np.clip(breaks, motion.t0, motion.t1)]))
    places, own = 1e3 * motion.at(times)[..., :2], colours if len(set(colours)) > 1 else ()
    shown = choose_colours(len(motion.legs), own)
    draw_walls(ax, walls)
    few = len(places) <= max_legend_bodies
    for ball, (path, (main, second)) in enumerate(zip(places, shown, strict=True)):
        edge: dict[str, Any] = {"path_effects": [withStroke(linewidth=2.2, foreground="0.4")]} if own else {}
        colour = main if second == "k" else second
        ax.plot(*path.T, color=colour, label=f"ball {ball + 1}" if few else None, zorder=1, **edge)
        if len(places) > len(TWO_BALLS):
            ax.plot(*path[-1], "o", mfc=main, mec=second if own else main, ms=4, zorder=2)
    pair_marks = {"contact": "k*", "together": "kD", "apart": "kd"}
    ball_marks = {"slide_end": "o", "stop": "s", "start": "^", "land": "v", "launch": ">", "release": "<"}
    marks = pair_marks | {"wall": "kx"} | ball_marks
    marked = [e for e in motion.events if e.kind in marks]
    for event in marked if len(marked) <= max_marked_events else ():
        label, at = event.kind.replace("_", " "), np.searchsorted(times, event.t)
        for ball in {event.i, event.j if event.kind in pair_marks else event.i} - {-1}:
            known = ax.get_legend_handles_labels()[1]
            alone = event.kind in ball_marks
            style: dict[str, Any] = {"color": shown[ball][0], "mfc": "white"} if alone else {}
            mark = marks[event.kind]
            ax.plot(*places[ball, at], mark, label=None if label in known else label, ms=6, zorder=2, **style)
    ax.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    if ax.get_legend_handles_labels()[1]:
        beside: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0)} if walls else {}
        ax.legend(fontsize="small", **beside)


def write_animation(
    path: Path, motion: Trajectory, bodies: DrawnBodies, walls: Sequence[Wall], fps: float, slower: float
) -> None:
    """Write a drawn table as an animation, .gif or .mp4. Raises InputError for another ending, or one frame or none."""
    import imageio.v3 as iio

    if path.suffix.lower() not in (".gif", ".mp4"):
        raise InputError(f"{path}: expected a name that ends in .gif or .mp4")
    if not (fps > 0 and slower > 0):
        raise InputError(f"fps {fps:g} and slower {slower:g}: expected numbers over 0")
    count = int((motion.t1 - motion.t0) * slower * fps) + 1
    if count < 2:
        wanted = f"expected a larger fps or slower for a motion of {motion.t1 - motion.t0:g} s"
        raise InputError(f"{path}: {count} frame; {wanted}")
    frames = list(_draw_frames(motion, bodies, walls, np.linspace(motion.t0, motion.t1, count)))
    if path.suffix.lower() == ".gif":
        iio.imwrite(path, frames, duration=1000 / fps, loop=0)
    else:
        iio.imwrite(path, frames, plugin="pyav", codec="mpeg4", fps=fps)


def _draw_frames(
    motion: Trajectory, bodies: DrawnBodies, walls: Sequence[Wall], times: Array
) -> Iterator[NDArray[np.uint8]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection, PatchCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    figure = Figure(figsize=(6.4, 4.8), dpi=100, layout="constrained")
    canvas, ax = FigureCanvasAgg(figure), figure.subplots()
    draw_walls(ax, walls)
    places, size = 1e3 * motion.at(times)[..., :2], 1e3 * np.asarray(bodies.radius)
    ax.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    if not walls:
        low, high = (places + sign * size.max() * 1.5 for sign in (-1, 1))
        ax.set(xlim=(low[..., 0].min(), high[..., 0].max()), ylim=(low[..., 1].min(), high[..., 1].max()))
    colours = choose_colours(len(size), bodies.colours)
    main, second = zip(*colours, strict=True)
    circles = PatchCollection([Circle((0, 0), r) for r in size], facecolors=main, edgecolors=second, linewidths=1.5)
    axes = LineCollection([], colors=second, linewidths=1)
    reach = np.zeros_like(places)  # from the centre of each body to its rim, along the axis of its pattern
    if history := bodies.orientation:
        turned = np.array([history.at(k, times).apply([0.0, 0.0, 1.0])[:, :2] for k in range(len(size))])
        reach = size[:, None, None] * turned
    ax.add_collection(circles, autolim=False)
    ax.add_collection(axes, autolim=False)
    title = ax.set_title(f"{times[0]:.3f} s", fontsize="medium")
    canvas.draw()  # type: ignore[no-untyped-call]
    figure.set_layout_engine("none")  # all frames have the layout of the first
    for artist in (circles, axes, title):
        artist.set_animated(True)
    canvas.draw()  # type: ignore[no-untyped-call]
    background = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    for k, t in enumerate(times):
        circles.set_paths([Circle(tuple(xy), r) for xy, r in zip(places[:, k], size, strict=True)])
        axes.set_segments(list(np.stack([places[:, k], places[:, k] + reach[:, k]], axis=1)))
        title.set_text(f"{t:.3f} s")
        canvas.restore_region(background)  # type: ignore[no-untyped-call]
        for artist in (circles, axes, title):
            ax.draw_artist(artist)
        yield np.array(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
