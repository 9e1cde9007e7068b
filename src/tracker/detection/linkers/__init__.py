"""Other programs that join finds into tracks, one file each; a detector's name may end in +NAME."""
