"""The content of a file, whatever its name: bytes as XML, as text, as cells between delimiters."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any
from xml.parsers import expat

import pandas as pd

from synthcam_shared.errors import InputError
from tracker.camera.camera_keys import first_line, format_value

PARQUET = b"PAR1"
MAX_HEAD_LINES = 4  # lines, at most, before the numbers


@dataclass(frozen=True)
class Content:
    """A file's bytes, and what messages call it."""

    data: bytes
    where: str

    @staticmethod
    def of(path: Path) -> Content:
        """Raises InputError for what is no file."""
        if not path.is_file():
            what = "a folder" if path.is_dir() else "no such file"
            raise InputError(f"{path}: {what}, expected a table of tracks (CSV or Parquet)")
        return Content(path.read_bytes(), str(path))

    def wrong(self, what: str) -> InputError:
        """An error that names the file."""
        return InputError(f"{self.where}: {what}")

    @cached_property
    def text(self) -> str:
        """In the encoding that its mark says, in UTF-8, or in Latin-1, where any byte is a letter; none of Parquet."""
        if self.data.startswith(PARQUET):
            return ""
        marks = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
        encoding = next((name for mark, name in marks.items() if self.data.startswith(mark)), "utf-8")
        try:
            return self.data.decode(encoding)
        except UnicodeDecodeError:
            return self.data.decode("latin-1")

    @cached_property
    def root(self) -> ET.Element | None:
        """Of XML; None for what does not begin as XML does. Raises InputError where it is damaged.

        No document type is read: entities, external ones too, come with it, and none of these formats has one.
        """
        if not self.text.lstrip().startswith("<"):
            return None
        # all of an XML file is held in memory, many times as large
        if len(self.data) > (1 << 28):
            raise self.wrong(f"more than {1 << 8} MB of XML")
        builder, depth = ET.TreeBuilder(), 0

        def start(tag: str, attributes: dict[str, str]) -> None:
            nonlocal depth
            depth += 1
            # levels; files of TrackMate have 6, those of Tracker 12
            if depth > 50:
                raise self.wrong("XML nested too deeply for tracks")
            builder.start(tag, attributes)

        def end(tag: str) -> None:
            nonlocal depth
            depth -= 1
            builder.end(tag)

        def refuse(*_: Any) -> None:
            raise self.wrong("XML with a document type, which no file of tracks has")

        parser = expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = builder.data, refuse
        try:
            parser.Parse(self.data, True)
        except (expat.ExpatError, ValueError, LookupError) as error:  # the latter two of encodings
            raise self.wrong(f"damaged XML ({first_line(error)})") from None
        return builder.close()

    @cached_property
    def head(self) -> list[list[str]]:
        """The cells of the first lines."""
        return [[cell.strip().strip('"') for cell in line.split(self.delimiter)] for line in self._lines]

    @cached_property
    def _lines(self) -> list[str]:
        return [line.rstrip("\r\n") for _, line in zip(range(MAX_HEAD_LINES + 1), StringIO(self.text), strict=False)]

    @property
    def delimiter(self) -> str:
        """Between cells."""
        first = "\n".join(self._lines[:MAX_HEAD_LINES])
        # a comma may be a decimal one where another character delimits
        return next((mark for mark in ("\t", ";", ",") if mark in first), " ")

    def cells(self, skip: int = 0, names: list[str] | None = None) -> pd.DataFrame:
        """The cells as a table, from line `skip` on, which names the columns unless `names` does.

        Raises InputError where it is none.
        """
        options: dict[str, Any] = {"sep": self.delimiter, "skiprows": skip}
        if names is not None:
            options |= {"header": None, "names": names, "index_col": False}
        if self.delimiter != "," and re.search(r"\d,\d", "".join(self._lines)):
            options["decimal"] = ","
        try:
            if self.data.startswith(PARQUET):
                return pd.read_parquet(BytesIO(self.data))
            table: pd.DataFrame = pd.read_csv(StringIO(self.text), **options)
            return table
        except Exception as error:  # readers raise their own kinds
            raise self.wrong(f"cannot be read as a table of tracks ({first_line(error)})") from None

    def attribute(self, element: ET.Element, name: str) -> str:
        """Of an element of XML. Raises InputError where it is missing."""
        if name not in element.attrib:
            raise self.wrong(f"<{format_value(element.tag, quoted=False)}> without {name}")
        return element.attrib[name]

    def number(self, element: ET.Element, name: str) -> float:
        """An attribute that is a number."""
        return self._number(element, name, self.attribute(element, name))

    def number_in(self, element: ET.Element) -> float:
        """The number between an element's tags."""
        return self._number(element, element.get("name", ""), element.text or "")

    def _number(self, element: ET.Element, name: str, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            tag = format_value(f"<{element.tag}> {name}", quoted=False)
            raise self.wrong(f"{tag}: expected a number, not {format_value(text)}") from None
