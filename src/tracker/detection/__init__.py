"""Detects balls in frames and links them into tracks; estimates from the film what its camera file leaves open."""
