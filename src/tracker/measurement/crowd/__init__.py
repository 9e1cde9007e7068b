"""Films of more than two balls: their contacts, each measured by itself, and the physics that all share."""
