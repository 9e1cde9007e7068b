"""Scores of results against the truth: positions, tracks, error bars, a comparison of detectors, report pages."""
