"""Reads a recording of many balls from results and observes it as a gas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.gas.energy import SINKS
from tracker.gas.gas import GasCamera, GasObservables, GasSettings, Rectangle, measure_gas
from tracker.gas.gas_page import summarise_gas, write_gas
from tracker.measurement.camera_errors import camera_errors
from tracker.measurement.collision.adequacy import is_seen_to_glide
from tracker.measurement.positions import to_ball_tracks
from tracker.recording import Result
from tracker.results import list_clips, read_clip, read_contact_table, read_rows

_GLIDING = (
    "the tracks show bodies that glide, as on air; if that is right, write support: air (and body) into the camera file"
)


@dataclass(frozen=True, eq=False, repr=False)
class Gas(GasObservables):
    """A recording of many balls as a gas. Energies and temperatures are per unit mass, m^2/s^2.

    Attributes
    ----------
    time : DataFrame
        A row for each frame: temperature, mean velocity, energy, and energies lost by sink.
    pairs : DataFrame
        Pair correlation: r, g, g_std.
    velocities : DataFrame
        Distribution of the components of velocities over sqrt(temperature): c, density, density_std.
    values : dict
        Single numbers, each with NAME_std where it has an error.
    area : tuple
        Left, bottom, right, top of the rectangle of the centres, m.
    name, diameter, notes : str, float, tuple of str
        Of the recording; diameter of a ball, m; what limits the values.

    Examples
    --------
    >>> import numpy as np, pandas as pd, tracker
    >>> frame, step = np.arange(40), np.array([[0.3, 0.1], [-0.2, 0.0], [0.0, -0.4]])
    >>> paths = [100 + 200 * k + frame[:, None] * step[k] for k in range(3)]
    >>> tables = [pd.DataFrame(p, columns=["x", "y"]).assign(frame=frame, particle=k) for k, p in enumerate(paths)]
    >>> camera = {"size": [800, 800], "fps": 250, "scale": 1e-4, "ball_diameter": 1e-3}
    >>> gas = tracker.observe_gas(tracker.measure(pd.concat(tables), camera))
    >>> bool(np.isclose(gas.time["temperature"][0], step.var(axis=0, ddof=1).mean() * (250 * 1e-4) ** 2))
    True
    """

    def __repr__(self) -> str:
        return "\n".join([f"Gas of {self.name}", *(f"  {line}" for line in summarise_gas(self))])

    def report(self, folder: Path | str, command: str = "tracker.observe_gas") -> Path:
        """Write gas.json, the tables and index.html into a folder.

        Parameters
        ----------
        folder : Path or str
            A new folder, or an earlier gas, which is replaced.
        command : str
            What made it, for the foot of the page.

        Returns
        -------
        Path
            The page.
        """
        return write_gas(self, Path(folder), command)


def observe_gas(
    source: Result | Path | str,
    *,
    number: int | None = None,
    area: Sequence[float] | None = None,
    settings: GasSettings | None = None,
) -> Gas:
    """Observe a recording of many balls as a gas: temperature, velocities, order, contacts, and energy by sink.

    Parameters
    ----------
    source : Result, Path or str
        What `track` or `measure` returned, or RESULTS of the command.
    number : int, optional
        Of the clip, in RESULTS with several.
    area : sequence of 4 float, optional
        Left, bottom, right and top of the rectangle that the centres can reach, m, in the axes of the world. Without
        it: the rectangle that they reached.
    settings : GasSettings, optional
        How velocities and distributions are estimated.

    Returns
    -------
    Gas

    Raises
    ------
    InputError
        No such results or clip, a camera without lengths, fewer than three balls together, or an impossible area.

    Examples
    --------
    >>> import synthcam, tracker
    >>> clip = synthcam.Scene.read("tray", timing={"frames": 20}).draw(seed=1)
    >>> table = clip.tracks[["frame", "particle"]].assign(x=clip.tracks.x_mean_px, y=clip.tracks.y_mean_px)
    >>> gas = tracker.observe_gas(tracker.measure(table, clip.camera_json))
    >>> first = clip.tracks[clip.tracks.frame == 0][["vx", "vy"]].var(ddof=1).mean()
    >>> bool(abs(gas.time["temperature"][0] / first - 1) < 0.05)
    True
    """
    if isinstance(source, Result):
        name, tracks, camera, contacts = f"clip {source.number}", source.found, source.camera, source.contacts
        rows: Sequence[Mapping[str, Any]] = source.rows
    else:
        name, tracks, camera, contacts, rows = _read(Path(source), number)
    if not (camera.metric and camera.knows_diameter):
        raise InputError(f"{name}: the camera file has no scale or no ball_diameter; a gas needs both, and fps")
    balls, shares = to_ball_tracks(tracks, camera), {error.key: error.share for error in camera_errors(camera)}
    errors = [shares.get(key, 0.0) for key in ("scale", "fps", "ball_diameter")]
    glides = camera.glides or is_seen_to_glide(rows)
    known = GasCamera(camera.ball_diameter, camera.fps, glides, *errors)
    gas = measure_gas(balls, contacts, known, area=_check_area(area), settings=settings)
    notes = _limits(gas, camera) + [_GLIDING] * (glides and not camera.glides)
    return Gas(**vars(gas) | {"name": name, "notes": tuple(notes)})


def _read(results: Path, number: int | None) -> tuple[str, Tracks, Camera, pd.DataFrame, Sequence[Mapping[str, Any]]]:
    """Read one clip of RESULTS: its name, tracks, camera, contacts, and rows of estimates."""
    numbers = list_clips(results)
    if number is None and len(numbers) > 1:
        raise InputError(f"{results}: {len(numbers)} clips; name one of {numbers[0]} to {numbers[-1]} by --clip")
    chosen = numbers[0] if number is None else number
    if chosen not in numbers:
        raise InputError(f"--clip {chosen}: not in {results}, which has {len(numbers)}, {numbers[0]} to {numbers[-1]}")
    name, contacts = f"{results.resolve().name}, clip {chosen}", read_contact_table(results, chosen)
    return name, *read_clip(results, chosen), contacts, read_rows(results, chosen)


def parse_area(text: str) -> list[float] | None:
    """Parse the option --area of `tracker gas`: "LEFT,BOTTOM,RIGHT,TOP"; None of an empty text. Raises InputError."""
    if not text:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        example = "expected LEFT,BOTTOM,RIGHT,TOP in m, such as -0.03,-0.02,0.03,0.02"
        raise InputError(f"--area {text!r}: {example}") from None


def _check_area(area: Sequence[float] | None) -> Rectangle | None:
    """The rectangle of numbers that may be none."""
    if area is None:
        return None
    values = [float(one) for one in area]
    if len(values) != 4 or not np.isfinite(values).all() or not (values[0] < values[2] and values[1] < values[3]):
        raise InputError(f"--area {area}: expected LEFT,BOTTOM,RIGHT,TOP in m, left before right, bottom before top")
    left, bottom, right, top = values
    return left, bottom, right, top


def _limits(gas: GasObservables, camera: Camera) -> list[str]:
    """Notes on what limits the values."""
    notes, max_unresolved = [], 0.1
    lost = gas.time.iloc[-1][list(SINKS.values())].astype(float).abs()
    if (unresolved := float(lost["lost_unresolved"] / max(lost.sum(), 1e-300))) > max_unresolved:
        notes.append(
            f"{100 * unresolved:.0f} % of the lost energy is not resolved: after many contacts "
            "the slide or the free path has too few frames; a higher frame rate resolves it"
        )
    min_free_frames, min_seen_frames = 20, 4  # between contacts, on average
    between = camera.fps / gas.values["contact_rate"] if gas.values["contact_rate"] else np.inf
    by_theory = float((gas.time["balls"] + gas.time["unknown"]).sum()) / max(2 * gas.values["contacts_theory"], 1e-300)
    if by_theory < min_seen_frames:
        notes.append(
            f"hard discs of this density and temperature would have {by_theory:.1f} frames between contacts; under "
            f"{min_seen_frames} most contacts are not seen, and temperature and energies are off by more than their "
            "errors; a higher frame rate shows them"
        )
    elif between < min_free_frames:
        notes.append(
            f"a ball has {between:.1f} frames between contacts; under {min_free_frames} the temperature is "
            "some per cent too low, which its error allows for"
        )
    if hidden := int(gas.time["unknown"].iloc[0]):
        notes.append(
            f"{hidden} ball{'s' * (hidden > 1)} in view in the first frame had no velocity yet; the energies leave out "
            "what they lost before their first one"
        )
    if abs(np.log(gas.values["noise_ratio"])) > np.log(1.5):
        notes.append(
            f"the noise of positions is {gas.values['noise_ratio']:.2f} times what the tracks claim; all values here "
            "use the measured noise"
        )
    return notes
