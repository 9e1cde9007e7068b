"""Where do simulation and measurement disagree, and what is missing from the model?"""
