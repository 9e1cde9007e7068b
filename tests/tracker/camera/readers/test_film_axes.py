"""Stacks and pictures with axes that are not time, and with pixels that are not light, held to what was written."""

import json

import cv2
import numpy as np
import pytest
import tifffile

from synthcam_shared.errors import InputError
from tracker.camera.film_options import FilmOptions
from tracker.camera.recordings import open_frames

RNG = np.random.default_rng(46)
MOVIE = RNG.integers(0, 255, (6, 40, 50), dtype=np.uint8)
OTHER = RNG.integers(0, 255, (6, 40, 50), dtype=np.uint8)
COLOUR = RNG.integers(0, 255, (6, 40, 50, 3), dtype=np.uint8)


def held(path, select=""):
    frames = open_frames(path, FilmOptions(select=select))
    return np.array(list(frames)), "\n".join(frames.faults)


@pytest.mark.parametrize("kind", ["ome", "imagej", "tifffile"])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("deep", [False, True])
def test_two_channels_are_no_frames(tmp_path, kind, packed, deep):
    both = np.stack([MOVIE, OTHER], axis=1).astype(np.uint16 if deep else np.uint8) * (100 if deep else 1)
    path = tmp_path / ("stack.ome.tif" if kind == "ome" else "stack.tif")
    how = {"imagej": True} if kind == "imagej" else {}
    how |= {"compression": "zlib"} if packed and kind != "imagej" else {}
    tifffile.imwrite(path, both, metadata={"axes": "TCYX"}, photometric="minisblack", **how)
    film, notes = held(path)
    assert np.array_equal(film, both[:, 0])
    assert notes == "channel 0 of 2 (0 to 1) is taken; --select C=N takes another"
    assert np.array_equal(held(path, "C=1")[0], both[:, 1])


def test_channels_before_time(tmp_path):
    tifffile.imwrite(tmp_path / "a.ome.tif", np.stack([MOVIE, OTHER]), metadata={"axes": "CTYX"})
    assert np.array_equal(held(tmp_path / "a.ome.tif")[0], MOVIE)
    assert np.array_equal(held(tmp_path / "a.ome.tif", "c=1")[0], OTHER)


