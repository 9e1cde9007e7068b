"""The command tracker, also as `python -m tracker`."""

import signal

from synthcam_shared.interruption import end_at_ctrl_c


def main() -> None:
    """Run the command line; Ctrl-C during the imports ends it in one line."""
    end_at_ctrl_c("tracker")
    try:
        from tracker.cli import main as run_command

        run_command()
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt but the end of the interpreter


if __name__ == "__main__":
    main()
