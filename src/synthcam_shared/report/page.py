"""A self-contained HTML page of text, tables and figures; its look is `style.css`, its frame `page.html`."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import jinja2
from markupsafe import Markup

from synthcam_shared.outputs import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class PageTable:
    """A table of text cells; `title` stands over it, `note` under it. A `Markup` cell may hold HTML."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    note: str = ""
    kind: ClassVar = "table"

    @property
    def classes(self) -> list[str]:
        """Class of each column: "text", aligned on the left, where a cell is no number or has over 24 characters."""
        number = re.compile(r"(?=.{0,24}$)([-+−±]?[.\d]|[-–]?$)")
        columns = [[str(row[k]) for row in self.rows if k < len(row)] for k in range(len(self.heads))]
        return ["" if all(number.match(cell) for cell in column) else "text" for column in columns]


@dataclass(frozen=True)
class PageFigure:
    """A picture within the page; `title` is read out where the picture cannot be shown, `caption` explains it."""

    title: str
    address: str
    caption: str = ""
    kind: ClassVar = "figure"

    @classmethod
    def of(cls, figure: Figure, title: str, caption: str = "") -> PageFigure:
        """Embed a matplotlib figure as SVG; the same figure gives the same bytes."""
        import matplotlib as mpl

        stream = io.BytesIO()
        with mpl.rc_context({"svg.hashsalt": "synthcam"}):
            figure.savefig(stream, format="svg", metadata={"Date": None})
        return cls(title, make_data_uri(stream.getvalue(), "image/svg+xml"), caption)


@dataclass(frozen=True)
class PageList:
    """Lines with a dot or, where ordered, a number before each."""

    lines: Sequence[str]
    ordered: bool = False
    kind: ClassVar = "list"


Block = str | PageTable | PageFigure | PageList


@dataclass(frozen=True)
class PageSection:
    """A heading and what follows it. A plain string is a paragraph; a `Markup` string is inserted unchanged."""

    title: str
    blocks: Sequence[Block] = field(default_factory=list)


def write_page(
    path: Path,
    title: str,
    sections: Sequence[PageSection],
    command: str,
    summary: Sequence[str] = (),
    warnings: Sequence[str] = (),
) -> Path:
    """Write the HTML of a page aside and move it into place; return its path.

    Sections without blocks are left out. The foot names `command`, which made the page. The summary
    becomes paragraphs under the title, the warnings a highlighted list.
    """
    made = f"Made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by synthcam {version('synthcam')}: "
    texts = {"title": title, "summary": summary, "warnings": warnings, "made": made, "command": command}
    filled = [section for section in sections if section.blocks]
    write_atomically(path, render(Path(__file__).with_name("page.html"), sections=filled, **texts))
    return path


def render(template: Path, **values: Any) -> str:
    """Render the HTML of a page from a template, which may include files of its folder and of this one."""
    loader = jinja2.FileSystemLoader([template.parent, Path(__file__).parent])
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    return environment.get_template(template.name).render(**values)


def make_axes(rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **shared: Any) -> tuple[Figure, Any]:
    """Make a figure of a page and its axes, without pyplot, which would show them in a notebook; figsize: inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=figsize, layout="constrained")
    return figure, figure.subplots(rows, columns, **shared)


def make_data_uri(data: bytes, kind: str) -> str:
    """Make an address that holds a page's picture or data itself; kind: the media type."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def typeset_symbol(symbol: str) -> Markup:
    """Typeset a symbol as HTML: letters in italics, and as an index what follows "_" up to the next "/"."""
    parts = []
    for part in symbol.split("/"):
        base, _, index = part.partition("_")
        html = Markup("<i>{}</i><sub>{}</sub>") if index else Markup("<i>{}</i>")
        parts.append(html.format(base, index))
    return Markup("/").join(parts)
