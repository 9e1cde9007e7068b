"""Other programs that link detections into tracks, one file each; a detector's name may end in +NAME."""
