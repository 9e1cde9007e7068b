"""Which colour of a film shows all balls: a red ball on green cloth may be as grey as the cloth."""

from __future__ import annotations

import numpy as np

from tracker.camera.camera import Camera
from tracker.camera.camera_keys import CHANNELS
from tracker.camera.frames import GREY, Frame, Frames
from tracker.camera.lens import Array
from tracker.camera.recordings import Recording
from tracker.detection.candidates import estimate_noise, median_of_nine
from tracker.detection.choose import ALIKE, LEAST, find_round_bodies

MORE = 1.25  # times the bodies that are seen in grey, from which on
EXTRA = 6  # and by so many, a colour is taken instead


def select_channel(clip: Recording, name: str | None) -> tuple[Recording, str]:
    """A recording in the channel ``name``, or in that which its film asks for, and why, for a note.

    Raises InputError for a channel that the film has not.
    """
    if name is not None:
        return clip.select_channel(name), ""
    best, why = choose_channel(clip.frames, clip.camera)
    return clip.select_channel(best), why


def choose_channel(frames: Frames, camera: Camera) -> tuple[str, str]:
    """Choose a channel from frames spread over a film.

    Parameters
    ----------
    frames : Frames
    camera : Camera
        Bodies have about its balls' diameter, where that is known.

    Returns
    -------
    str
        "grey", unless "red", "green" or "blue" shows more round bodies of one size that move: a quarter more, and
        EXTRA in nine frames.
    str
        Why, for a note; '' for grey.
    """
    if frames.colours is None:
        return GREY, ""
    picks = [round(k * (len(frames) - 1) / 8) for k in range(9)]
    colours = [np.asarray(frames.colours(k)) for k in picks]
    layers = {name: [np.array(picture[..., k]) for picture in colours] for k, name in enumerate(CHANNELS[1:])}
    expected = camera.diameter_px / 2 if camera.knows_diameter else None
    seen = {name: _bodies(shots, expected) for name, shots in ({GREY: [frames[k] for k in picks]} | layers).items()}
    every = np.concatenate(list(seen.values()))
    usual = float(np.median(every)) if len(every) else 0.0
    number = {name: int((np.abs(radii - usual) < ALIKE * usual).sum()) for name, radii in seen.items()}
    best = max(number, key=lambda name: number[name])  # the first of equals
    if number[best] < max(MORE * number[GREY], number[GREY] + EXTRA):
        return GREY, ""
    few, many = number[GREY], number[best]
    return best, f"channel: {best}, for {many} round bodies are seen in it where grey shows {few}; --channel forces"


def _bodies(pictures: list[Frame], expected: float | None) -> Array:
    """Radii, px, of what is round and differs from the median of nine pictures."""
    level = median_of_nine([picture.copy() for picture in pictures]).astype(float)
    least = max(LEAST * estimate_noise(pictures), LEAST)
    return np.concatenate([find_round_bodies(picture, level, least, expected) for picture in pictures])
