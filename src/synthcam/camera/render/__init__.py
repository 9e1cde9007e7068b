"""The film: the only package that imports pyrender, trimesh and PyOpenGL."""

from synthcam.camera.render.canvas import NoGL, gl_info
from synthcam.camera.render.film import FINENESS, Film

__all__ = ["FINENESS", "Film", "NoGL", "gl_info"]
