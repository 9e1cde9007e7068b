"""From tracks to physics: the collision model, its fits, derived quantities and their standard errors."""
