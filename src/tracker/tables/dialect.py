"""How a text writes a table: comment lines, the mark between cells, decimals, thousands, names of columns."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

LINE = "line"  # name of the index of a table whose rows have numbers of lines
MISSING_MARKS = ("-", "--", "?", ".", "*", "none", "n.a.", "NaN ", "NAN")  # beside those that pandas knows
_NUMBER = re.compile(r"[-+]?(\d[\d.,]*|[.,]\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)|-*|[?.*]|none|null|na|n/a", re.IGNORECASE)
_EITHER = r"(?<![\d.,])[-+]?\d{1,3},\d{3}(?![\d.,])"


@dataclass(frozen=True)
class TableLine:
    """A line of a text that is part of the table, with its number in the file, from 1."""

    number: int
    text: str


@dataclass(frozen=True)
class Dialect:
    """delimiter: between cells; decimal, thousands: of numbers; doubt: a number that may be read in two ways."""

    delimiter: str
    decimal: str = "."
    thousands: str = ""
    doubt: str = ""

    def split(self, text: str) -> list[str]:
        """The cells of a line."""
        return split_cells(text, self.delimiter)


def split_lines(text: str) -> tuple[list[TableLine], str, str]:
    """The lines of a table, the delimiter that a first line `sep=` names, and the last comment line above the table."""
    lines, delimiter, comment = list[TableLine](), "", ""
    comment_marks = ("#", "%", "//")
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        if not lines and not delimiter and (named := re.fullmatch(r'\s*"?sep=(.)"?\s*', line, re.IGNORECASE)):
            delimiter = named[1]
        elif line.lstrip().startswith(comment_marks):
            comment = comment if lines else line.lstrip().lstrip("#%/").strip()
        else:
            lines.append(TableLine(number, line))
    return lines, delimiter, comment


def find_dialect(lines: Sequence[TableLine], delimiter: str = "", decimal: str = "") -> Dialect:
    """The dialect of a table. delimiter, decimal: where they are known."""
    delimiter = delimiter or _find_delimiter(lines)
    text = "\n".join(line.text for line in lines)
    if delimiter == ",":  # a comma inside a cell is there only in quotes
        text = "\n".join(re.findall(r'"[^"\n]*"', text)) if '"' in text else ""
    if decimal:
        other = "." if decimal == "," else ","
        return Dialect(delimiter, decimal, other if other in text else "")
    dotted = r"(?<![\d.,])[-+]?\d{1,3}(?:(?:\.\d{3})+,\d|(?:\.\d{3}){2,}(?![\d.]))"
    if re.search(dotted, text):
        return Dialect(delimiter, ",", ".")
    if "," not in text:
        return Dialect(delimiter)
    decimal_comma = r"(?<![\d.,])[-+]?(?:\d+,(?:\d{1,2}|\d{4,})|0\d*,\d+|\d{4,},\d+)(?![\d.,])"
    if re.search(decimal_comma, text):
        return Dialect(delimiter, ",")
    grouped = r"(?<![\d.,])[-+]?\d{1,3}(?:,\d{3}){2,}(?![\d,])|(?<![\d.,])[-+]?\d{1,3}(?:,\d{3})+\.\d"
    if re.search(grouped, text):
        return Dialect(delimiter, ".", ",")
    doubt = re.search(_EITHER, text)
    if doubt and _mixes_whole_numbers(lines, delimiter):
        return Dialect(delimiter, ".", ",")
    return Dialect(delimiter, "," if doubt else ".", "", doubt[0] if doubt else "")


def _mixes_whole_numbers(lines: Sequence[TableLine], delimiter: str) -> bool:
    """Tell whether a column has numbers such as 1,234 and others such as 987.

    A program that writes three decimals always does; one that drops zeros writes fewer in some numbers too.
    """
    # ten numbers with exactly three decimals do not occur by chance
    least = 10
    rows = [split_cells(line.text, delimiter) for line in lines[1:2000]]
    for column in zip(*(row for row in rows if len(row) == len(rows[-1])), strict=True):
        grouped = sum(re.fullmatch(_EITHER, cell) is not None for cell in column)
        plain = sum(re.fullmatch(r"[-+]?\d{1,3}", cell) is not None for cell in column)
        if grouped >= least and plain:
            return True
    return False


def split_cells(text: str, delimiter: str) -> list[str]:
    """Split a line of a text table into its cells, without blanks and quotes around them."""
    if delimiter == " ":
        text = " ".join(text.split())
    try:
        cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:  # a line that is no text
        cells = text.split(delimiter)
    return [cell.strip() for cell in cells]


def is_number(cell: str) -> bool:
    """Tell whether a cell is a number or the mark of a missing one, in any dialect."""
    return _NUMBER.fullmatch(re.sub(r"(?<=\d)[\s'’](?=\d{3})", "", cell.strip())) is not None


def _find_delimiter(lines: Sequence[TableLine]) -> str:
    """The mark that cuts most lines into equally many cells, most of which are numbers."""
    # the lines above the numbers are a few; a hundred lines show the rest
    sample = [line.text for line in (*lines[:60], *lines[60 :: max(len(lines) // 40, 1)])]
    sample = sample[4:] if len(sample) > 8 else sample[1:] or sample
    best, score = "", 0.0
    delimiters = ("\t", ";", "|", ",", " ")  # " " stands for any run of blanks
    for mark in delimiters:
        rows = [split_cells(text, mark) for text in sample]
        cells, many = Counter(map(len, rows)).most_common(1)[0] if rows else (0, 0)
        if cells < 2:
            continue
        own = [cell for row in rows if len(row) == cells for cell in row]
        good = many / len(rows) * (0.1 + sum(map(is_number, own)) / len(own))
        if good > score + 1e-9:
            best, score = mark, good
    first = "\n".join(line.text for line in lines[:4])
    return best or next((mark for mark in delimiters[:-1] if mark in first), " " if " " in first.strip() else ",")
