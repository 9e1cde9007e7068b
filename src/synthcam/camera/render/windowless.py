"""Choose the OpenGL that draws without a window: EGL if it works, otherwise OSMesa.

PyOpenGL reads PYOPENGL_PLATFORM when it is first imported: choose before.
"""

import ctypes
import ctypes.util
import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any


@contextmanager
def without_viewer() -> Iterator[None]:
    """Let pyrender be imported without its interactive viewer, which would load pyglet and X11's libraries."""
    name = "pyrender.viewer"
    if name in sys.modules:
        yield
        return
    stand_in = ModuleType(name)
    stand_in.Viewer = None  # type: ignore[attr-defined]
    sys.modules[name] = stand_in
    try:
        yield
    finally:
        del sys.modules[name]


class _Later(ModuleType):
    """Stands in for a module until something in it is asked for."""

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self.__name__), name)


@contextmanager
def trimesh_later() -> Iterator[None]:
    """Let pyrender be imported without trimesh, which takes .16 s to load; it is loaded if pyrender asks for it."""
    if "trimesh" in sys.modules:
        yield
        return
    stand_ins = {name: _Later(name) for name in ("trimesh", "trimesh.transformations")}
    stand_ins["trimesh"].transformations = stand_ins["trimesh.transformations"]  # type: ignore[attr-defined]
    sys.modules.update(stand_ins)
    try:
        yield
    finally:
        for name in stand_ins:
            del sys.modules[name]


def list_missing_packages() -> list[str]:
    """List Debian's packages whose libraries are needed and missing; EGL's drivers if all libraries are there."""
    if os.environ.get("PYOPENGL_PLATFORM") == "osmesa":
        return [] if osmesa() is not None else ["libosmesa6"]
    packages = {
        "libEGL.so.1": "libegl1",
        "libEGL_mesa.so.0": "libegl-mesa0",
        "libGL.so.1": "libgl1",
        "libOpenGL.so.0": "libopengl0",
    }
    absent = [package for library, package in packages.items() if load_library(library) is None]
    return absent or (["libgl1-mesa-dri"] if choose_egl_device()[0] is None else [])


def load_library(name: str | None, mode: int = ctypes.DEFAULT_MODE) -> ctypes.CDLL | None:
    """Load a shared library; None if it is missing."""
    try:
        return ctypes.CDLL(name, mode=mode) if name else None
    except OSError:
        return None


def choose_opengl() -> str:
    """Set PYOPENGL_PLATFORM and, for EGL, EGL_DEVICE_ID if the user has not. Returns the reason in a few words."""
    asked = os.environ.get("PYOPENGL_PLATFORM")
    if asked is None:
        device, why = choose_egl_device()
        if device is None and osmesa() is not None:
            os.environ["PYOPENGL_PLATFORM"] = "osmesa"
            return f"{why}, OSMesa is there"
        os.environ["PYOPENGL_PLATFORM"] = "egl"
    elif asked != "egl":
        return "asked for by PYOPENGL_PLATFORM"
    elif "EGL_DEVICE_ID" not in os.environ:
        device, why = choose_egl_device()
    if "EGL_DEVICE_ID" in os.environ:
        return "device asked for by EGL_DEVICE_ID"
    if device is not None:
        os.environ["EGL_DEVICE_ID"] = str(device)
    return why


def choose_egl_device() -> tuple[int | None, str]:
    """Number of the EGL device to draw on, graphics cards first, and the reason; None if no device starts."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
        address = egl.eglGetProcAddress
        address.restype, address.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
        pointer, integer = ctypes.c_void_p, ctypes.c_int32
        query = ctypes.CFUNCTYPE(integer, integer, pointer, ctypes.POINTER(integer))(address(b"eglQueryDevicesEXT"))
        about = ctypes.CFUNCTYPE(ctypes.c_char_p, pointer, integer)(address(b"eglQueryDeviceStringEXT"))
        show = ctypes.CFUNCTYPE(pointer, integer, pointer, pointer)(address(b"eglGetPlatformDisplayEXT"))
    except (OSError, AttributeError, TypeError):
        return None, "EGL is missing"
    devices, count = (pointer * 16)(), integer(0)
    extensions, platform_device = 0x3055, 0x313F  # EGL_EXTENSIONS of EGL 1.5, EGL_PLATFORM_DEVICE_EXT
    if not query(16, devices, ctypes.byref(count)):
        return None, "EGL has no device"
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    # Mesa's own rasteriser calls itself software; graphics cards come first.
    ranked = sorted(range(count.value), key=lambda k: b"software" in (about(devices[k], extensions) or b""))
    for k in ranked:
        display = show(platform_device, devices[k], None)
        if display and egl.eglInitialize(display, None, None):
            software = b"software" in (about(devices[k], extensions) or b"")
            return k, "EGL works, no graphics card" if software else "EGL works on a graphics card"
    return None, "EGL has no device that starts"


def osmesa() -> ctypes.CDLL | None:
    """Load OSMesa, which draws without a window; None without it. Mesa 25.1 dropped it."""
    found = load_library("libOSMesa.so.8", ctypes.RTLD_GLOBAL)
    return found or load_library(ctypes.util.find_library("OSMesa"), ctypes.RTLD_GLOBAL)


class OSMesa:
    """An OSMesa context for pyrender, whose own platform class needs a later PyOpenGL than pyrender allows."""

    def __init__(self, width: int, height: int) -> None:
        self.viewport_width, self.viewport_height = width, height
        self._context: int | None = None

    def init_context(self) -> None:
        """Create the context. Raises RuntimeError if the library is missing or too old."""
        library = osmesa()
        if library is None:
            raise RuntimeError("libOSMesa is missing")
        # GL/osmesa.h, Mesa 11.2 and later: format RGBA, depth bits 24, core profile, OpenGL 4.1, end
        wanted = [0x22, 0x1908, 0x30, 24, 0x33, 0x34, 0x36, 4, 0x37, 1, 0]
        library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        self._library = library
        self._context = library.OSMesaCreateContextAttribs((ctypes.c_int * len(wanted))(*wanted), None)
        if not self._context:
            raise RuntimeError("OSMesa offers no OpenGL 4.1")
        # All is drawn to our own framebuffer: OSMesa's may be of any size.
        self._buffer = (ctypes.c_ubyte * 4)()

    def make_current(self) -> None:
        unsigned_byte = 0x1401  # GL_UNSIGNED_BYTE
        context, made = ctypes.c_void_p(self._context), self._library.OSMesaMakeCurrent
        if not made(context, ctypes.byref(self._buffer), unsigned_byte, 1, 1):
            raise RuntimeError("OSMesa cannot make its context current")

    def make_uncurrent(self) -> None:
        """Nothing to do."""

    def delete_context(self) -> None:
        if self._context:
            self._library.OSMesaDestroyContext(ctypes.c_void_p(self._context))
        self._context = None

    def supports_framebuffers(self) -> bool:
        return True
