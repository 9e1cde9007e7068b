"""Validate a selection: disagreements of model and data, outlier clips, and tests on held-out collisions."""
