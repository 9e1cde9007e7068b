"""Figures of a measured collision: a frame, tracks, separation, residuals, energy, speed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from synthcam_shared.arrays import Array
from synthcam_shared.report.page import make_axes
from tracker.measurement.collision.adequacy import MEASURED
from tracker.measurement.collision.collision_model import mean_positions, tied_to_free
from tracker.measurement.painter_behringer import BEFORE, make_motion_table
from tracker.measurement.positions import BallTrack, to_ball_tracks

if TYPE_CHECKING:
    from tracker.camera.camera import Camera
    from tracker.detection.link import Tracks


MAX_PARTICLES_IN_LEGEND = 12
STYLE = {1: ("#c1440e", "o", "ball 1 (struck)"), 2: ("#14508c", "s", "ball 2 (striker)")}


@dataclass(frozen=True)
class CollisionView:
    """One measured collision: its row of estimates, the tracks of struck ball (1) and striker (2), the camera."""

    row: pd.Series
    balls: dict[int, BallTrack]
    camera: Camera

    @classmethod
    def of(cls, row: pd.Series, tracks: Tracks, camera: Camera) -> CollisionView:
        """Choose the tracks of the two balls that a row of estimates names."""
        track = {one.particle: one for one in to_ball_tracks(tracks, camera)}
        return cls(row, {k: track[int(row[f"particle{k}"])] for k in (1, 2)}, camera)

    @property
    def parameters(self) -> Array:
        """Parameters of the tied fit, (16,); NaN among them if it has no such values."""
        r = self.row
        beta = np.arcsin(r["b"]) if abs(r["b"]) <= 1 else np.nan  # an average over fits of a misfit may be beyond 1
        launch = [r["t_c"], r["x1"], r["y1"], r["heading"], beta, r["v0"], r["drag"], r["decel"]]
        log_mu_k = np.log(r["mu_k"]) if r["mu_k"] > 0 else np.nan  # or negative
        return np.array([*launch, r["r"], log_mu_k, r["C"], *(r[k] for k in BEFORE)], dtype=np.float64)

    @property
    def is_instantaneous(self) -> bool:
        """True if `predict` holds: a contact that lasts shifts the paths after it by what its row does not have."""
        return bool(self.row.get("contact_first", -1) < 0)

    def predict(self, ball: int, start: Array) -> Array:
        """Predict positions (n, 2) m by the tied fit, averaged over exposures that begin at start (n,) s."""
        free = np.asarray(tied_to_free(self.parameters), dtype=np.float64)
        return mean_positions(free, ball, start, self.camera.exposure, self.camera.ball_diameter)[0]


def view_collision(row: Mapping[str, Any], tracks: Tracks, camera: Camera) -> CollisionView | None:
    """Prepare the figures of a collision with the tracks of its balls; None where the tied fit lacks a parameter."""
    if row["status"] not in MEASURED:
        return None
    view = CollisionView.of(pd.Series(row), tracks, camera)
    return view if np.isfinite(view.parameters).all() else None


def list_residuals(views: Iterable[CollisionView | None]) -> dict[tuple[int, int], tuple[float, float]]:
    """List the residuals that the figures show, by particle and frame: measured position minus tied fit, m."""
    residuals: dict[tuple[int, int], tuple[float, float]] = {}
    for view in views:
        for ball, track in view.balls.items() if view is not None and view.is_instantaneous else ():
            off = track.position - view.predict(ball, track.start)  # type: ignore[union-attr]
            for frame, (x, y) in zip(track.frame.tolist(), off.tolist(), strict=True):
                residuals.setdefault((track.particle, frame), (x, y))
    return residuals


def draw_frame(image: Array, spots: pd.DataFrame, frame: int, camera: Camera) -> Figure:
    """Draw the figure of a collision's frame with its detections, and the balls enlarged.

    image: counts (h, w); spots: the rows of tracks.parquet at that frame.
    """
    figure = Figure(figsize=(9.2, 3.9), layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=[1.55, 1])
    whole, close = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    radius = camera.diameter_px / 2
    top = float(image.max()) or 1.0
    centre, glint = spots[["x", "y"]].to_numpy(float), spots[["glint_x", "glint_y"]].to_numpy(float)
    left, low = middle = centre.mean(axis=0)
    reach = max(2.2 * radius, float(np.ptp(centre, axis=0).max()) / 2 + 1.6 * radius)
    for axes, root in ((whole, 0.7), (close, 0.5)):
        axes.imshow((image / top).clip(0, 1) ** root, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        for x, y in centre:
            axes.add_patch(Circle((x, y), radius, fill=False, ec="#4db8ff", lw=0.9))
        axes.set(xlabel="x / px", ylabel="y / px")
    if not any("glint" in str(flags).split("|") for flags in spots["flags"]):
        close.plot(*centre.T, "+", color="#ffb000", ms=11, mew=1.3, label="measured centre of the ball")
    close.plot(*glint.T, "x", color="#ff4f81", ms=6, mew=1.1, label="glint")
    close.set(xlim=(left - reach, left + reach), ylim=(low + reach, low - reach))
    whole.add_patch(Rectangle(tuple(middle - reach), 2 * reach, 2 * reach, fill=False, ec="0.6", lw=0.8, ls=":"))
    whole.set_title(f"frame {frame}: detections and outlines of the balls", fontsize=9)
    close.set_title("enlarged, with stretched grey levels", fontsize=9)
    close.legend(loc="lower right", fontsize=8, framealpha=0.85)
    return figure


def draw_tracks(view: CollisionView) -> Figure:
    """Draw both tracks with a mark every 0.02 s, and the collision enlarged (figure 2 of the paper)."""
    figure, (axes, inset) = make_axes(1, 2, figsize=(8.2, 4.4), width_ratios=[1.5, 1])
    every = max(round(0.02 * view.camera.fps), 1)
    radius, t_c = view.camera.ball_diameter * 500, view.row["t_c"]
    contact = {}
    for ball, course in view.balls.items():
        colour, mark, label = STYLE[ball]
        position = course.position * 1e3
        for where in (axes, inset):
            where.plot(*position.T, "-", color=colour, lw=0.8)
        rows = course.frame % every == 0
        label = f"{label}, every {every / view.camera.fps:g} s"
        axes.plot(*position[rows].T, mark, color=colour, ms=4.5, mfc="white", label=label)
        inset.plot(*position.T, mark, color=colour, ms=3.2, mfc="white", label="every frame")
        contact[ball] = view.predict(ball, np.array([t_c - view.camera.exposure / 2]))[0] * 1e3
        inset.add_patch(Circle(tuple(contact[ball]), radius, fill=False, ec=colour, lw=1))
    middle = (contact[1] + contact[2]) / 2
    inset.set(xlim=middle[0] + np.array([-3, 3]) * radius, ylim=middle[1] + np.array([-3, 3]) * radius)
    inset.set_title("every frame; outlines of the balls at $t_c$", fontsize=9)
    for where in (axes, inset):
        where.set_aspect("equal", adjustable="datalim" if where is axes else "box")
        where.set(xlabel="x / mm", ylabel="y / mm")
    axes.legend(fontsize=8, loc="best")
    return figure


def draw_separation(view: CollisionView) -> Figure:
    """Draw the separation of the centres and its residuals against time (figure 3 of the paper)."""
    figure, (axes, rest) = make_axes(2, 1, figsize=(8.2, 4.6), sharex=True, height_ratios=[2.2, 1])
    one, two = view.balls[1], view.balls[2]
    _, i, j = np.intersect1d(one.frame, two.frame, return_indices=True)
    along = one.position[i] - two.position[j]
    apart = np.hypot(*along.T)
    unit = along / apart[:, None]
    variance = np.einsum("ni,nij,nj->n", unit, one.cov[i] + two.cov[j], unit)
    fitted = np.hypot(*(view.predict(1, one.start[i]) - view.predict(2, two.start[j])).T)
    time = one.time[i]
    axes.plot(time * 1e3, apart * 1e3, "o", color=STYLE[2][0], ms=3.2, mfc="white", label="measured")
    fine = np.linspace(time[0], time[-1], 800)
    smooth = np.hypot(*(view.predict(1, fine) - view.predict(2, fine)).T)
    axes.plot(fine * 1e3, smooth * 1e3, "-", color="0.25", lw=0.9, label="tied fit")
    axes.axhline(view.camera.ball_diameter * 1e3, color="0.6", lw=0.8, ls="--", label="ball diameter")
    axes.set_ylabel("separation / mm")
    rest.errorbar(
        time * 1e3, (apart - fitted) * 1e6, np.sqrt(variance) * 1e6, fmt="o", color=STYLE[2][0], ms=2.5, lw=0.7
    )
    rest.axhline(0, color="0.25", lw=0.8)
    rest.set(xlabel="time / ms", ylabel="residual / µm")
    _mark_times((axes, rest), view)
    axes.legend(fontsize=8, loc="best")
    return figure


def draw_energy(view: CollisionView, tracks: Tracks) -> Figure:
    """Draw the figure of a collision's energy of translation, with the tied fit and the loss in the impact."""
    figure, axes = make_axes(figsize=(8.2, 3.6))
    row = view.row
    whole = row["v0"] ** 2 / 2
    table = make_motion_table(tracks, view.camera, {str(key): value for key, value in row.items()})
    total: pd.Series | None = None
    for ball in (1, 2):
        colour, mark, label = STYLE[ball]
        mine = table[table["particle"] == row[f"particle{ball}"]].set_index("t_s")["energy"] / whole
        axes.plot(mine.index * 1e3, mine, mark, color=colour, ms=2.8, mfc="white", lw=0.6, ls="-", label=label)
        total = mine if total is None else total.add(mine).dropna()
    assert total is not None
    axes.plot(total.index * 1e3, total, "D", color="0.1", ms=2.8, ls="-", lw=0.8, label="both")
    after = row["t_c"] * 1e3, float(total.index.max()) * 1e3
    axes.hlines(
        1 - (1 - row["r"] ** 2) / 2, *after, color="0.4", ls="--", lw=0.9, label="$1-(1-r^2)/2$: after the impact"
    )
    axes.hlines(row["energy_fraction"], *after, color="0.4", ls=":", lw=1.2, label="tied fit, once both roll")
    _mark_times((axes,), view)
    axes.set(xlabel="time / ms", ylabel="translational energy / $m v_0^2/2$", ylim=(-0.05, 1.15))
    axes.legend(fontsize=8, loc="center right", bbox_to_anchor=(1.0, 0.61), ncols=2)
    return figure


