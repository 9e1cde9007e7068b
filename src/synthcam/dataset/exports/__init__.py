"""Formats of other programs, one file each, with `write(clips, folder)`; the first line of a file is its help."""
