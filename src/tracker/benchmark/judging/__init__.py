"""A tracker's results held to the truth of a suite: positions, quantities, what its defects do to the physics."""