def _mark_times(panels: tuple[Axes, ...], view: CollisionView) -> None:
    t_c = float(view.row["t_c"])
    for axes in panels:
        axes.axvline(t_c * 1e3, color="0.3", lw=0.8, ls=":")
        for ball in (1, 2):
            axes.axvline((t_c + float(view.row[f"tau{ball}"])) * 1e3, color=STYLE[ball][0], lw=0.8, ls=":")
    marks = [(t_c, "$t_c$")] + [(t_c + float(view.row[f"tau{k}"]), rf"$t_c+\tau_{k}$") for k in (1, 2)]
    for line, (x, label) in enumerate(marks, start=1):  # one below the other: the slides' ends may be close
        at, shift = (x * 1e3, 1.0), (2, -11 * line)
        panels[0].annotate(
            label, at, xycoords=("data", "axes fraction"), xytext=shift, textcoords="offset points", fontsize=8
        )


def draw_residuals(view: CollisionView) -> Figure:
    """Draw the residuals of a collision, position minus tied fit, for each ball and axis, with standard errors."""
    figure, panels = make_axes(2, 1, figsize=(8.2, 4.2), sharex=True, sharey=True)
    for axes, (ball, course) in zip(panels, sorted(view.balls.items()), strict=True):
        off = (course.position - view.predict(ball, course.start)) * 1e6
        for axis, (name, mark, colour) in enumerate((("x", "o", "#14508c"), ("y", "s", "#c1440e"))):
            error = np.sqrt(course.cov[:, axis, axis]) * 1e6
            axes.errorbar(
                course.time * 1e3, off[:, axis], error, fmt=mark, ms=2.6, lw=0.7, color=colour, mfc="white", label=name
            )
        axes.axhline(0, color="0.25", lw=0.8)
        axes.set_ylabel("residual / µm")
        axes.set_title(STYLE[ball][2], fontsize=9)
    panels[0].legend(fontsize=8)
    panels[1].set_xlabel("time / ms")
    _mark_times(tuple(panels), view)
    return figure


