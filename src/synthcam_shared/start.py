"""Start a command so that Ctrl-C ends it in one line while its modules are imported, too.

Until `start_command` has begun, Ctrl-C gives a traceback. So this module, `lazy_names`, and `__init__` and `__main__`
of the packages import nothing at first that Python has not loaded by itself.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False  # as in typing, which loads for some ms
if TYPE_CHECKING:
    from collections.abc import Callable


def start_command(name: str, run: Callable[[], None]) -> None:
    """Run a command line. `run` imports its modules and calls its main function."""
    line = f"{name}: interrupted; nothing was written\n".encode()

    def end(number: int, frame: object) -> None:
        os.write(2, line)
        os._exit(130)

    signal.signal(signal.SIGINT, end)  # until the command itself listens
    try:
        run()
    except SystemExit as ended:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt but the end of the interpreter
        if ended.code == 130:  # Python itself may otherwise end with another status
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)
        raise
