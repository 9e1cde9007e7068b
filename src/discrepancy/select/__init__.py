"""Which effects are missing: score tests, stepwise search, costs of models, free laws beside the effects."""
