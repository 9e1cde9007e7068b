"""Measured collisions, and what is wrong with tracks before anything is fitted."""
