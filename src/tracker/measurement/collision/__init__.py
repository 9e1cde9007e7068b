"""Collisions of two balls: the model of their paths, its fits and what follows from them."""
