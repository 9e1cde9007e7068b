"""Start and end a command: in one line at Ctrl-C, even while its modules load, and without needless work.

Until `start_command` has begun, Ctrl-C gives a traceback. So this module, `lazy_names`, and `__init__` and `__main__`
of the packages import nothing at first that Python has not loaded by itself.
"""

from __future__ import annotations

import atexit
import gc
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
    defer_garbage_collection()
    end_at_once = skip_teardown()
    try:
        run()
    except SystemExit as ended:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt but the end of the interpreter
        if ended.code == 130:  # Python itself may otherwise end with another status
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)
        if ended.code in (None, 0, 1, 2):
            end_at_once(ended.code or 0)
        raise


def defer_garbage_collection(objects: int = 500_000) -> None:
    """Let Python first look for garbage when a process has this many objects: more than all modules have.

    While modules load there is no garbage, and each search goes through all their objects, a fifth of the time of
    a start. From the first search on, the usual thresholds hold.
    """
    usual = gc.get_threshold()

    def restore(phase: str, info: dict[str, int]) -> None:
        if phase == "stop":
            gc.callbacks.remove(restore)
            gc.set_threshold(*usual)
            gc.freeze()
            gc.unfreeze()  # to the oldest generation, so that the next searches leave the modules out

    gc.callbacks.append(restore)
    gc.set_threshold(objects)


def skip_teardown() -> Callable[[int], None]:
    """Let this process end without freeing its objects one by one, which takes .2 to .5 s after a short command.

    Returns a function that takes the exit status and has to be called before the end. Python then ends as usual, up
    to the functions registered with `atexit` after this call; they run, and the process is over.
    """
    status = -1

    def set_status(value: int) -> None:
        nonlocal status
        status = value

    def end() -> None:
        if status < 0:
            return
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        except (OSError, ValueError):  # closed: Python itself finds a status for that
            return
        os._exit(status)

    atexit.register(end)
    return set_status
