"""Work for the tests of jobs, which other processes load: without pytest, which would take most of their time."""

import functools
import os
import signal
import time

from synthcam_shared.errors import InputError


def work(number):
    if number == 13:
        raise InputError("unlucky")
    return os.getpid()


def elsewhere(function):
    """The function, done by this process slowly enough that others do most of it."""
    return functools.partial(_slow_here, os.getpid(), function)


def _slow_here(parent, function, number):
    if os.getpid() == parent:
        time.sleep(0.2)
        return parent
    return function(number)


def kill(deadly, number):
    if number in deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def die(number):
    os._exit(3)


known = "nothing"


def recall(number):
    return known, os.getpid()


def hears_ctrl_c(number):
    return signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


class LoadsOnlyHere:
    """Work whose module other processes cannot find, larger than a pipe holds."""

    def __init__(self):
        self.ballast = b"x" * 2_000_000

    def __call__(self, number):
        return time.sleep(0.2)

    def __reduce__(self):
        return _load_here, (os.getpid(), self.ballast)


def _load_here(parent, ballast):
    if os.getpid() != parent:
        raise ModuleNotFoundError("No module named 'mine'")
