"""Draw off-screen by OpenGL: pyrender with a float32 buffer and our own shaders, by EGL or OSMesa.

This is the only module that imports pyrender and PyOpenGL.
"""

import ctypes
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from synthcam.camera.render import windowless
from synthcam.camera.render.ball_squares import SquaresByProgram
from synthcam_shared.arrays import Float32
from synthcam_shared.errors import NoGL as NoGL

# Read when the libraries load. llvmpipe then draws in the calling thread and leaves the other cores to other processes.
os.environ.setdefault("LP_NUM_THREADS", "0")
OPENGL_CHOICE = windowless.choose_opengl()
_missing = ""
try:
    with warnings.catch_warnings(), windowless.without_viewer(), windowless.trimesh_later():
        warnings.simplefilter("ignore")
        import pyrender
        from OpenGL import GL
        from OpenGL.platform import PLATFORM
except Exception as error:  # PyOpenGL raises whatever its loader happens to trip over
    pyrender = None
    _missing = " ".join(str(error).split()) or type(error).__name__


BUFFER_SIDE = 1024  # usual side of the buffer, samples
MAX_BALLS_PER_CALL = 2048


class BallBatch(NamedTuple):
    """Balls that one program draws."""

    jobs: Float32  # instance matrices (n, 4, 4)
    others: Float32  # their neighbours (n, k, 4)
    defines: dict[str, int]  # of the shader
    squares: Sequence[SquaresByProgram] | None = None  # as of `divide_balls`


class _Programs(pyrender.shader_program.ShaderProgramCache if pyrender else object):  # type: ignore[misc]
    """pyrender's shader programs, each compiled with the defines of its drawing."""

    wanted: ClassVar[dict[str, int]] = {}

    def get_program(self, defines: dict[str, int], **shaders: str) -> Any:
        return super().get_program(defines=defines | self.wanted, **shaders)


