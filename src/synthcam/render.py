"""A film of rolling mirror balls: bodies drawn by pyrender, the lamp's images added in closed form.

The only importer of pyrender, trimesh and PyOpenGL. The bodies are ray-traced by our own shader into one
float32 channel, without the lamp: its image is far under a pixel, and `picture` integrates it exactly.
"""

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from synthcam.optics import Camera, Lamp
from synthcam.picture import (
    STEEL,
    Array,
    Glints,
    Moments,
    Patches,
    Picture,
    blur_matrix,
    find_glints,
    merge,
    pieces,
    reach,
    sample,
    spots,
)

# Read when the libraries load. Rasterising in the calling thread leaves the other cores to worker processes.
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")
_missing = ""
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import pyrender
        import trimesh
        from OpenGL import GL
except Exception as error:  # PyOpenGL raises whatever its loader happens to trip over
    pyrender = None
    _missing = " ".join(str(error).split()) or type(error).__name__

Float32 = NDArray[np.float32]
Index = NDArray[np.intp]
Centres = Callable[[Array], Array]

PLATE = 0.05  # radiance of the black plate under the lamp, over that of the room seen in a ball
FINENESS = 3  # body samples a pixel, each way
SIDE = 1024  # usual side of the buffer, samples
BATCH = 64  # exposures gathered at a time
MOST = 2048  # bodies in one draw call


class NoGL(RuntimeError):
    """OpenGL cannot draw off-screen here; the message says in one line why and what would help."""


class _Renderer(pyrender.Renderer if pyrender else object):  # type: ignore[misc]
    """pyrender's renderer with a float32 buffer, our shaders and bodies that add up where they overlap."""

    def __init__(self) -> None:
        super().__init__(SIDE, SIDE)
        shaders = Path(__file__).with_name("shaders")
        self._program_cache = pyrender.shader_program.ShaderProgramCache(shader_dir=str(shaders))
        self.uniforms: dict[str, Any] = {}
        self.jobs = np.zeros((0, 4, 4), np.float32)
        self.rows = SIDE
        self._others: Any = None
        self._main_fb: Any
        self._main_fb_dims: tuple[int, int]

    def _configure_main_framebuffer(self) -> None:
        size = (self.viewport_width, self.viewport_height)
        if self._main_fb is not None and self._main_fb_dims != size:
            self._delete_main_framebuffer()
        if self._main_fb is None:
            self._main_cb = self._main_cb_ms = GL.glGenRenderbuffers(1)
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, self._main_cb)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_R32F, *size)
            self._main_fb = self._main_fb_ms = GL.glGenFramebuffers(1)
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._main_fb)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, GL.GL_COLOR_ATTACHMENT0, GL.GL_RENDERBUFFER, self._main_cb)
            self._main_fb_dims = size

    def _bind_lighting(self, scene: Any, program: Any, node: Any, flags: int) -> None:
        for name, value in self.uniforms.items():
            program.set_uniform(name, value)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._others)

    def _bind_and_draw_primitive(self, primitive: Any, pose: Any, program: Any, flags: int) -> None:
        primitive._bind()
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, primitive._buffers[1])  # pyrender's instance matrices
        GL.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, self.jobs.nbytes, self.jobs)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glDisable(GL.GL_DEPTH_TEST)
        GL.glEnable(GL.GL_BLEND)
        GL.glBlendFunc(GL.GL_ONE, GL.GL_ONE)
        count = primitive.indices.size
        GL.glDrawElementsInstanced(primitive.mode, count, GL.GL_UNSIGNED_INT, None, len(self.jobs))
        primitive._unbind()

    def _read_main_framebuffer(self, scene: Any, flags: int) -> Float32:
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb)
        read = GL.glReadPixels(0, 0, self.viewport_width, self.rows, GL.GL_RED, GL.GL_FLOAT)
        return np.frombuffer(read, np.float32).reshape(self.rows, self.viewport_width)

    def load_others(self, others: Float32) -> None:
        """Neighbours (n, k, 4) of each body, read by the shader as the rows of a texture."""
        if self._others is None:
            self._others = GL.glGenTextures(1)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._others)
        for setting in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
            GL.glTexParameteri(GL.GL_TEXTURE_2D, setting, GL.GL_NEAREST)
        rows, columns = others.shape[:2]
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGBA32F, columns, rows, 0, GL.GL_RGBA, GL.GL_FLOAT, others)


