"""Which OpenGL draws without a window: EGL where it works, OSMesa when asked or where EGL does not.

PyOpenGL reads PYOPENGL_PLATFORM when it is first imported, so the choice comes before it.
"""

import ctypes
import ctypes.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

EGL_EXTENSIONS, EGL_PLATFORM_DEVICE = 0x3055, 0x313F  # EGL 1.5, EGL_EXT_platform_device
# OSMesa's own constants (GL/osmesa.h, Mesa 11.2 and later)
OSMESA_FORMAT, OSMESA_RGBA, OSMESA_DEPTH_BITS = 0x22, 0x1908, 0x30
OSMESA_PROFILE, OSMESA_CORE_PROFILE, OSMESA_MAJOR, OSMESA_MINOR = 0x33, 0x34, 0x36, 0x37
GL_UNSIGNED_BYTE = 0x1401

# Debian's and Ubuntu's packages, by the library that each brings
PACKAGES = {
    "libEGL.so.1": "libegl1",
    "libEGL_mesa.so.0": "libegl-mesa0",
    "libGL.so.1": "libgl1",
    "libOpenGL.so.0": "libopengl0",
}
DRIVERS = "libgl1-mesa-dri"


@contextmanager
def without_viewer() -> Iterator[None]:
    """Let pyrender be imported without its interactive viewer, which would load pyglet and with it X11's libraries."""
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


def missing_packages() -> list[str]:
    """Debian's packages whose libraries are wanted and not found here; EGL's drivers where all else is there."""
    if os.environ.get("PYOPENGL_PLATFORM") == "osmesa":
        return [] if osmesa() is not None else ["libosmesa6"]
    absent = []
    for library, package in PACKAGES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            absent.append(package)
    return absent or ([DRIVERS] if egl_device()[0] is None else [])


def choose() -> str:
    """Set PYOPENGL_PLATFORM and, for EGL, EGL_DEVICE_ID, where the user has not; say why, in a few words."""
    asked = os.environ.get("PYOPENGL_PLATFORM")
    if asked is None:
        device, why = egl_device()
        if device is None and osmesa() is not None:
            os.environ["PYOPENGL_PLATFORM"] = "osmesa"
            return f"{why}, OSMesa is there"
        os.environ["PYOPENGL_PLATFORM"] = "egl"
    elif asked != "egl":
        return "asked for by PYOPENGL_PLATFORM"
    elif "EGL_DEVICE_ID" not in os.environ:
        device, why = egl_device()
    if "EGL_DEVICE_ID" in os.environ:
        return "device asked for by EGL_DEVICE_ID"
    if device is not None:
        os.environ["EGL_DEVICE_ID"] = str(device)
    return why


def egl_device() -> tuple[int | None, str]:
    """Number of the EGL device to draw on, graphics cards first, and why; None where EGL has none that starts."""
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
    if not query(16, devices, ctypes.byref(count)):
        return None, "EGL has no device"
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    # Mesa's own rasteriser calls itself software; a card comes before it.
    ranked = sorted(range(count.value), key=lambda k: b"software" in (about(devices[k], EGL_EXTENSIONS) or b""))
    for k in ranked:
        display = show(EGL_PLATFORM_DEVICE, devices[k], None)
        if display and egl.eglInitialize(display, None, None):
            software = b"software" in (about(devices[k], EGL_EXTENSIONS) or b"")
            return k, "EGL works, no graphics card" if software else "EGL works on a graphics card"
    return None, "EGL has no device that starts"


def osmesa() -> ctypes.CDLL | None:
    """Mesa's off-screen library, or None. Mesa 25.1 dropped it."""
    for name in ("libOSMesa.so.8", ctypes.util.find_library("OSMesa")):
        try:
            if name:
                return ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
        except OSError:
            continue
    return None


class OSMesa:
    """A context of OSMesa's for pyrender: what its own platform does with a later PyOpenGL than it asks for."""

    def __init__(self, width: int, height: int) -> None:
        self.viewport_width, self.viewport_height = width, height
        self._context: int | None = None

    def init_context(self) -> None:
        """Create the context. Raises RuntimeError where the library is missing or too old."""
        library = osmesa()
        if library is None:
            raise RuntimeError("libOSMesa is missing")
        wanted = [OSMESA_FORMAT, OSMESA_RGBA, OSMESA_DEPTH_BITS, 24, OSMESA_PROFILE, OSMESA_CORE_PROFILE]
        wanted += [OSMESA_MAJOR, 4, OSMESA_MINOR, 1, 0]
        library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        self._library = library
        self._context = library.OSMesaCreateContextAttribs((ctypes.c_int * len(wanted))(*wanted), None)
        if not self._context:
            raise RuntimeError("OSMesa offers no OpenGL 4.1")
        # What is drawn goes to a framebuffer of our own: OSMesa's may be as small as it likes.
        self._buffer = (ctypes.c_ubyte * 4)()

    def make_current(self) -> None:
        context, made = ctypes.c_void_p(self._context), self._library.OSMesaMakeCurrent
        if not made(context, ctypes.byref(self._buffer), GL_UNSIGNED_BYTE, 1, 1):
            raise RuntimeError("OSMesa cannot make its context current")

    def make_uncurrent(self) -> None:
        """Nothing to do."""

    def delete_context(self) -> None:
        if self._context:
            self._library.OSMesaDestroyContext(ctypes.c_void_p(self._context))
        self._context = None

    def supports_framebuffers(self) -> bool:
        return True