class _Renderer(pyrender.Renderer if pyrender else object):  # type: ignore[misc]
    """pyrender's renderer with a float32 buffer and our shaders; overlapping balls are added."""

    def __init__(self) -> None:
        super().__init__(BUFFER_SIDE, BUFFER_SIDE)
        shaders = Path(__file__).with_name("shaders")
        self._program_cache: Any = _Programs(shader_dir=str(shaders))
        self.uniforms: dict[str, Any] = {}
        self.batches: list[BallBatch] = []
        self.rows = BUFFER_SIDE
        self._textures: list[int] = []  # of the neighbours and of the jobs
        self._points: tuple[int, int] | None = None  # vertex array and buffer of the squares
        self._main_fb: Any
        self._marks: Any  # the stencil buffer, in which squares mark what is drawn
        self._main_fb_dims: tuple[int, int]

    def _configure_main_framebuffer(self) -> None:
        size = (self.viewport_width, self.viewport_height)
        if self._main_fb is not None and self._main_fb_dims != size:
            self._delete_main_framebuffer()
            GL.glDeleteRenderbuffers(1, [self._marks])
        if self._main_fb is None:
            self._main_cb = self._main_cb_ms = GL.glGenRenderbuffers(1)
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, self._main_cb)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_R32F, *size)
            self._main_fb = self._main_fb_ms = GL.glGenFramebuffers(1)
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._main_fb)
            self._marks = GL.glGenRenderbuffers(1)
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, self._marks)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_DEPTH24_STENCIL8, *size)
            parts = {GL.GL_COLOR_ATTACHMENT0: self._main_cb, GL.GL_DEPTH_STENCIL_ATTACHMENT: self._marks}
            for part, buffer in parts.items():
                GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, part, GL.GL_RENDERBUFFER, buffer)
            self._main_fb_dims = size

    def _bind_lighting(self, scene: Any, program: Any, node: Any, flags: int) -> None:
        """Nothing to do: the programs of the batches have their uniforms."""

    def _bind_and_draw_primitive(self, primitive: Any, pose: Any, program: Any, flags: int) -> None:
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glDisable(GL.GL_DEPTH_TEST)
        GL.glEnable(GL.GL_BLEND)
        GL.glBlendFunc(GL.GL_ONE, GL.GL_ONE)
        for batch in self.batches:
            jobs = np.ascontiguousarray(batch.jobs)
            self._load_texture(0, batch.others)
            if batch.squares:
                self._load_texture(1, jobs)
                self._draw_squares(primitive, flags, batch)
                continue
            self._use_program(primitive, flags, batch.defines)
            primitive._bind()  # again: a program that is new has bound another array
            GL.glBindBuffer(GL.GL_ARRAY_BUFFER, primitive._buffers[1])  # pyrender's instance matrices
            GL.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, jobs.nbytes, jobs)
            count = primitive.indices.size
            GL.glDrawElementsInstanced(primitive.mode, count, GL.GL_UNSIGNED_INT, None, len(jobs))
        primitive._unbind()

    def _use_program(self, primitive: Any, flags: int, defines: dict[str, int]) -> None:
        self._program_cache.wanted = defines
        program = self._get_primitive_program(primitive, flags, pyrender.constants.ProgramFlags.USE_MATERIAL)
        program._bind()
        for name, value in self.uniforms.items():
            if GL.glGetUniformLocation(program._program_id, name) >= 0:  # otherwise the program does not use it
                program.set_uniform(name, value)

    def _draw_squares(self, primitive: Any, flags: int, batch: BallBatch) -> None:
        """Draw the squares of a batch as points, which have no diagonal to be drawn twice.

        A bit of the stencil buffer for the first, and one for the second exposure of a tile mark what is drawn.
        """
        assert batch.squares is not None
        if self._points is None:
            # Two buffers: for one, PyOpenGL 3.1.0, which pyrender needs, passes a pointer that Python 3.12 refuses.
            self._points = int(GL.glGenVertexArrays(2)[0]), int(GL.glGenBuffers(2)[0])
            GL.glEnable(GL.GL_PROGRAM_POINT_SIZE)
        GL.glEnable(GL.GL_STENCIL_TEST)
        GL.glStencilMask(0xFF)
        GL.glClear(GL.GL_STENCIL_BUFFER_BIT)
        GL.glStencilOp(GL.GL_KEEP, GL.GL_KEEP, GL.GL_INVERT)
        programs: tuple[dict[str, int], ...] = {}, {"LONE": 1, "APART": 1, "INSIDE": 1}, {"LONE": 1, "APART": 1}
        for defines, turns in zip(programs, zip(*batch.squares, strict=True), strict=True):
            if not any(map(len, turns)):
                continue
            self._use_program(primitive, flags, batch.defines | {"SQUARES": 1} | defines)
            GL.glBindVertexArray(self._points[0])
            GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._points[1])
            points = np.concatenate(turns)
            GL.glBufferData(GL.GL_ARRAY_BUFFER, points.nbytes, points, GL.GL_STREAM_DRAW)
            GL.glEnableVertexAttribArray(0)
            GL.glVertexAttribPointer(0, 4, GL.GL_FLOAT, False, 0, None)
            first = 0
            for bit, squares in zip((1, 2, 0), turns, strict=True):
                GL.glStencilFunc(GL.GL_EQUAL, 0, bit)
                GL.glStencilMask(bit)
                GL.glDrawArrays(GL.GL_POINTS, first, len(squares))
                first += len(squares)
        GL.glDisable(GL.GL_STENCIL_TEST)

    def _read_main_framebuffer(self, scene: Any, flags: int) -> Float32:
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb)
        read = GL.glReadPixels(0, 0, self.viewport_width, self.rows, GL.GL_RED, GL.GL_FLOAT)
        return np.frombuffer(read, np.float32).reshape(self.rows, self.viewport_width)

    def _load_texture(self, unit: int, rows: Float32) -> None:
        """Load rows (n, k, 4), one a ball, as the texture that the shader reads by this unit."""
        if not self._textures:
            self._textures = [int(each) for each in GL.glGenTextures(2)]
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._textures[unit])
        for setting in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
            GL.glTexParameteri(GL.GL_TEXTURE_2D, setting, GL.GL_NEAREST)
        size, texels = rows.shape[:2][::-1], np.ascontiguousarray(rows)
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGBA32F, *size, 0, GL.GL_RGBA, GL.GL_FLOAT, texels)


