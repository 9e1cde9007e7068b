"""Tables of tracks, in and out: this project's own and those of other programs, each a file of the folder formats."""
