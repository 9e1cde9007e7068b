"""A page for each public name of the libraries, from their `__all__` and their docstrings."""

from __future__ import annotations

import dataclasses
import inspect
from importlib import import_module
from pathlib import Path

from myst_text import paragraphs, plain, table

LIBRARIES = ("synthcam", "tracker", "tracker.benchmark", "discrepancy")


def pages(root: Path) -> dict[str, str]:
    """By name under docs/generated."""
    made, lists = {}, []
    seen: set[int] = set()  # a name that several libraries share is indexed once
    for library in LIBRARIES:
        module = import_module(library)
        names = [
            n for n in sorted(module.__all__) if not n.startswith("__") and not inspect.ismodule(getattr(module, n))
        ]
        rows = []
        for name in names:
            thing = getattr(module, name)
            made[f"api/{library}.{name}.md"] = page(f"{library}.{name}", thing, id(thing) in seen)
            seen.add(id(thing))
            rows.append([f"[`{library}.{name}`]({library}.{name}.md)", plain(paragraphs(thing)[0])])
        entries = "\n".join(f"{library}.{name}" for name in names)
        lists.append(
            f"## {library}\n\n{plain(paragraphs(module)[0])}\n\n{table(['name', 'what it is'], rows)}\n\n"
            f"```{{toctree}}\n:hidden:\n\n{entries}\n```\n"
        )
    made["api/index.md"] = (
        "# The libraries\n\nEvery public name. [A tour](../../library.md) shows them at work.\n\n" + "\n".join(lists)
    )
    return made


def page(name: str, thing: object, again: bool) -> str:
    """A public name and, of a class, what it can do; again: it has been indexed."""
    is_class = inspect.isclass(thing)
    lines = [f".. auto{'class' if is_class else 'function'}:: {name}"]
    lines += ["   :no-index:"] * again
    if is_class:
        lines += ["   :members:", "   :member-order: bysource"]
        lines += ["   :inherited-members:"] * any(map(dataclasses.is_dataclass, inspect.getmro(thing)[1:]))
    body = "\n".join(lines)
    return f"# {name}\n\n```{{eval-rst}}\n{body}\n```\n"
