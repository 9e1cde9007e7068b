"""The command discrepancy, also as `python -m discrepancy`."""

from collections.abc import Callable

from synthcam_shared.start import start


def load() -> Callable[[], None]:
    """Import the command line of `discrepancy`."""
    from discrepancy.cli import main

    return main


def main() -> None:
    """Start the command `discrepancy`."""
    start("discrepancy", load)


if __name__ == "__main__":
    main()
