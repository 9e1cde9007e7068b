"""Results of several recordings taken together."""
