"""The noise of measured positions: how large it is and how it lasts from frame to frame."""
