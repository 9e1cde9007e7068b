"""What an experiment could show before a recording is made, and which change of it would show more."""
