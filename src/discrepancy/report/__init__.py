"""The report of a search or a plan: figures, discrepancy.json and a page with the sentences of `wording`."""