def draw_speeds(motion: pd.DataFrame, contacts: Sequence[float]) -> Figure:
    """Draw the figure of the speed of each ball by differences of neighbouring frames; contacts: times, s."""
    figure, axes = make_axes(figsize=(8.2, 3.4))
    for particle, rows in motion.groupby("particle"):
        speed = np.hypot(rows["vx"], rows["vy"])
        axes.plot(rows["t_s"] * 1e3, speed * 100, ".-", ms=3, lw=0.7, label=f"particle {particle}")
    for k, contact in enumerate(contacts):
        axes.axvline(contact * 1e3, color="0.3", lw=0.8, ls=":", label="contact" if k == 0 else None)
    axes.set(xlabel="time / ms", ylabel="speed / (cm/s)")
    if 0 < motion["particle"].nunique() <= MAX_PARTICLES_IN_LEGEND:  # a longer one is higher than the figure
        axes.legend(fontsize=8)
    return figure


def draw_all_tracks(tracks: Tracks, camera: Camera) -> Figure:
    """Draw all tracks of a film in the picture, px."""
    figure, axes = make_axes(figsize=(8.2, 4.2))
    for particle in np.unique(tracks.particle):
        rows = tracks.particle == particle
        axes.plot(*tracks.xy[rows].T, ".-", ms=3, lw=0.7, label=f"particle {particle}")
    width, height = camera.size
    axes.set(xlabel="x / px", ylabel="y / px", xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    if 0 < len(np.unique(tracks.particle)) <= MAX_PARTICLES_IN_LEGEND:
        axes.legend(fontsize=8)
    return figure
