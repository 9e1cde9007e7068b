"""Detectors, one file each: a class that is made from a `View`; see `tracker.detection.detector`."""
