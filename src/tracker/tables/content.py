"""The content of a file, whatever its name: bytes as XML, as text, as cells between delimiters, as a binary table."""

from __future__ import annotations

import re
import tempfile
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
import pandas as pd

from synthcam_shared.errors import InputError, first_line
from tracker.camera.camera_keys import format_wrong_value
from tracker.tables.dialect import (
    LINE,
    MISSING_MARKS,
    Dialect,
    TableLine,
    find_dialect,
    is_number,
    split_cells,
    split_lines,
)


@dataclass(frozen=True)
class FileContent:
    """A file's bytes, and what messages call it."""

    data: bytes
    where: str
    decimal: str = ""  # of numbers, "," or "."; "": as the numbers show

    @staticmethod
    def of(path: Path, decimal: str = "") -> FileContent:
        """Raises InputError for what is no file."""
        if decimal not in ("", ",", "."):
            raise InputError(f"--decimal: expected , or . and not {format_wrong_value(decimal)}")
        if not path.is_file():
            what = "a folder" if path.is_dir() else "no such file"
            raise InputError(f"{path}: {what}, expected a table of tracks (CSV, Excel, Parquet, ...)")
        return FileContent(path.read_bytes(), str(path), decimal)

    def wrong(self, what: str) -> InputError:
        """An error that names the file."""
        return InputError(f"{self.where}: {what}")

    @property
    def is_binary(self) -> bool:
        """Tell whether the file is a table that is no text: Parquet, Feather, HDF5, Excel."""
        return self.archive not in ("", "zip") or self.is_excel

    @cached_property
    def archive(self) -> str:
        """The kind of binary file, by its first bytes; "" for any other."""
        marks = {b"PAR1": "parquet", b"ARROW1": "feather", b"\x89HDF": "hdf5", b"PK\3\4": "zip"}
        marks |= {b"\xd0\xcf\x11\xe0": "old excel"}
        return next((kind for mark, kind in marks.items() if self.data.startswith(mark)), "")

    @property
    def is_excel(self) -> bool:
        """Tell whether the file is a workbook of Excel or LibreOffice; both are archives."""
        return self.archive == "zip" and (b"xl/workbook" in self.data or b"opendocument.spreadsheet" in self.data)

    @cached_property
    def text(self) -> str:
        """In the encoding that its mark says, UTF-8, or Latin-1, where any byte is a letter; "" of a binary table."""
        if self.is_binary:
            return ""
        marks = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
        encoding = next((name for mark, name in marks.items() if self.data.startswith(mark)), "utf-8")
        try:
            return self.data.decode(encoding)
        except UnicodeDecodeError:
            return self.data.decode("latin-1")

    @cached_property
    def root(self) -> ET.Element | None:
        """The root element of XML; None if the text does not begin as XML does. Raises InputError if it is damaged.

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
    def lines(self) -> list[TableLine]:
        """The lines of the table, without empty lines and comments."""
        return self._parts[0]

    @cached_property
    def _parts(self) -> tuple[list[TableLine], str, str]:
        return split_lines(self.text)

    @cached_property
    def dialect(self) -> Dialect:
        """How the text writes cells and numbers."""
        return find_dialect(self.lines, self._parts[1], self.decimal)

    @cached_property
    def notes(self) -> list[str]:
        """Describe what a reader of the numbers has to know."""
        doubt = self.dialect.doubt
        if not doubt:
            return []
        line = next(line.number for line in self.lines if doubt in line.text)
        read = f"{doubt} read as {doubt.replace(',', '.')}"
        return [f"{Path(self.where).name}: line {line}: {read}; --decimal . if its comma separates thousands"]

    @cached_property
    def head(self) -> list[list[str]]:
        """The cells of the first lines."""
        max_head_lines = 4  # above the numbers
        return [self.dialect.split(line.text) for line in self.lines[: max_head_lines + 1]]

    @cached_property
    def has_header(self) -> bool:
        """Tell whether the first line, or the comment above it, names the columns."""
        return bool(self._comment_names) or not self.head or not all(map(is_number, self.head[0]))

    @cached_property
    def _comment_names(self) -> list[str]:
        """Names of columns in a comment, as numpy.savetxt writes them."""
        comment = self._parts[2]
        if not comment or not self.head or not all(map(is_number, self.head[0])):
            return []
        names = next((n for n in (self.dialect.split(comment), comment.split()) if len(n) == len(self.head[0])), [])
        return [] if any(map(is_number, names)) else names

    def cells(self, skip: int = 0, names: list[str] | None = None) -> pd.DataFrame:
        """The cells as a table, from line `skip` on, which names the columns unless `names` does.

        The index counts lines of the file where it is named `LINE`. Raises InputError where there is no table.
        """
        if self.is_binary:
            return self._read_binary()
        if names is None and self._comment_names:
            names = self._comment_names
        lines = self.lines[skip:]
        if names is None:
            if not lines:
                return pd.DataFrame()
            names, lines = self.dialect.split(lines[0].text), lines[1:]
        return self._parse(lines, names)

    def _parse(self, lines: list[TableLine], names: list[str]) -> pd.DataFrame:
        """Lines as a table with these names of columns."""
        mark = self.dialect.delimiter
        is_split_slowly = mark == " " or any('"' in line.text for line in lines)
        count = (lambda text: len(split_cells(text, mark))) if is_split_slowly else lambda text: text.count(mark) + 1
        counts = np.array([count(line.text) for line in lines], dtype=int)
        names, widest = list(names), int(counts.max(initial=0))
        if widest > len(names):
            names = self._complete(lines, names, counts)
        names = [name if names.index(name) == k else f"{name}.{k}" for k, name in enumerate(names)]
        # one more column takes the empty cell behind a delimiter at the end of a line
        spare = [f"\0{k}" for k in range(max(widest - len(names), 0))]
        try:
            table: pd.DataFrame = pd.read_csv(
                StringIO("\n".join(line.text for line in lines)),
                sep=r"\s+" if mark == " " else mark,
                decimal=self.dialect.decimal,
                thousands=self.dialect.thousands or None,
                header=None,
                names=[*names, *spare],
                index_col=False,
                na_values=list(MISSING_MARKS),
                skipinitialspace=True,
                skip_blank_lines=False,
                low_memory=False,
            )
        except Exception as error:  # readers raise their own kinds
            if not lines:
                return pd.DataFrame(columns=names)
            raise self.wrong(f"cannot be read as a table of tracks ({first_line(error)})") from None
        table = table[names]
        if len(table) == len(lines):
            table.index = pd.Index([line.number for line in lines], name=LINE)
        texts = {name: self._plain(table[name]) for name in names if not pd.api.types.is_numeric_dtype(table[name])}
        return table.assign(**texts) if texts else table

    def _complete(self, lines: list[TableLine], names: list[str], counts: Any) -> list[str]:
        """Names of columns where lines have more cells: row numbers without a name come first.

        An empty cell at the end of a line has no name. Raises InputError for any other cell.
        """
        most = int(np.bincount(counts).argmax())
        last = [self.dialect.split(line.text) for line in lines[:20]]
        if most == len(names) + 1 and not all(len(cells) < most or cells[-1] == "" for cells in last):
            names = ["", *names]
        for line in (lines[k] for k in np.flatnonzero(counts > len(names))):
            cells = self.dialect.split(line.text)
            if any(cells[len(names) :]):
                raise self.wrong(
                    f"line {line.number}: {len(cells)} cells, expected {len(names)}; --columns x=NAME,... and"
                    " --decimal say how to read a table"
                )
        return names

    def _plain(self, values: pd.Series) -> pd.Series:
        """Texts of which some may be numbers, these as Python writes them."""
        marks, texts = self.dialect, values.astype(object)
        known = texts.notna()
        plain = texts[known].astype(str).str.strip()
        number = plain.str.replace(r"(?<=\d)[\s'’](?=\d{3})", "", regex=True)
        if marks.thousands:
            number = number.str.replace(marks.thousands, "", regex=False)
        if marks.decimal == ",":
            number = number.str.replace(",", ".", regex=False)
        is_numeric = pd.to_numeric(number, errors="coerce").notna()
        missing = plain.isin(MISSING_MARKS)
        texts[known] = plain.where(~is_numeric, number).where(~missing, np.nan)
        return pd.to_numeric(texts).astype(float) if known.any() and (is_numeric | missing).all() else texts

    def _read_binary(self) -> pd.DataFrame:
        """A table of Parquet, Feather, HDF5 or Excel."""
        need, source = "", BytesIO(self.data)
        try:
            if self.archive == "parquet":
                return pd.read_parquet(source)
            if self.archive == "feather":
                return pd.read_feather(source)
            if self.archive == "hdf5":
                need = "tables"
                return _read_hdf5(self.data)
            need = "xlrd" if self.archive == "old excel" else "openpyxl" if b"xl/workbook" in self.data else "odfpy"
            return pd.read_excel(source)
        except ImportError:
            package = "'synthcam[tables]'" if need == "openpyxl" else need
            raise self.wrong(
                f"read with {need}, which is not installed; type: pip install {package}, or save as CSV"
            ) from None
        except Exception as error:  # readers raise their own kinds
            raise self.wrong(f"cannot be read as a table of tracks ({first_line(error)})") from None

    def attribute(self, element: ET.Element, name: str) -> str:
        """Of an element of XML. Raises InputError where it is missing."""
        if name not in element.attrib:
            raise self.wrong(f"<{format_wrong_value(element.tag, quoted=False)}> without {name}")
        return element.attrib[name]

    def number(self, element: ET.Element, name: str = "") -> float:
        """An attribute that is a number; without its name the number between the element's tags."""
        text = self.attribute(element, name) if name else element.text or ""
        try:
            return float(text)
        except ValueError:
            tag = format_wrong_value(f"<{element.tag}> {name or element.get('name', '')}", quoted=False)
            raise self.wrong(f"{tag}: expected a number, not {format_wrong_value(text)}") from None


def _read_hdf5(data: bytes) -> pd.DataFrame:
    """The table of a file of pandas, or all frames of one of trackpy, which has a table for each."""
    with tempfile.NamedTemporaryFile(suffix=".h5") as copy:
        copy.write(data)
        copy.flush()
        with pd.HDFStore(copy.name, "r") as store:
            keys = [key for key in store.keys() if not key.startswith("/_")]  # noqa: SIM118
            frames = [key for key in keys if re.fullmatch(r"/Frame_\d+", key)] or keys[:1]
            tables: list[Any] = [store[key] for key in frames]
            whole: pd.DataFrame = pd.concat(tables, ignore_index=True)
            return whole
