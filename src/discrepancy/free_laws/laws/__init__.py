"""The free laws of a search. Each module here has LAWS, a tuple of them, and is found by its being there."""
