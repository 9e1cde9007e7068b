"""Mirror balls drawn by OpenGL: the only package that imports pyrender, trimesh and PyOpenGL."""

from synthcam.camera.render.canvas import NoGL, gl_info
from synthcam.camera.render.mirror_renderer import FINENESS, MirrorRenderer

__all__ = ["FINENESS", "MirrorRenderer", "NoGL", "gl_info"]
