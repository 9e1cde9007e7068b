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
    """A platform that is none; the doctor's test has one without a driver."""
    code = "from synthcam.camera.render import NoGL, gl_info\ntry: gl_info()\nexcept NoGL as error: print(error)\n"
    broken = os.environ | {"PYOPENGL_PLATFORM": "nonsense"}
    done = subprocess.run([sys.executable, "-c", code], env=broken, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("no off-screen OpenGL")
    assert done.stdout.count("\n") == 1
