"""Formats of other programs, one a file, each with `write(clips, folder)`; the first line of its text is its help."""
