"""The noise of measured tracks, and whitening by it."""
