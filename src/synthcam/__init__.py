"""Rolling steel balls: their exact motion, their picture, and the truth about both."""

import lazy_loader

# The names of __init__.pyi are imported when they are first used: drawing and fitting take long to load.
_load_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def __getattr__(name: str) -> object:
    if name != "__version__":
        return _load_name(name)
    from importlib.metadata import version  # loads for 30 ms, in which Ctrl-C would end a command with a traceback

    return version("synthcam")
