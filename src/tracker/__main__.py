"""The command tracker, also as `python -m tracker`."""

from collections.abc import Callable

from synthcam_shared.start import start


def load() -> Callable[[], None]:
    """Import the command line of `tracker`."""
    from tracker.cli import main

    return main


def main() -> None:
    """Start the command `tracker`."""
    start("tracker", load)


if __name__ == "__main__":
    main()
