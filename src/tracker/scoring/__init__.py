"""Results against the truth: localisation, tracks, error bars, comparison of detectors, reports."""
