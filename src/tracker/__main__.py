"""The command tracker, also as `python -m tracker`."""

from synthcam_shared.start import start


def main() -> None:
    """Start the command `tracker`."""
    start("tracker", run)


def run() -> None:
    """Import the command line of `tracker` and run it."""
    from tracker import cli

    cli.main()


if __name__ == "__main__":
    main()
