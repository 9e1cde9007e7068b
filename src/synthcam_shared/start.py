"""Start a command so that Ctrl-C ends it in one line while its modules are imported, too."""

import os
import signal
import sys
from collections.abc import Callable

from synthcam_shared.interruption import end_at_ctrl_c


def start(name: str, load: Callable[[], Callable[[], None]]) -> None:
    """Run a command line. `load` imports its modules and returns its main function."""
    end_at_ctrl_c(name)
    try:
        load()()
    except SystemExit as ended:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt but the end of the interpreter
        if ended.code == 130:  # Python itself may otherwise end with another status
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)
        raise
