"""The command synthcam, also as `python -m synthcam`."""

from synthcam_shared.start import start_command


def main() -> None:
    """Start the command `synthcam`."""
    start_command("synthcam", run)


def run() -> None:
    """Import the command line of `synthcam` and run it."""
    from synthcam import cli

    cli.main()


if __name__ == "__main__":
    main()
