"""Make frames with their truth without end, in memory."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Literal, overload

from synthcam.dataset.labelled_frame import LabelledFrame, label_frames
from synthcam.scene.scene import Scene
from synthcam_shared.arguments import check_arguments
from synthcam_shared.errors import InputError

MAX_FAILURES_IN_A_ROW = 10  # of clips that cannot be made; then the scene is at fault


@overload
def stream(
    scene: Scene | str | Path,
    seed: int = 0,
    start: int = 0,
    step: int = 1,
    stop: int | None = None,
    every: int = 1,
    by: Literal["frame"] = "frame",
) -> Iterator[LabelledFrame]: ...
@overload
def stream(
    scene: Scene | str | Path,
    seed: int = 0,
    start: int = 0,
    step: int = 1,
    stop: int | None = None,
    every: int = 1,
    *,
    by: Literal["clip"],
) -> Iterator[list[LabelledFrame]]: ...
@check_arguments
def stream(
    scene: Scene | str | Path,
    seed: int = 0,
    start: int = 0,
    step: int = 1,
    stop: int | None = None,
    every: int = 1,
    by: Literal["frame", "clip"] = "frame",
) -> Iterator[LabelledFrame] | Iterator[list[LabelledFrame]]:
    """Make frames with their truth without end, in memory: clip after clip, the frames of each clip in order.

    Scene, seed, number of the clip and number of the frame alone decide a frame, in any process. Clip k is clip k of
    the dataset that ``synthcam generate SCENE --seed`` makes, to the last bit of its pixels.

    Parameters
    ----------
    scene : Scene, str or Path
        A scene, its file, or the name of a scene that comes with synthcam.
    seed : int
        Of everything random.
    start, step : int
        Number of the first clip, and the step to the next. Worker i of n takes ``start=i, step=n``.
    stop : int, optional
        The stream ends before this clip. None: it never ends.
    every : int
        Make every n-th frame of a clip only, from its first on. The others are not rendered.
    by : "frame" or "clip"
        What an item is: a frame, or the list of the frames of a clip.

    Yields
    ------
    LabelledFrame, or list of LabelledFrame
        A clip that cannot be made is left out with a `RuntimeWarning`.

    Raises
    ------
    InputError
        If an argument is wrong, or ten clips in a row cannot be made.
    NoGL
        If no OpenGL can render; `synthcam doctor` says what to install.

    Examples
    --------
    >>> import synthcam
    >>> scene = synthcam.Scene.read("oblique", camera={"size": [96, 64], "scale": 3e-4}, timing={"frames": 40})
    >>> frames = synthcam.stream(scene, seed=1, every=20)
    >>> [(frame.clip.number, frame.frame) for frame, _ in zip(frames, range(4))]
    [(0, 0), (0, 20), (1, 0), (1, 20)]
    """
    for name, value, least in (("seed", seed, 0), ("start", start, 0), ("step", step, 1), ("every", every, 1)):
        if value < least:
            raise InputError(f"{name}: expected {least} or more, not {value}")
    if by not in ("frame", "clip"):
        raise InputError(f"by: expected 'frame' or 'clip', not {by!r}")
    read = scene if isinstance(scene, Scene) else Scene.read(scene)
    numbers = itertools.count(start, step) if stop is None else range(start, stop, step)
    clips = make_clips(read, seed, numbers, every, lambda line: warnings.warn(line, RuntimeWarning, stacklevel=2))
    if by == "frame":
        return itertools.chain.from_iterable(clips)
    return map(list, clips)


def make_clips(
    scene: Scene, seed: int, numbers: Iterable[int], every: int, leave_out: Callable[[str], None]
) -> Iterator[Iterator[LabelledFrame]]:
    """Make the frames of each clip of a stream that can be made. leave_out: takes a line about each other one.

    Raises InputError if too many in a row cannot be made.
    """
    failed: list[str] = []
    for number in numbers:
        try:
            frames = label_frames(scene.draw(number, seed), every)
            first = next(frames)  # solves the motion, and prepares the renderer
        except ValueError as error:
            failed.append(f"clip {number} is left out: {' '.join(str(error).split())}")
            if len(failed) == MAX_FAILURES_IN_A_ROW:
                reason = f"{len(failed)} clips in a row cannot be made; the last: {error}"
                raise InputError(f"{scene.where}: {' '.join(reason.split())}") from None
            continue
        while failed:
            leave_out(failed.pop(0))
        yield itertools.chain([first], frames)
    for line in failed:
        leave_out(line)
