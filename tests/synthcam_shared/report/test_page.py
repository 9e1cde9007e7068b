"""A report page is one self-contained file: text is escaped, columns are aligned, figures lie within it."""

import base64
import re

import pytest
from jinja2 import UndefinedError
from markupsafe import Markup
from matplotlib.figure import Figure

from synthcam_shared.report.page import (
    PageFigure,
    PageList,
    PageSection,
    PageTable,
    render,
    typeset_symbol,
    write_page,
)


def figure():
    drawn = Figure(figsize=(2, 1))
    drawn.subplots().plot([0, 1], [1, 0])
    return drawn


def test_a_page_holds_everything_and_asks_for_nothing(tmp_path):
    table = PageTable(["name", "value"], [["<b>", "1.2(3)"]], "title of the table", "note of the table")
    blocks = ["a < b", Markup("<p id='x'>as it is</p>"), table, PageFigure.of(figure(), "a picture", "its caption")]
    sections = [
        PageSection("first", blocks),
        PageSection("empty"),
        PageSection("", [PageList(["one", "two"], ordered=True)]),
    ]
    path = write_page(tmp_path / "new" / "index.html", "T & C", sections, "tool run", ["it is so"], ["mind this"])
    assert [p.name for p in path.parent.iterdir()] == ["index.html"]
    text = path.read_text(encoding="utf-8")
    for part in (
        "<h1>T &amp; C</h1>",
        "<h2>first</h2>",
        "<p>a &lt; b</p>",
        "<p id='x'>as it is</p>",
        "&lt;b&gt;",
        "title of the table",
        "note of the table",
        "<ol><li>one</li><li>two</li></ol>",
        "it is so",
        "<li>mind this</li>",
        "its caption",
        "<code>tool run</code>",
    ):
        assert part in text
    assert "<h2>empty</h2>" not in text
    assert not re.search(r'(?:src|href)\s*=\s*["\'](?!data:)', text)
    (source,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', text)
    assert b"<svg" in base64.b64decode(source)


def test_columns_of_numbers_are_not_text():
    rows = [["a", "1.2", "–", "12 µm", "none", "1 " * 20], ["b", "-3·10⁻⁴", "+0.2", "", "2", "2"]]
    assert PageTable(list("abcdef"), rows).classes == ["text", "", "", "", "text", "text"]
    assert PageTable(["a"], []).classes == [""]


def test_the_same_figure_has_the_same_address():
    assert PageFigure.of(figure(), "one") == PageFigure.of(figure(), "one")


def test_a_name_that_is_not_given_is_an_error(tmp_path):
    (tmp_path / "one.html").write_text("{{ here }}{{ there }}")
    with pytest.raises(UndefinedError, match="there"):
        render(tmp_path / "one.html", here="&")


@pytest.mark.parametrize(
    ("symbol", "html"),
    [("r", "<i>r</i>"), ("v_1f", "<i>v</i><sub>1f</sub>"), ("E/E_0", "<i>E</i>/<i>E</i><sub>0</sub>")],
)
def test_an_index_is_set_low(symbol, html):
    assert typeset_symbol(symbol) == html
