"""The command tracker, also as `python -m tracker`."""

from synthcam_shared.start import start_command


def main() -> None:
    """Start the command `tracker`."""
    start_command("tracker", run)


def run() -> None:
    """Import the command line of `tracker` and run it."""
    from tracker import cli

    cli.main()


if __name__ == "__main__":
    main()
