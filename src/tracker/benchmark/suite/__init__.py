"""A suite: its definition, the films and the truth that are made of it, the bounds, the card."""
