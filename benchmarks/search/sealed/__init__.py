"""Blind trials of the search: sealed boxes, an integrator of their own, effects that no library holds, the opening."""
