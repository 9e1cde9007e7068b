"""How a table of tracks is read: the names of its columns, its unit, its decimal mark, and the point that it gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

from synthcam_shared.arguments import check_keywords
from synthcam_shared.errors import InputError

POINTS = ("centre", "glint")


class TableKeywords(TypedDict, total=False):
    """The fields of `TableOptions`, as keywords of a function."""

    point: str
    columns: str
    unit: str
    decimal: str


@dataclass(frozen=True)
class TableOptions:
    """Options of reading a table of tracks."""

    point: str = "centre"  # of a ball that x and y give: its centre, mean over the exposure, or its "glint"
    columns: str = ""  # the table's own names or numbers of columns, as in "x=POS_X,y=POS_Y,frame=FRAME,track=TRACK_ID"
    unit: str = ""  # of lengths: px, m, cm, mm, ...; "" for what the table says, or px
    decimal: str = ""  # mark of the numbers in a file, "." or ","; "" for what the numbers show

    @staticmethod
    def of(given: TableKeywords) -> TableOptions:
        """Make the options of keywords. Raises InputError for an unknown one, and for a value of another type."""
        check_keywords(given, TableKeywords.__annotations__)
        return TableOptions(**given)

    def __post_init__(self) -> None:
        if self.point not in POINTS:
            raise InputError(f"--point: expected {' or '.join(POINTS)}, not {self.point!r}")


DEFAULT_TABLE_OPTIONS = TableOptions()
