"""The command synthcam, also as `python -m synthcam`."""

from collections.abc import Callable

from synthcam_shared.start import start


def load() -> Callable[[], None]:
    """Import the command line of `synthcam`."""
    from synthcam.cli import main

    return main


def main() -> None:
    """Start the command `synthcam`."""
    start("synthcam", load)


if __name__ == "__main__":
    main()
