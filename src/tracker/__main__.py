"""`python -m tracker`: the command tracker."""

from tracker.cli import main

main()
