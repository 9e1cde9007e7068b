"""`python -m synthcam`: the command synthcam."""

from synthcam.cli import main

main()