class _Screen(pyrender.OffscreenRenderer if pyrender else object):  # type: ignore[misc]
    """pyrender's off-screen renderer on the selected platform, with our renderer in it."""

    def _create(self) -> None:
        if os.environ["PYOPENGL_PLATFORM"] != "osmesa":
            super()._create()
        else:
            # PyOpenGL 3.1.0 uses the context as a key, and OSMesa's pointer type has no hash.
            PLATFORM.GetCurrentContext.restype = ctypes.c_void_p
            self._platform = windowless.OSMesa(self.viewport_width, self.viewport_height)
            self._platform.init_context()
            self._platform.make_current()
        self._renderer = _Renderer()


class Canvas:
    """The process's one OpenGL context with its scene: a quad, drawn once for every ball."""

    def __init__(self) -> None:
        if pyrender is None:
            raise NoGL(_no_gl(_missing))
        try:
            self._screen = _Screen(BUFFER_SIDE, BUFFER_SIDE)
            self._renderer: _Renderer = self._screen._renderer
            self.info = {
                name.lower(): GL.glGetString(getattr(GL, f"GL_{name}")).decode()
                for name in ("RENDERER", "VERSION", "VENDOR")
            }
        except Exception as error:
            raise NoGL(_no_gl(" ".join(str(error).split()) or type(error).__name__)) from error
        self.is_software = "llvmpipe" in self.info["renderer"]
        self.info |= {"platform": os.environ["PYOPENGL_PLATFORM"], "why": OPENGL_CHOICE}
        quad = pyrender.Primitive(
            positions=[[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]],
            indices=[[0, 1, 2], [0, 2, 3]],
            material=pyrender.MetallicRoughnessMaterial(),  # required, as a camera is; the shader ignores both
            mode=pyrender.GLTF.TRIANGLES,
            poses=np.zeros((MAX_BALLS_PER_CALL, 4, 4), np.float32),  # room for jobs
        )
        self._scene = pyrender.Scene(bg_color=np.zeros(4))
        for each in (pyrender.Mesh([quad]), pyrender.IntrinsicsCamera(1, 1, 0, 0)):
            self._scene.set_pose(self._scene.add(each), np.eye(4))

    def draw(self, batches: Sequence[BallBatch], size: tuple[int, int], uniforms: dict[str, Any]) -> Float32:
        """Draw all jobs; return the buffer (rows, columns) of that size. uniforms: of the shaders."""
        screen, drawn = self._screen, []
        screen.viewport_height, screen.viewport_width = max(BUFFER_SIDE, size[0]), max(BUFFER_SIDE, size[1])
        self._renderer.rows = size[0]
        atlas = np.array([screen.viewport_width, screen.viewport_height], float)
        self._renderer.uniforms = uniforms | {"atlas": atlas, "others": 0, "jobs": 1}
        for first in range(0, max(len(batch.jobs) for batch in batches), MAX_BALLS_PER_CALL):
            part = slice(first, first + MAX_BALLS_PER_CALL)
            parts = [batch._replace(jobs=batch.jobs[part], others=batch.others[part]) for batch in batches]
            self._renderer.batches = [batch for batch in parts if len(batch.jobs)]
            for batch in self._renderer.batches:
                batch.jobs[:, 3, 2] = np.arange(len(batch.jobs))
            self._renderer._program_cache.wanted = self._renderer.batches[0].defines
            screen._platform.make_current()
            drawn.append(screen.render(self._scene))
        return np.asarray(sum(drawn[1:], drawn[0]))[:, : size[1]]


_canvas: tuple[int, Canvas] | None = None


def get_canvas() -> Canvas:
    """Return the one canvas of this process. A second context, or one kept over a fork, crashes some drivers."""
    global _canvas
    if _canvas is None:
        _canvas = (os.getpid(), Canvas())
    if _canvas[0] != os.getpid():
        raise NoGL("OpenGL was started before this process was forked: start workers by spawn instead")
    return _canvas[1]


def _no_gl(why: str) -> str:
    absent = " ".join(windowless.list_missing_packages())
    advice = f"missing (Debian, Ubuntu): apt install {absent}" if absent else "all its libraries are installed"
    return f"no off-screen OpenGL ({os.environ.get('PYOPENGL_PLATFORM')}): {why}; {advice}"


def gl_info() -> dict[str, str]:
    """Describe the OpenGL in use: renderer, version, vendor, platform, reason. Raises NoGL without OpenGL."""
    return dict(get_canvas().info)
