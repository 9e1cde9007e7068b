"""Fits of glints by their likelihood: the model of a ball's picture, its bound, what the fits must know."""
