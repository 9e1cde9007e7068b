"""Draw what an effect does: a collision with and without it, and the difference of the tracks."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np

from synthcam.camera.pinhole import Lamp, PinholeCamera, project_glint
from synthcam.dataset.preview import mark_picture
from synthcam.dynamics.launch import Launch
from synthcam.effect import Effect
from synthcam.model import Model
from synthcam.scene.film_time import FilmedMotion
from synthcam_shared.arrays import Array
from synthcam_shared.outputs import as_input_error, check_writable, write_atomically

EXAMPLE_LAUNCH = {"time": 0.04, "v0": 0.4, "b": 0.35, "heading": 0.0, "contact": (-0.01, 0.0)}
EXAMPLE_FRAMES, EXAMPLE_FPS = 80, 250.0


def simulate_tracks(model: Model) -> Array:
    """Simulate the tracks of the drawn collision as an experimenter with the nominal camera measures them: mm."""
    radius = model.ball.radius
    nominal = PinholeCamera.overhead(
        (640, 480), 1.6e-4, 0.5, ball_radius=radius, fps=EXAMPLE_FPS, exposure=5e-4, psf_sigma_px=1.0
    )
    camera = model.laws("camera", nominal, {})
    camera = replace(camera, exposure=float(model.laws("exposure", camera.exposure, {"fps": EXAMPLE_FPS})))
    view = FilmedMotion.solve(model, Launch.pair(model.bodies("ab"), **EXAMPLE_LAUNCH), camera, EXAMPLE_FRAMES)  # type: ignore[arg-type]
    pixels = view.mean(view.spans(EXAMPLE_FRAMES), lambda states: camera.project(states[..., :3]))

    def to_glint(pixels: Array, lamp: tuple[float, float, float] = (0.05, 0.0, 0.45)) -> Array:
        centres = view.at(view.spans(EXAMPLE_FRAMES).mean(axis=1))[..., :3]
        glints = project_glint(camera, Lamp(np.array(lamp), 0.01), centres, radius)
        return np.asarray(pixels + glints - camera.project(centres))

    seen = model.laws("measure", pixels, {"glint": to_glint, "mirrored": to_glint}) - nominal.K[:2, 2]
    return np.asarray(1e3 * nominal.scale * seen * [1, -1])


def draw_effect(effect: Effect, path: Path) -> float:
    """Draw the effect on a collision like the paper's. Returns the largest distance between the tracks, um."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    check_writable(path)
    without, with_effect = simulate_tracks(Model()), simulate_tracks(Model(effects=(effect,)))
    difference = 1e3 * (with_effect - without)
    names, colours = ("ball 1, at rest", "ball 2"), ("tab:blue", "tab:red")
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(1, 2)
    halves = [figure.add_subfigure(grid[0, k]) for k in (0, 1)]
    left, right = (half.subplots() for half in halves)
    time = np.arange(EXAMPLE_FRAMES) / EXAMPLE_FPS * 1e3
    for k in (0, 1):
        left.plot(*without[k].T, color="0.6", lw=3, label="without the effect" if k else None)
        left.plot(*with_effect[k].T, color=colours[k], lw=1, label=names[k])
        for axis, style in ((0, "-"), (1, "--")):
            right.plot(time, difference[k, :, axis], style, color=colours[k], lw=1, label=f"{names[k]}, {'xy'[axis]}")
    right.axvline(1e3 * float(EXAMPLE_LAUNCH["time"]), color="0.6", lw=0.8)  # type: ignore[arg-type]
    left.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title="measured tracks")
    right.set(xlabel="time, ms", ylabel="with minus without the effect, µm", title="shift by the effect")
    for half in halves:
        half.legend(fontsize="small", loc="outside lower center", ncols=2)
    values = (f"{p.name} = {getattr(effect, p.name):g} {p.unit}".removesuffix(" 1") for p in effect.parameters())
    figure.suptitle(f"{effect.name()}: {', '.join(values)}")
    drawn = BytesIO()
    kind = path.suffix.lower().lstrip(".") or "png"
    figure.savefig(drawn, format=kind, dpi=120, metadata={"Software": None} if kind == "png" else None)
    with as_input_error(path):
        data = drawn.getvalue()
        write_atomically(path, mark_picture(data, ".png") if kind == "png" else data)
    return float(np.abs(difference).max())
