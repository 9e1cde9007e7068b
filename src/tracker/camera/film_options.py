"""How a film is read: which times, which channel of its file, and what is done with fields."""

from __future__ import annotations

from dataclasses import dataclass

from synthcam_shared.errors import InputError

TIMES = ("auto", "file", "even")
FIELDS = ("auto", "separate", "weave")
AXES = "CZSPAHEVRQI"  # letters of tifffile and OME: channel, focal plane, sample, position, ...


@dataclass(frozen=True)
class FilmOptions:
    """Options of reading a film.

    Attributes
    ----------
    times : {"auto", "file", "even"}
        "auto": spacing of frames from the film, rate from the camera file. "file": both from the film. "even": frames
        are evenly spaced, whatever the film says.
    select : str
        Entries of axes that are not time, as in "C=1,Z=0"; others take their first.
    fields : {"auto", "separate", "weave"}
        Of interlaced video: "separate" makes two frames of each, "weave" leaves them; "auto" looks at the film.
    """

    times: str = "auto"
    select: str = ""
    fields: str = "auto"

    def __post_init__(self) -> None:
        for option, value, known in (("--times", self.times, TIMES), ("--fields", self.fields, FIELDS)):
            if value not in known:
                raise InputError(f"{option}: expected one of {', '.join(known)}, not {value!r}")
        self.indices()

    def indices(self) -> dict[str, int]:
        """The entry of each axis that is selected. Raises InputError."""
        found = {}
        for part in filter(None, self.select.replace(" ", "").split(",")):
            axis, _, index = part.partition("=")
            if axis.upper() not in AXES or len(axis) != 1 or not index.isdecimal():
                raise InputError(f"--select: {part!r}: expected AXIS=NUMBER, such as C=1 or Z=0, joined by commas")
            found[axis.upper()] = int(index)
        return found

    def changed(self) -> dict[str, str]:
        """The options that differ from the defaults."""
        plain = FilmOptions.__dataclass_fields__
        return {name: value for name, value in vars(self).items() if value != plain[name].default}


DEFAULT_OPTIONS = FilmOptions()