def test_a_stack_of_planes_and_channels(tmp_path):
    whole = RNG.integers(0, 255, (6, 3, 2, 40, 50), dtype=np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", whole, imagej=True, metadata={"axes": "TZCYX"})
    film, notes = held(tmp_path / "a.tif", "Z=2, C=1")
    assert np.array_equal(film, whole[:, 2, 1])
    assert "focal plane 2 of 3" in notes
    assert "channel 1 of 2" in notes


def test_planes_without_time_are_frames_and_channels_are_not(tmp_path):
    """ImageJ calls the frames of most films slices."""
    both = np.stack([MOVIE, OTHER], axis=1)
    tifffile.imwrite(tmp_path / "a.tif", MOVIE, imagej=True, metadata={"axes": "ZYX"})
    assert held(tmp_path / "a.tif")[1] == ""
    assert np.array_equal(held(tmp_path / "a.tif")[0], MOVIE)
    tifffile.imwrite(tmp_path / "b.tif", both, imagej=True, metadata={"axes": "ZCYX"})
    film, notes = held(tmp_path / "b.tif")
    assert np.array_equal(film, MOVIE)
    assert "axis Z (focal plane) is taken as time, because the file names no time" in notes


def test_an_axis_or_an_entry_that_is_not_there_is_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.ome.tif", np.stack([MOVIE, OTHER], axis=1), metadata={"axes": "TCYX"})
    for select, words in {
        "C=2": "--select C=2: expected 0 to 1",
        "Z=1": "--select Z: no such axis beside time, expected one of T (6), C (2)",
        "C": "--select: 'C': expected AXIS=NUMBER, such as C=1",
        "C=first": "--select: 'C=first': expected AXIS=NUMBER",
    }.items():
        with pytest.raises(InputError) as error:
            held(tmp_path / "a.ome.tif", select)
        assert words in str(error.value)


@pytest.mark.parametrize("kind", ["plain", "zlib", "imagej"])
def test_planar_colour_is_colour(tmp_path, kind):
    planes = np.ascontiguousarray(np.moveaxis(COLOUR, -1, 1))
    how = {"compression": "zlib"} if kind == "zlib" else {}
    tifffile.imwrite(tmp_path / "a.tif", planes, photometric="rgb", planarconfig="separate", **how)
    frames = open_frames(tmp_path / "a.tif")
    assert frames.shape == (6, 40, 50)
    assert frames.colours is not None
    assert np.array_equal(np.array([frames.colours(k) for k in range(6)]), COLOUR)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_white_as_zero_is_inverted(tmp_path, packed, dtype):
    movie = MOVIE.astype(dtype) * (200 if dtype == np.uint16 else 1)
    how = {"compression": "zlib"} if packed else {}
    tifffile.imwrite(tmp_path / "a.tif", np.iinfo(dtype).max - movie, photometric="miniswhite", **how)
    film, notes = held(tmp_path / "a.tif")
    assert film.dtype == dtype
    assert np.array_equal(film, movie)
    assert notes == "MinIsWhite: counts are inverted"


def test_pictures_with_white_as_zero_are_inverted(tmp_path):
    for k, picture in enumerate(MOVIE):
        tifffile.imwrite(tmp_path / f"{k}.tif", 255 - picture, photometric="miniswhite")
    film, notes = held(tmp_path)
    assert np.array_equal(film, MOVIE)
    assert notes == "MinIsWhite: counts are inverted"


@pytest.mark.parametrize("stack", [True, False])
def test_a_palette_is_converted(tmp_path, stack):
    """An order of entries that no one would take for light."""
    order = RNG.permutation(256)
    grey = np.tile(order.astype(np.uint16) * 257, (3, 1))
    entries = np.argsort(order)[MOVIE].astype(np.uint8)
    if stack:
        tifffile.imwrite(tmp_path / "a.tif", entries, photometric="palette", colormap=grey)
    else:
        for k, picture in enumerate(entries):
            tifffile.imwrite(tmp_path / f"{k}.tif", picture, photometric="palette", colormap=grey)
    film, notes = held(tmp_path / "a.tif" if stack else tmp_path)
    assert np.array_equal(film, MOVIE)
    assert notes == "palette: converted to grey"


def test_a_palette_of_colours_is_colour(tmp_path):
    table = RNG.integers(0, 256, (3, 256)).astype(np.uint16) * 257
    tifffile.imwrite(tmp_path / "a.tif", MOVIE, photometric="palette", colormap=table)
    frames = open_frames(tmp_path / "a.tif")
    assert frames.colours is not None
    assert np.array_equal(frames.colours(2), (table.T >> 8)[MOVIE[2]])


def test_more_samples_than_colours_are_selected(tmp_path):
    many = RNG.integers(0, 255, (6, 40, 50, 6), dtype=np.uint8)
    extra = ["unspecified"] * 5
    tifffile.imwrite(tmp_path / "a.tif", many, photometric="minisblack", planarconfig="contig", extrasamples=extra)
    film, notes = held(tmp_path / "a.tif", "S=4")
    assert np.array_equal(film, many[..., 4])
    assert "sample of a pixel 4 of 6" in notes


@pytest.mark.parametrize(("extra", "named"), [("unspecified", True), ("unassalpha", False)])
def test_samples_that_are_no_transparency_are_named_and_selected(tmp_path, extra, named):
    path, pixels = tmp_path / "film.tif", np.stack([MOVIE, 255 - MOVIE], axis=-1)
    tifffile.imwrite(path, pixels, photometric="minisblack", planarconfig="contig", extrasamples=(extra,))
    film, notes = held(path)
    assert np.array_equal(film, MOVIE)
    assert ("sample of a pixel 0 of 2" in notes) is named
    assert np.array_equal(held(path, "S=1")[0], 255 - MOVIE)


def test_hidden_files_are_skipped(tmp_path):
    for k, picture in enumerate(MOVIE):
        cv2.imwrite(str(tmp_path / f"{k}.png"), picture)
        (tmp_path / f"._{k}.png").write_bytes(b"\0\5\x16\7 Mac OS X")
    (tmp_path / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0")
    (tmp_path / ".DS_Store").write_bytes(b"Bud1")
    (tmp_path / "camera.json").write_text(json.dumps({}))
    film, notes = held(tmp_path)
    assert np.array_equal(film, MOVIE)
    assert notes == "8 hidden files are skipped: .DS_Store, ._0.png, ._1.png, ..."
