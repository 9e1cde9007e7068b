"""The settings of the page, as camera.json and as the command line that does the same."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from synthcam_shared.errors import InputError
from synthcam_shared.settings import Settings, build_settings
from tracker.app.film_view import FilmView
from tracker.camera.camera import Camera
from tracker.camera.film_options import FilmOptions
from tracker.camera.recordings import Recording
from tracker.detection.choose import name_channel

FIELDS = {
    "scale": "scale",
    "scale_std": "error of the scale",
    "fps": "frames a second",
    "ball_diameter": "ball diameter",
    "exposure": "exposure",
}
Text = Annotated[str, Field(max_length=100)]


class RunSettings(Settings):
    """The settings of a run. Lengths in m, times in s; None or "" where nothing is set."""

    scale: float | None = None
    scale_std: float | None = None
    fps: float | None = None
    ball_diameter: float | None = None
    exposure: float | None = None
    balls: list[Text] = Field(default_factory=list, max_length=100)
    region: Annotated[str, Field(max_length=5000)] = ""
    frames: Text = ""
    channel: Text = ""
    colour: Text = ""

    def camera_keys(self, given: Mapping[str, Any] | None, size: tuple[int, int]) -> dict[str, Any] | None:
        """The film's own keys of camera.json and what is set, or None. Raises InputError for a scale without a rate."""
        own = {name: value for name in FIELDS if (value := getattr(self, name)) is not None}
        if not own:
            return dict(given) if given is not None else None
        kept = dict(given or {"size": list(size)})
        needed = {"scale": "a scale (two points and the length between them)", "fps": "the frames a second"}
        missing = [words for name, words in needed.items() if given is None and name not in own]
        if missing:
            there = " and ".join(words for name, words in FIELDS.items() if name in own)
            raise InputError(f"set {' and '.join(missing)}, too; or clear {there}, to track in pixels")
        if "scale" in own and own["scale"] != kept.get("scale"):
            void = {"K", "R", "t", "dist", "view_errors", "warp", "scale_std", "calibration"}
            kept = {name: value for name, value in kept.items() if name not in void}
        return {**kept, **own, "assumed": [n for n in kept.get("assumed", []) if n not in own]} if given else kept | own

    @property
    def options(self) -> FilmOptions:
        """How the film is read. Raises InputError."""
        return FilmOptions(frames=self.frames, region=self.region, ball=tuple(self.balls))


class KnownPoints(Settings):
    """Points of the plate that the user knows: x and y in px, and x and y in m, y up."""

    points: list[Annotated[list[float], Field(min_length=4, max_length=4)]] | None = Field(
        None, min_length=4, max_length=1000
    )


@dataclass(frozen=True, eq=False)
class RunPlan:
    """Checked settings: the recording that they make, the keys of its camera, whether these need a file."""

    film: FilmView
    settings: RunSettings
    recording: Recording
    keys: dict[str, Any] | None
    needs_file: bool
    channel: str | None

    def open_apart(self) -> Recording:
        """The recording again, whose frames are read beside those of the page."""
        camera = None if self.keys is None else Camera.from_dict(self.keys)
        return self.film.open_recording(camera, self.settings.options, apart=True)

    def write_command(self, film: Path, camera: Path | None, output: Path) -> list[str]:
        """The words of `tracker track` that does the same."""
        words = ["tracker", "track", name_as_argument(film), "-o", f"{output}"]
        words += ["--camera", f"{camera}"] if camera is not None else []
        for ball in self.settings.balls:
            words += ["--ball", ball]
        for name in ("region", "frames", "channel", "colour"):
            words += [f"--{name}", value] if (value := getattr(self.settings, name)) else []
        return words


def read_run_settings(run: Mapping[str, Any]) -> RunSettings:
    """The settings of a run from the entries of its run.json. Raises InputError."""
    film = run.get("film", {})
    names = {"ball": "balls", "region": "region", "frames": "frames"}
    known = {names[key]: list(value) if key == "ball" else value for key, value in film.items() if key in names}
    channel = run.get("channel", "")
    named = {"colour" if f"{channel}".startswith("#") else "channel": channel}
    return build_settings(known | named, RunSettings, "run.json")


def name_as_argument(film: Path) -> str:
    """Write a path as a word of the command line, which is no option even if the name begins with a dash."""
    return f"./{film}" if f"{film}".startswith("-") else f"{film}"


def make_plan(
    settings: RunSettings, film: FilmView, given: Mapping[str, Any] | None, *, where: str = "camera.json"
) -> RunPlan:
    """Check settings by the code for files and options; given: keys of the film's camera file. Raises InputError."""
    keys = settings.camera_keys(given, film.size)
    channel = name_channel(settings.channel or None, settings.colour)
    recording = film.open_recording(None if keys is None else Camera.from_dict(keys, where), settings.options)
    if channel is not None:
        recording.select_channel(channel)
    return RunPlan(film, settings, recording, keys, keys is not None and keys != given, channel)


def join_words(words: list[str]) -> str:
    """Join the words of the command line for a shell. Raises InputError for a word that no terminal shows."""
    if any(not word.isprintable() for word in words):
        raise InputError("command: a name in it has characters that cannot be printed; rename the file")
    return shlex.join(words)
