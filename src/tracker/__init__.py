"""Finds, follows and measures rolling balls in video. Knows nothing of how the video was made."""

import lazy_loader

# Names of __init__.pyi are imported when they are first used, because plotting and fitting load slowly.
_load_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def __getattr__(name: str) -> object:
    if name != "__version__":
        return _load_name(name)
    from importlib.metadata import version  # loads for 30 ms, in which Ctrl-C would end a command with a traceback

    return version("synthcam")
