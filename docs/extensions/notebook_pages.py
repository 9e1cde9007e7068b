"""The notebooks of examples/ as pages, with the outputs that `make notebooks` stored and the tests hold them to."""

from __future__ import annotations

import base64
import json
import posixpath
import re
from pathlib import Path
from typing import Any

from myst_text import fence


def pages(root: Path) -> dict[str, str | bytes]:
    """By name under docs/generated."""
    made: dict[str, str | bytes] = {}
    names = []
    for path in sorted((root / "examples").glob("*.ipynb")):
        names.append(path.stem)
        made |= page(path)
    entries = "\n".join(names)
    made["notebooks/index.md"] = (
        "# Notebooks\n\nThey lie in `examples/`; the tests run them, and `make notebooks` stores their outputs.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{entries}\n```\n"
    )
    return made


def page(path: Path) -> dict[str, str | bytes]:
    """One notebook, and the pictures that it drew."""
    made: dict[str, str | bytes] = {}
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(relinked(source))
            continue
        parts.append(fence(source, "python"))
        for output in cell["outputs"]:
            picture = output.get("data", {}).get("image/png")
            if picture:
                name = f"{path.stem}_{len(made) + 1}.png"
                made[f"notebooks/{name}"] = base64.b64decode("".join(picture))
                parts.append(f"![what the cell drew]({name})")
            else:
                parts.append(printed(output))
    made[f"notebooks/{path.stem}.md"] = "\n\n".join(parts) + "\n"
    return made


def printed(output: dict[str, Any]) -> str:
    """The printed text of a cell, or the value of its last line, as a table if it has one."""
    if "text" in output:
        return fence("".join(output["text"]))
    data = output["data"]
    if "text/html" in data:
        return '```{raw} html\n<div class="output">' + "".join(data["text/html"]) + "</div>\n```"
    return fence("".join(data["text/plain"]))


def relinked(text: str) -> str:
    """Links relative to examples/ made relative to the page."""

    def there(found: re.Match[str]) -> str:
        target = found[2]
        if target.startswith(("http", "#")):
            return found[0]
        if target.endswith(".ipynb"):
            return f"[{found[1]}]({target.removesuffix('.ipynb')}.md)"
        return f"[{found[1]}]({posixpath.relpath('examples/' + target, 'docs/generated/notebooks')})"

    return re.sub(r"\[([^\]]+)\]\(([^)]+)\)", there, text)
