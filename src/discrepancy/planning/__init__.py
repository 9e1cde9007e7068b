"""Predict which effects a planned experiment could detect, and which change of it would detect more."""
