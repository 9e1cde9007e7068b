"""Matte balls on a plate under room light: sampled and in closed form with numpy, without OpenGL."""
