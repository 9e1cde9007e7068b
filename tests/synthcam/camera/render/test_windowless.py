"""EGL and OSMesa draw the same bytes; which one draws, and why, is told."""

import ctypes.util
import json
import os
import subprocess
import sys

import pytest

from synthcam.camera.render import windowless

DRAW = """
import hashlib, json, numpy as np
from synthcam.camera.pinhole import PinholeCamera, Lamp
from synthcam.camera.render import MirrorRenderer, gl_info
from synthcam.camera.surface import Surface
R, seen = 1.19e-3, hashlib.sha256()
camera = PinholeCamera.overhead((200, 120), 1e-4, .5, ball_radius=R, fps=250, exposure=0, psf_sigma_px=1.0)
centres = np.array([[[0, 0, R], [2 * R, 0, R]]])
for surface in (Surface(), Surface(steel=(2.95, 2.93), plate_shadow=True, plate_gloss=.05)):
    film = MirrorRenderer(camera, Lamp(np.array([.05, 0, .45]), .01), [R, R], .2, surface)
    for picture in film.frames(lambda t: np.repeat(centres, len(t), 0), [[0, 0]]):
        seen.update(picture.image.tobytes())
print(json.dumps(gl_info() | {"seen": seen.hexdigest()}))
"""


def run_python(code, **environment):
    clean = {k: v for k, v in os.environ.items() if k not in ("PYOPENGL_PLATFORM", "EGL_DEVICE_ID")}
    done = subprocess.run([sys.executable, "-c", code], env=clean | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done


def draw(**environment):
    return json.loads(run_python(DRAW, **environment).stdout)


def test_egl_is_the_default_and_loads_no_window_library():
    found = json.loads(run_python(f"import sys; sys.modules['pyglet'] = None\n{DRAW}").stdout)
    assert found["platform"] == "egl"
    assert found["why"].startswith("EGL works")


@pytest.mark.skipif(windowless.osmesa() is None, reason="no OSMesa here")
def test_osmesa_when_asked_or_when_egl_is_missing_and_the_same_bytes():
    asked, fallen = draw(PYOPENGL_PLATFORM="osmesa"), draw(__EGL_VENDOR_LIBRARY_DIRS="/nonexistent")
    assert asked["platform"] == fallen["platform"] == "osmesa"
    assert asked["why"] == "asked for by PYOPENGL_PLATFORM"
    assert "EGL" in fallen["why"]
    egl = draw(PYOPENGL_PLATFORM="egl")
    assert egl["platform"] == "egl"
    if egl["renderer"] == asked["renderer"]:
        assert egl["seen"] == asked["seen"] == fallen["seen"]


def doctor(**environment):
    clean = {k: v for k, v in os.environ.items() if k not in ("PYOPENGL_PLATFORM", "EGL_DEVICE_ID")}
    words = [sys.executable, "-c", "from synthcam.cli import main; main()", "doctor", "--json"]
    return subprocess.run(words, env=clean | environment, capture_output=True, text=True)


@pytest.mark.skipif(windowless.osmesa() is None, reason="no OSMesa here")
def test_the_doctor_shows_what_draws_and_why():
    told = json.loads(doctor(__EGL_VENDOR_LIBRARY_DIRS="/nonexistent").stdout)
    assert told["platform"] == "osmesa"
    assert told["why"].startswith("EGL")
    assert told["why"].endswith("OSMesa is there")
    assert told["renderer"]
    assert told["frames_per_second"] > 0


def test_the_doctor_finds_nothing_that_draws():
    done = doctor(__EGL_VENDOR_LIBRARY_DIRS="/nonexistent", PYOPENGL_PLATFORM="egl")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "no off-screen OpenGL (egl)" in done.stderr
    assert "apt install libgl1-mesa-dri" in done.stderr  # the libraries are there, but no driver


def test_what_is_missing_is_named_by_its_package(monkeypatch):
    real = ctypes.CDLL
    monkeypatch.setenv("PYOPENGL_PLATFORM", "egl")

    def without_opengl(name, *args, **kwargs):
        if name == "libOpenGL.so.0":
            raise OSError(f"{name}: cannot open shared object file")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(ctypes, "CDLL", without_opengl)
    assert windowless.list_missing_packages() == ["libopengl0"]


def test_without_a_library_there_is_none(monkeypatch):
    def nothing(*_, **__):
        raise OSError("no such file")

    monkeypatch.setattr(ctypes, "CDLL", nothing)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    assert windowless.osmesa() is None
    assert windowless.choose_egl_device() == (None, "EGL is missing")
    with pytest.raises(RuntimeError, match="libOSMesa is missing"):
        windowless.OSMesa(4, 4).init_context()


@pytest.mark.parametrize("given", ["osmesa", "egl"])
def test_what_the_user_asks_for_stands(monkeypatch, given):
    monkeypatch.setenv("PYOPENGL_PLATFORM", given)
    monkeypatch.setenv("EGL_DEVICE_ID", "0")
    assert "asked for" in windowless.choose_opengl()
    assert os.environ["PYOPENGL_PLATFORM"] == given


def test_trimesh_is_loaded_when_pyrender_needs_it():
    late = """
import sys
from synthcam.camera.render import gl_info
import pyrender
gl_info()  # draws with pyrender
assert "trimesh" not in sys.modules and "trimesh.transformations" not in sys.modules
import trimesh
mesh = pyrender.Mesh.from_trimesh(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
print(pyrender.Node(mesh=mesh, rotation=[0, 0, 1, 0]).matrix.diagonal().tolist())  # half a turn about z
"""
    assert json.loads(run_python(late).stdout) == pytest.approx([-1, -1, 1, 1])