class _Canvas:
    """The process's one OpenGL context with its scene: a quad, drawn once for every body."""

    def __init__(self) -> None:
        if pyrender is None:
            raise NoGL(_no_gl(_missing))
        try:
            self._screen = pyrender.OffscreenRenderer(SIDE, SIDE)
            self._screen._renderer = self._renderer = _Renderer()
            self.info = {
                name.lower(): GL.glGetString(getattr(GL, f"GL_{name}")).decode()
                for name in ("RENDERER", "VERSION", "VENDOR")
            }
        except Exception as error:
            raise NoGL(_no_gl(" ".join(str(error).split()) or type(error).__name__)) from error
        self.info["platform"] = os.environ["PYOPENGL_PLATFORM"]
        quad = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        room_for_jobs = np.zeros((MOST, 4, 4), np.float32)
        self._scene = pyrender.Scene(bg_color=np.zeros(4))
        self._scene.add(pyrender.Mesh.from_trimesh(quad, poses=room_for_jobs))
        self._scene.add(pyrender.IntrinsicsCamera(1, 1, 0, 0))  # pyrender asks for one; the shader does not

    def draw(self, jobs: Float32, others: Float32, size: tuple[int, int], uniforms: dict[str, Any]) -> Float32:
        """Buffer (rows, columns) of that size after all jobs (n, 4, 4) with their neighbours (n, k, 4)."""
        total: Float32 | None = None
        screen = self._screen
        screen.viewport_height, screen.viewport_width = max(SIDE, size[0]), max(SIDE, size[1])
        self._renderer.rows = size[0]
        columns = screen.viewport_width
        self._renderer.uniforms = uniforms | {"atlas": np.array([columns, screen.viewport_height], float)}
        self._renderer.uniforms["others"] = 0
        for first in range(0, len(jobs), MOST):
            batch = slice(first, first + MOST)
            jobs[batch, 3, 2] = np.arange(len(jobs[batch]))
            self._renderer.jobs = np.ascontiguousarray(jobs[batch])
            screen._platform.make_current()
            self._renderer.load_others(np.ascontiguousarray(others[batch]))
            drawn = screen.render(self._scene)
            total = drawn if total is None else total + drawn
        assert total is not None
        return total[:, : size[1]]


_canvas: tuple[int, _Canvas] | None = None


def _shared_canvas() -> _Canvas:
    """A second context in one process, or one carried over a fork, crashes some drivers."""
    global _canvas
    if _canvas is None:
        _canvas = (os.getpid(), _Canvas())
    if _canvas[0] != os.getpid():
        raise NoGL("OpenGL was started before this process was forked: start workers by spawn instead")
    return _canvas[1]


def _no_gl(why: str) -> str:
    return (
        f"no off-screen OpenGL ({os.environ.get('PYOPENGL_PLATFORM')}): {why}; "
        "Mesa's software renderer is enough (Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri)"
    )


def gl_info() -> dict[str, str]:
    """Renderer, version, vendor and platform of the OpenGL in use. Raises NoGL where there is none."""
    return dict(_shared_canvas().info)


