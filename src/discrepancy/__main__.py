"""The command discrepancy, also as `python -m discrepancy`."""

from synthcam_shared.start import start_command


def main() -> None:
    """Start the command `discrepancy`."""
    start_command("discrepancy", run)


def run() -> None:
    """Import the command line of `discrepancy` and run it."""
    from discrepancy import cli

    cli.main()


if __name__ == "__main__":
    main()
