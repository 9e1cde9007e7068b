"""Films of numpy.save, and pictures with names that are not UTF-8: the same frames as from a stack."""

import os
import sys
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile

import tracker
from synthcam_shared.errors import InputError
from tracker.camera import film_in_memory
from tracker.camera.recordings import open_frames, open_source
from tracker.tables.read import read_tracks

FILM = np.random.default_rng(0).integers(0, 250, (5, 24, 32), dtype=np.uint8)


def saved(tmp_path, array):
    np.save(tmp_path / "film.npy", array)
    return tmp_path / "film.npy"


@pytest.mark.parametrize(
    "array",
    [
        FILM,
        FILM.astype(np.uint16) * 256,
        FILM.astype(">u2") * 256,
        np.asfortranarray(FILM),
        FILM[::-1, ::-1],
        np.stack([FILM] * 3, axis=-1),
    ],
    ids=["8 bits", "16 bits", "big end", "Fortran", "strides", "colour"],
)
def test_a_saved_array_is_a_film(array, tmp_path):
    frames = open_frames(saved(tmp_path, array))
    expected = array if array.ndim == 3 else array[..., 0]
    assert frames.shape == (5, 24, 32)
    np.testing.assert_array_equal(np.stack(list(frames)), expected)
    assert frames.dtype.isnative
    assert (frames.colours is not None) == (array.ndim == 4)


def test_it_is_not_read_into_memory(tmp_path):
    """A film of 8 GB on a disk with holes opens at once."""
    header = np.lib.format.open_memmap(tmp_path / "film.npy", "w+", np.uint8, (2000, 2000, 2000))
    header[1500, 7, 9] = 200
    del header
    frames = open_source(tmp_path / "film.npy").clips[0][1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(film_in_memory, "drop_equal_pictures", lambda frames, fetch: frames)
        assert open_frames(frames)[1500][7, 9] == 200


def test_it_gives_the_tracks_of_the_stack(tmp_path):
    ys, xs = np.mgrid[:24, :32]
    film = np.stack([np.exp(-((xs - 8 - k) ** 2 + (ys - 12) ** 2) / 3) * 150 + 20 for k in range(12)])
    film = (film + np.random.default_rng(1).normal(0, 1, film.shape)).astype(np.uint8)
    tifffile.imwrite(tmp_path / "film.tif", film, photometric="minisblack")
    one = tracker.track(saved(tmp_path, film), detector="centroid").tracks
    other = tracker.track(tmp_path / "film.tif", detector="centroid").tracks
    pd.testing.assert_frame_equal(one, other)
    assert len(one)


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (FILM.astype(float), "float pixels, expected counts"),
        (FILM[0], r"an array \(24, 32\), expected \(frames, height, width\)"),
        (FILM[:, :0], r"an array \(5, 0, 32\)"),
        (FILM.astype(bool), "pixels of type bool"),
        (np.array([{}], dtype=object), "cannot be read as an array of numpy.save"),
        (FILM[:1], "one frame only"),
    ],
)
def test_what_is_no_film_is_one_line(array, said, tmp_path):
    with pytest.raises(InputError, match=rf"film\.npy: {said}") as error:
        open_frames(saved(tmp_path, array))
    assert "\n" not in str(error.value)


def test_damage_and_other_files_are_one_line(tmp_path):
    path = saved(tmp_path, FILM)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match=r"film\.npy: cannot be read as an array"):
        open_frames(path)
    (tmp_path / "film.xyz").write_bytes(b"CDF\1")
    with pytest.raises(InputError, match=r"array of numpy\.save \(\.npy\), HDF5 or NetCDF, not a \.xyz file"):
        open_source(tmp_path / "film.xyz")


@pytest.mark.skipif(sys.platform != "linux", reason="names are text elsewhere")
def test_pictures_may_have_any_name(tmp_path):
    """OpenCV ended the whole program at such a name."""
    for k, picture in enumerate(FILM):
        data = cv2.imencode(".png", picture)[1].tobytes()
        Path(os.fsdecode(os.fsencode(tmp_path) + b"/gr\xf6\xdfe%d.png" % k)).write_bytes(data)
    np.testing.assert_array_equal(np.stack(list(open_frames(tmp_path))), FILM)


@pytest.mark.parametrize(
    ("name", "module", "said"),
    [
        ("t.xlsx", "openpyxl", r"read with openpyxl, which is not installed; type: pip install 'synthcam\[tables\]'"),
        ("t.h5", "tables", "read with tables, which is not installed; type: pip install tables, or save as CSV"),
    ],
)
def test_a_missing_package_is_named(name, module, said, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"\x89HDF\r\n\x1a\n")
    if module == "openpyxl":
        with zipfile.ZipFile(tmp_path / name, "w") as book:
            book.writestr("xl/workbook.xml", "<workbook/>")
    with pytest.raises(InputError, match=said):
        read_tracks(tmp_path / name, {"fps": 250.0, "size": [64, 48], "scale": 1e-4, "ball_diameter": 2e-3})
