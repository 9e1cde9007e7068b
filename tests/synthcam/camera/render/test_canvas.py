"""OpenGL off-screen: what draws, and what is said where nothing can."""

import os
import subprocess
import sys

from synthcam.camera.render import gl_info


def test_gl_info_names_the_renderer():
    info = gl_info()
    assert set(info) == {"renderer", "version", "vendor", "platform", "why"}
    assert all(info.values())


def test_without_opengl_there_is_one_clear_line():
    code = (
        "import numpy as np\n"
        "from synthcam.camera.pinhole import PinholeCamera, Lamp\n"
        "from synthcam.camera.render import MirrorRenderer, NoGL, gl_info\n"
        "try: gl_info()\n"
        "except NoGL as error: print(error)\n"
    )
    no_driver = {"__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent", "PYOPENGL_PLATFORM": "egl"}
    for broken in (no_driver, {"PYOPENGL_PLATFORM": "nonsense"}):
        done = subprocess.run(
            [sys.executable, "-c", code], env=os.environ | broken, capture_output=True, text=True, check=True
        )
        assert done.stdout.startswith("no off-screen OpenGL")
        assert done.stdout.count("\n") == 1
