"""The public names of a package, which are imported when they are first used."""

from __future__ import annotations

TYPE_CHECKING = False  # as in typing, which loads for some ms
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def attach_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the functions `__getattr__` and `__dir__` of a package whose `__init__.pyi` lists its public names.

    They also give `__version__` and `__all__`. Nothing is imported before one of them is called. The libraries that
    this needs load for 10 to 30 ms, in which Ctrl-C would end a command with a traceback.
    """
    stub: tuple[Callable[[str], Any], list[str]] | None = None

    def read_stub() -> tuple[Callable[[str], Any], list[str]]:
        nonlocal stub
        if stub is None:
            import lazy_loader

            load, _, names = lazy_loader.attach_stub(package, file)
            stub = load, [*names, "__version__"]
        return stub

    def load_name(name: str) -> Any:
        if name == "__version__":
            from importlib.metadata import version

            return version("synthcam")
        load, names = read_stub()
        return names if name == "__all__" else load(name)

    return load_name, lambda: read_stub()[1]
