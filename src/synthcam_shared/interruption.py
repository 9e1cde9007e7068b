"""Ctrl-C ends a command even if a library swallows it or turns it into another exception."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_pressed = False


def was_interrupted() -> bool:
    """Tell whether Ctrl-C came since `watch_ctrl_c` began."""
    return _pressed


def raise_if_interrupted() -> None:
    """Raise KeyboardInterrupt if an earlier one was lost, as in a callback of a C library. Loops call this."""
    if _pressed:
        raise KeyboardInterrupt


@contextmanager
def watch_ctrl_c() -> Iterator[None]:
    """Remember that Ctrl-C came, and raise KeyboardInterrupt as usual."""
    global _pressed
    _pressed = False
    if threading.current_thread() is not threading.main_thread():  # only that one may set handlers
        yield
        return

    def hear(number: int, frame: FrameType | None) -> None:
        global _pressed
        _pressed = True
        raise KeyboardInterrupt

    def report_unraisable(lost: Any) -> None:
        if not (_pressed and issubclass(lost.exc_type, KeyboardInterrupt)):
            report(lost)

    handler, report = signal.signal(signal.SIGINT, hear), sys.unraisablehook
    sys.unraisablehook = report_unraisable
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        sys.unraisablehook = report


@contextmanager
def hold_ctrl_c() -> Iterator[None]:
    """Hold Ctrl-C back until the end, for all threads. Processes that are started meanwhile never hear it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[tuple[int, FrameType | None]] = []
    handler = signal.signal(signal.SIGINT, lambda *call: held.append(call))
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield
    finally:
        if masked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, masked)
        signal.signal(signal.SIGINT, handler)
    if held and callable(handler):
        handler(*held[0])
