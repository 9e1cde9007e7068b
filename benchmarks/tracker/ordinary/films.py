"""Cases of films: axes that are not time, pixels that are not light, times that the film states, hidden files."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from benchmarks.tracker.ordinary.case import Case
from benchmarks.tracker.ordinary.judges import Measured
from benchmarks.tracker.ordinary.sources import film_discs, film_glints, film_uneven, track

video: Any = importlib.import_module("tracker_video")
Writer = Callable[[Path], Path]
TWICE = "every frame twice"
LOST = (30, 31, 32, 40, 47, 48)  # frames that a camera dropped


def write_tiff(name: str, change: Callable[[NDArray[Any]], NDArray[Any]], **how: Any) -> Writer:
    """The film of glints as a TIFF stack, its frames changed."""

    def write(folder: Path) -> Path:
        tifffile.imwrite(folder / name, change(film_glints().frames), **how)
        return folder / name

    return write


def write_pictures(numbers: Sequence[int], frames: Sequence[int], hidden: bool = False) -> Writer:
    """Pictures of some frames of the film of glints, with numbers in their names; hidden: and what macOS adds."""

    def write(folder: Path) -> Path:
        film = folder / "film"
        film.mkdir()
        for number, frame in zip(numbers, frames, strict=True):
            cv2.imwrite(str(film / f"img_{number:04d}.png"), film_glints().frames[frame])
            if hidden:
                (film / f"._img_{number:04d}.png").write_bytes(b"\0\5\x16\7Mac OS X")
        if hidden:
            (film / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0")
            (film / ".DS_Store").write_bytes(b"\0\0\0\1Bud1")
            cv2.imwrite(str(film / ".img_0007.png"), film_glints().frames[0])
        return film

    return write


def add_channel(frames: NDArray[Any]) -> NDArray[Any]:
    """(T, 2, Y, X): beside each frame one of noise, as a second channel."""
    noise = np.random.default_rng(1).integers(20, 60, frames.shape, dtype=np.uint8)
    return np.stack([frames, noise], axis=1)


def split_colours(frames: NDArray[Any]) -> NDArray[Any]:
    """(T, 3, Y, X): the same light in red, green and blue."""
    return np.stack([frames] * 3, axis=1)


def write_palette(folder: Path) -> Path:
    """Entries of a palette in an order that no one would take for light."""
    order = np.random.default_rng(2).permutation(256)
    grey = np.tile(order.astype(np.uint16) * 257, (3, 1))
    entries = np.argsort(order)[film_glints().frames].astype(np.uint8)
    tifffile.imwrite(folder / "film.tif", entries, photometric="palette", colormap=grey)
    return folder / "film.tif"


def write_zarr(folder: Path) -> Path:
    """Two channels in a Zarr array with names of axes."""
    zarr = importlib.import_module("zarr")
    both = add_channel(film_glints().frames)
    array = zarr.create_array(
        str(folder / "film.zarr"), shape=both.shape, dtype=both.dtype, dimension_names=("t", "c", "y", "x")
    )
    array[:] = both
    return folder / "film.zarr"


def write_netcdf(folder: Path) -> Path:
    """Two channels, before time, in a NetCDF 4 file as other programs write it: HDF5 with scales of dimensions."""
    h5py = importlib.import_module("h5py")
    both = np.moveaxis(add_channel(film_glints().frames), 1, 0)
    with h5py.File(folder / "film.nc", "w") as file:
        film = file.create_dataset("film", data=both)
        for k, name in enumerate(("channel", "time", "y", "x")):
            scale = file.create_dataset(name, data=np.arange(both.shape[k]))
            scale.make_scale(name)
            film.dims[k].attach_scale(scale)
    return folder / "film.nc"


def write_lossless(times: Callable[[int], int], rate: int) -> Writer:
    """The film of glints in FFV1, each frame at a time in ticks of 1/rate s; a negative time drops the frame."""

    def write(folder: Path) -> Path:
        frames = film_glints().frames
        kept = [k for k in range(len(frames)) if times(k) >= 0]
        stamps = [times(k) for k in kept]
        return Path(
            video.encode(folder / "film.mkv", frames[kept], "ffv1", "gray", rate=rate, times=stamps)
        )  # fmt: skip

    return write


def write_interlaced(folder: Path) -> Path:
    """The film of discs with half the frames, each of two fields of successive instants, the upper first."""
    frames = film_discs().frames
    woven = frames[::2].copy()
    woven[:, 1::2] = frames[1::2, 1::2]
    options = {"crf": "8", "x264-params": "tff=1"}
    return Path(video.encode(folder / "film.mp4", woven, options=options, rate=60))


def write_dropped_mp4(folder: Path) -> Path:
    """The film of discs in H.264 without some frames, whose time stamps show that."""
    frames = film_discs().frames
    kept = [k for k in range(len(frames)) if k not in (33, 34)]
    return Path(
        video.encode(folder / "film.mp4", frames[kept], options={"crf": "10"}, rate=120, times=kept)
    )  # fmt: skip


def write_uneven(folder: Path) -> Path:
    """Frames at uneven times, which the time stamps have, ms."""
    filmed, times = film_uneven()
    return Path(video.encode(folder / "film.mkv", filmed.frames, "ffv1", "gray", rate=1000, times=times))


def write_deltas(folder: Path) -> Path:
    """OME-TIFF whose DeltaT of the planes shows the lost frames."""
    kept = [k for k in range(60) if k not in LOST]
    times = [k / film_glints().camera["fps"] for k in kept]
    tifffile.imwrite(folder / "film.ome.tif", film_glints().frames[kept],
                     metadata={"axes": "TYX", "Plane": {"DeltaT": times}}, photometric="minisblack")  # fmt: skip
    return folder / "film.ome.tif"


def list_axes() -> dict[str, tuple[Writer, Measured]]:
    """Stacks with axes that are not time, and pixels that are not light."""
    truth = film_glints().truth
    two = Measured(truth, says=("channel 0 of 2",))
    axes = {"axes": "TCYX"}
    return {
        "OME-TIFF with two channels": (write_tiff("film.ome.tif", add_channel, metadata=axes), two),
        "ImageJ TIFF with two channels": (write_tiff("film.tif", add_channel, imagej=True, metadata=axes), two),
        "Zarr with two channels": (write_zarr, two),
        "NetCDF with two channels, before time": (write_netcdf, two),
        "OME-TIFF with two focal planes": (
            write_tiff("film.ome.tif", add_channel, metadata={"axes": "TZYX"}),
            Measured(truth, says=("focal plane 0 of 2",)),
        ),
        "OME-TIFF whose planes come before time": (
            write_tiff(
                "film.ome.tif", lambda frames: np.moveaxis(add_channel(frames), 1, 0), metadata={"axes": "ZTYX"}
            ),
            Measured(truth, says=("focal plane 0 of 2",)),
        ),
        "samples of a pixel that differ": (
            write_tiff("film.tif", lambda frames: np.moveaxis(add_channel(frames), 1, -1), photometric="minisblack",
                       planarconfig="contig", extrasamples=("unspecified",)),
            Measured(truth, says=("sample of a pixel 0 of 2",)),
        ),
        "planar RGB": (
            write_tiff("film.tif", split_colours, photometric="rgb", planarconfig="separate"), Measured(truth),
        ),
        "MinIsWhite": (
            write_tiff("film.tif", lambda frames: 255 - frames, photometric="miniswhite"),
            Measured(truth, says=("MinIsWhite",)),
        ),
        "palette": (write_palette, Measured(truth, says=("palette",))),
        "16 bits": (write_tiff("film.tif", lambda frames: frames.astype(np.uint16)), Measured(truth)),
    }  # fmt: skip


def list_times() -> dict[str, tuple[Writer, Measured]]:
    """Films whose frames are not evenly spaced, or not those of the camera's rate."""
    truth = film_glints().truth
    twice, kept = np.repeat(np.arange(60), 2), [k for k in range(60) if k not in LOST]
    missing = Measured(truth, says=("6 frames are missing",))
    return {
        "MKV with dropped frames that the time stamps show": (
            write_lossless(lambda k: -1 if k in LOST else k, 250), missing,
        ),
        "time stamps of playback at 25 frames a second": (
            write_lossless(lambda k: k, 25), Measured(truth, says=("a factor of 10",)),
        ),
        "pictures with every second number": (
            write_pictures(range(0, 60, 2), range(0, 60, 2)), Measured(truth, says=("one frame in 2",)),
        ),
        "pictures with six numbers missing": (write_pictures(kept, kept), missing),
        TWICE: (write_tiff("film.tif", lambda frames: frames[twice]), Measured(truth, says=("60 frames repeat",))),
        "OME-TIFF with DeltaT of lost frames": (write_deltas, missing),
    }  # fmt: skip


