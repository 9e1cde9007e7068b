"""Other programs' files of tracks, one file each: `read`, `write`, or both."""
