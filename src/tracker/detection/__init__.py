"""Balls in frames: candidates, sub-pixel fits with covariance, what a film tells of its camera, tracks."""
