"""The workbench: a page on this machine, from a film to a result by looking and pointing."""
