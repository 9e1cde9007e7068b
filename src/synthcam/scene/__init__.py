"""An experiment: its numbers, one drawn clip of it, and the truth about that clip."""
