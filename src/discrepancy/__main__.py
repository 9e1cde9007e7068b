"""`python -m discrepancy`: the command discrepancy."""

from discrepancy.cli import main

main()
