"""Writes docs/generated before each build: pages that are made of the code, so that no list is kept by hand."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import api_pages
import command_pages
import notebook_pages
import plugin_pages

MAKERS = (api_pages, command_pages, notebook_pages, plugin_pages)


def write(app: Any) -> None:
    """Write what has changed, and take away what is made no more."""
    folder = Path(app.srcdir) / "generated"
    pages: dict[str, bytes] = {}
    for maker in MAKERS:
        made = maker.pages(Path(app.srcdir).parent)
        pages |= {name: text if isinstance(text, bytes) else text.encode() for name, text in made.items()}
    for old in folder.rglob("*"):
        if old.is_file() and str(old.relative_to(folder)) not in pages:
            old.unlink()
    for name, content in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_bytes() != content:  # an unchanged page is not read again
            path.write_bytes(content)
    for empty in sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True):
        if not any(empty.iterdir()):
            shutil.rmtree(empty)


def setup(app: Any) -> dict[str, Any]:
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
