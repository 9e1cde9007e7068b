"""Pages that stand alone: templates, one style for all, and figures within the page."""

from __future__ import annotations

import base64
import io
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
from markupsafe import Markup
from matplotlib.figure import Figure

HERE = Path(__file__).parent


def render(template: Path, **values: Any) -> str:
    """A template with the common style, filled in; what it names and is not given is an error."""
    loader = jinja2.FileSystemLoader([template.parent, HERE])
    page = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    page.filters["symbol"] = _typeset_symbol
    return page.get_template(template.name).render(**values)


def embed_figure(figure: Figure) -> str:
    """The figure as the address of an SVG picture that the page itself holds."""
    stream = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "synthcam"}):  # the same names inside for the same figure
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return make_data_uri(stream.getvalue(), "image/svg+xml")


def make_data_uri(data: bytes, kind: str) -> str:
    """The address of data that the page itself holds."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def describe_creation(command: str) -> str:
    """When a page was made, by what."""
    return f"Made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by synthcam {version('synthcam')}: {command}"


def _typeset_symbol(symbol: str) -> Markup:
    """A symbol as print has it: what follows _ up to the next / is its index."""
    return Markup("/").join(_typeset_indexed(part) for part in symbol.split("/"))


def _typeset_indexed(symbol: str) -> Markup:
    base, _, index = symbol.partition("_")
    return Markup("<i>{}</i><sub>{}</sub>").format(base, index) if index else Markup("<i>{}</i>").format(base)