class Film:
    """The view of one camera on a black plate under one lamp, with any number of steel balls.

    camera, lamp: as in `optics`. radii: m, one a ball. room: radiance of the dim surroundings, such that a
    ball shows it at its top at `room` times its glint's peak; it fades to the plate's towards the horizon.
    Raises NoGL without OpenGL, ValueError where the lamp stands in view or its image is not small against
    the optics' blur, or where the lens bends too strongly within one ball.
    """

    def __init__(self, camera: Camera, lamp: Lamp, radii: Sequence[float], room: float = 0.02) -> None:
        self._canvas = _shared_canvas()
        self.camera, self.lamp, self.room = camera, lamp, room
        self.radii = np.array(radii, float)
        if not (len(self.radii) and np.all(self.radii > 0)):
            raise ValueError(f"radii: expected at least one ball, all larger than 0, got {self.radii.tolist()}")
        self._check_lamp()
        self._check_lens()
        rest = np.array([[[0, 0, self.radii[0]]]])
        primary = find_glints(camera, lamp, rest, self.radii[:1], np.ones((1, 1), bool))
        spread = primary.spread + camera.psf_sigma_px**2
        rows, columns = spots(np.zeros((1, 2)), spread, np.zeros((1, 2)), 1)
        self._unit = float(1 / (primary.flux * rows[0, 0] * columns[0, 0])[0])
        radius = 2 * np.sqrt(primary.spread.max())
        if radius > camera.psf_sigma_px:
            raise ValueError(
                f"lamp radius {lamp.radius} m: its image in a ball has a radius of {radius:.2g} px, "
                f"which must be under the blur's sigma, {camera.psf_sigma_px:g} px"
            )
        self._uniforms = {
            "up": camera.R[:, 2].copy(),
            "zenith": float(room / STEEL),
            "steel": float(STEEL),
            "lamp": np.zeros(3),
        }
        self.plate = self._draw_plate()
        self.plate.flags.writeable = False

    def __enter__(self) -> "Film":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Nothing to free: the OpenGL context belongs to the process."""

    def _check_lamp(self) -> None:
        w, h = self.camera.size
        at = self.camera.project(self.lamp.position)
        if np.all((at > -0.5) & (at < [w - 0.5, h - 0.5])):
            where = self.lamp.position.tolist()
            raise ValueError(f"lamp position {where} stands between the camera and the plate")

    def _check_lens(self) -> None:
        """Within a ball the lens is taken as linear: its curvature there must be far under a sample."""
        camera, radius = self.camera, self.radii.max()
        if not camera.dist.any():
            return
        w, h = np.array(camera.size)
        columns, rows = np.meshgrid(np.linspace(-0.1, 1.1, 25) * w, np.linspace(-0.1, 1.1, 25) * h)
        flat = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3) @ np.linalg.inv(camera.K).T
        seen = flat * np.linalg.norm(camera.centre)
        middle, slope = camera.project_with_slope((seen - camera.t) @ camera.R)
        inside = np.all((middle > -0.1 * w) & (middle < [1.1 * w, 1.1 * h]), axis=1)
        bend = 0.0
        for side in radius * np.array([[1, 0, 0], [0, 1, 0], [0.7, 0.7, 0], [0.7, -0.7, 0]]):
            curved = camera.project((seen + side - camera.t) @ camera.R) - middle - slope @ (camera.R.T @ side)
            bend = max(bend, float(np.linalg.norm(curved[inside], axis=1).max(initial=0)))
        if bend > 0.05:
            raise ValueError(
                f"camera distortion {camera.dist.tolist()} bends a ball's outline by {bend:.2g} px, more than 0.05"
            )

    def _draw_plate(self) -> Float32:
        w, h = self.camera.size
        unit = self.lamp.position[2]
        jobs = self._jobs(np.zeros((1, 3)), np.array([unit]), fineness=1)
        middle = self.camera.project(np.zeros(3)) + 0.5
        jobs[0, 0, 2:] = middle
        jobs[0, 3] = -1, np.maximum(middle, [w, h] - middle).max() + 1, 0, PLATE * self.room
        uniforms = self._uniforms | {"lamp": self.camera.R @ self.lamp.position / unit}
        return self._canvas.draw(jobs, np.zeros((1, 1, 4), np.float32), (h, w), uniforms).copy()

    def _jobs(self, centres: Array, radii: Array, fineness: int) -> Float32:
        """Instance matrices (n, 4, 4) for bodies (n, 3), (n,), place and neighbours still to be filled in."""
        camera = self.camera
        slope = camera.project_with_slope(centres)[1] @ camera.R.T
        jobs = np.zeros((len(centres), 4, 4), np.float32)
        maps = np.linalg.inv(slope[:, :, :2]) / (fineness * radii[:, None, None])
        jobs[:, 1] = np.swapaxes(maps, 1, 2).reshape(-1, 4)
        jobs[:, 2, :3] = (camera.centre - centres) @ camera.R.T / radii[:, None]
        jobs[:, 2, 3] = 1
        to_lamp = self.lamp.position - centres * [1, 1, 0]
        # Lambert's plate under a small lamp facing down: cos^4 of the angle.
        fall = (self.lamp.position[2] / np.linalg.norm(to_lamp, axis=1)) ** 4
        jobs[:, 3, 3] = PLATE * self.room * fall
        return jobs

    def frames(self, centres: Centres, intervals: ArrayLike, breaks: ArrayLike = ()) -> Iterator[Picture]:
        """Mean pictures over exposures; each depends on its own exposure only.

        centres: times (T,), s -> ball centres (T, N, 3), m. intervals: (F, 2) start and end of each exposure,
        s; they may be of zero length. breaks: times at which velocities jump; exposures are split there.
        """
        spans, cuts = np.asarray(intervals, float).reshape(-1, 2), np.sort(np.asarray(breaks, float))
        if (spans[:, 1] < spans[:, 0]).any():
            raise ValueError("intervals: an exposure ends before it starts")
        for first in range(0, len(spans), BATCH):
            yield from self._gather(centres, spans[first : first + BATCH], cuts)

    def _gather(self, centres: Centres, spans: Array, cuts: Array) -> Iterator[Picture]:
        moments, coarse = self._moments(centres, spans, cuts)
        places = np.asarray(centres(moments.times), float)
        pixels, slope = self.camera.project_with_slope(places)
        extent = reach(self.camera, places, self.radii, slope)
        patches = Patches(self.camera, moments, pixels, extent, len(spans))
        glints = find_glints(self.camera, self.lamp, places, self.radii, patches.number[moments.frames] >= 0)
        drawn: dict[int, Float32] = {}
        for width in np.unique(patches.widths):
            same = np.flatnonzero(patches.widths == width)
            tile = (width - 2 * patches.margin) * FINENESS
            room_for = max(1, SIDE // tile) ** 2
            for first in range(0, len(same), room_for):
                alike = same[first : first + room_for]
                bodies = self._bodies(centres, coarse, patches, alike)
                self._add_glints(bodies, glints, moments, patches, alike)
                drawn |= zip(alike.tolist(), bodies, strict=True)
        for frame in range(len(spans)):
            image, boxes = self.plate.copy(), []
            for number in patches.number[frame][patches.number[frame] >= 0].tolist():
                box = top, bottom, left, right = patches.box(number, self.camera.size)
                x, y = patches.origins[number]
                image[top:bottom, left:right] += drawn[number][top - y : bottom - y, left - x : right - x]
                boxes.append(box)
            yield Picture(image, self.plate, merge(boxes))

    def _moments(self, centres: Centres, spans: Array, cuts: Array) -> tuple[Moments, Moments]:
        """Sub-exposures for the glints and, as a body is wide and faint, fewer for the bodies."""
        bounds, weights, frames = pieces(spans, cuts)
        ends = self.camera.project(np.asarray(centres(bounds.ravel()), float))
        ends = ends.reshape(len(bounds), 2, -1, 2)
        w, h = self.camera.size
        near = np.all((ends > [-w, -h]) & (ends < [2 * w, 2 * h]), axis=(1, 3))
        travel = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=2)
        farthest = np.where(near, travel, 0).max(axis=1, initial=0)
        farthest /= np.hypot(self.camera.psf_sigma_px, 12**-0.5)
        return sample(bounds, weights, frames, farthest), sample(bounds, weights, frames, farthest / 4)

    def _bodies(self, centres: Centres, moments: Moments, patches: Patches, alike: Index) -> Float32:
        """Blurred bodies less the plate behind them, (n, width, width) for n patches of one width."""
        places = np.asarray(centres(moments.times), float)
        pixels, slope = self.camera.project_with_slope(places)
        extent = reach(self.camera, places, self.radii, slope)
        width, margin = int(patches.widths[alike[0]]), patches.margin
        tile = (width - 2 * margin) * FINENESS
        across = max(1, SIDE // tile)
        slots = patches.slots(alike)[patches.number[moments.frames]]
        moment, ball = np.nonzero(slots >= 0)
        slot, place = slots[moment, ball], pixels[moment, ball]
        jobs = self._jobs(places[moment, ball], self.radii[ball], FINENESS)
        jobs[:, 0, :2] = np.stack([slot % across, slot // across], axis=1) * tile
        jobs[:, 0, 2:] = (place - patches.origins[alike[slot]] - margin + 0.5) * FINENESS
        jobs[:, 2, 3] = moments.weights[moment]
        jobs[:, 3, 1] = extent[moment, ball] * FINENESS
        others = self._neighbours(jobs, places, moment, ball)
        rows = -(-len(alike) // across)
        drawn = self._canvas.draw(jobs, others, (rows * tile, across * tile), self._uniforms)
        tiles = drawn.reshape(rows, tile, across, tile).swapaxes(1, 2).reshape(-1, tile, tile)[: len(alike)]
        blur = blur_matrix(width, margin, FINENESS, self.camera.psf_sigma_px)
        return np.asarray(blur @ tiles @ blur.T)

    def _neighbours(self, jobs: Float32, places: Array, moment: Index, ball: Index) -> Float32:
        """Neighbours (n, N - 1, 4) of each body in its own radii, nearest first; counts go into the jobs."""
        total = len(self.radii)
        if total == 1:
            return np.zeros((len(jobs), 1, 4), np.float32)
        others = np.array([[k for k in range(total) if k != own] for own in range(total)])[ball]
        offsets = places[moment[:, None], others] - places[moment, ball][:, None]
        distance = np.linalg.norm(offsets, axis=2)
        order = np.argsort(distance, axis=1, kind="stable")
        found = np.concatenate([offsets @ self.camera.R.T, self.radii[others][..., None]], axis=2)
        found /= self.radii[ball][:, None, None]
        # Beyond this a neighbour's image is under 1e-5 of the body and single precision thins out.
        jobs[:, 3, 0] = (distance < 60 * self.radii[ball][:, None]).sum(axis=1)
        return np.take_along_axis(found, order[..., None], axis=1).astype(np.float32)

    def _add_glints(self, bodies: Float32, glints: Glints, moments: Moments, patches: Patches, alike: Index) -> None:
        slots = patches.slots(alike)[patches.number[moments.frames[glints.moment], glints.ball]]
        order = np.argsort(slots, kind="stable")
        order = order[np.searchsorted(slots[order], 0) :]
        slots, moment = slots[order], glints.moment[order]
        variances = glints.spread[order] + self.camera.psf_sigma_px**2
        origins = patches.origins[alike[slots]]
        rows, columns = spots(glints.pixels[order], variances, origins, bodies.shape[1])
        rows *= (glints.flux[order] * moments.weights[moment] * self._unit)[:, None]
        bounds = np.searchsorted(slots, np.arange(len(bodies) + 1))
        for k, body in enumerate(bodies):
            own = slice(bounds[k], bounds[k + 1])
            body += rows[own].T @ columns[own]
