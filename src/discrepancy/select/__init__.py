"""Select the missing effects: score tests, stepwise search, costs of models, and free laws."""