def list_cases() -> list[Case]:
    """Cases of axes, of pixels, of times and of folders."""
    truth, slow = film_glints().truth, film_discs().truth
    hidden = write_pictures(range(60), range(60), hidden=True), Measured(truth, says=("hidden files",))
    topics = {
        "axes": list_axes(),
        "times": list_times(),
        "folders": {"._ files of macOS, hidden files and Thumbs.db": hidden},
    }
    rates: dict[str, dict[str, Any]] = {TWICE: {"fps": 500.0}}
    exchanged = write_tiff(
        "film.tif", lambda frames: add_channel(frames)[:, ::-1], imagej=True, metadata={"axes": "TCYX"}
    )
    return [
        *(Case(topic, kind, track(write, **rates.get(kind, {})), judge)
          for topic, kinds in topics.items() for kind, (write, judge) in kinds.items()),
        Case("axes", "the second of two channels, by --select",
             track(exchanged, film_glints, "--select", "C=1"), Measured(truth)),
        Case("times", "MP4 with a dropped frame", track(write_dropped_mp4, film_discs),
             Measured(slow, says=("2 frames are missing",))),
        Case("times", "MKV of a phone, frames 4 to 12 ms apart",
             track(write_uneven, lambda: film_uneven()[0], fps=125),
             Measured(slow, says=("frame times are uneven",))),
        Case("times", "interlaced", track(write_interlaced, film_discs, fps=60),
             Measured(slow, says=("fields", "the upper first"))),
    ]  # fmt: skip
