"""Balls in frames: candidates, sub-pixel fits with covariance, what a film shows of its camera, tracks."""
