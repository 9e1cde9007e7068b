"""The report of a search or a plan: narrative, figures, discrepancy.json and a self-contained page."""
