"""The search told: narrative, figures, discrepancy.json and a self-contained page."""
