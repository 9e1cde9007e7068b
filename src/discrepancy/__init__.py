"""Find where simulation and measurement disagree, and which physics the model lacks."""

import lazy_loader

# Load each import of __init__.pyi at its first use, because drawing and fitting take long to load.
_load_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def __getattr__(name: str) -> object:
    if name != "__version__":
        return _load_name(name)
    from importlib.metadata import version  # loads for 30 ms, in which Ctrl-C would end a command with a traceback

    return version("synthcam")
