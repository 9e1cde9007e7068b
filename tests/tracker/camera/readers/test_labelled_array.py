"""Films in Zarr stores, HDF5 and NetCDF: axes by name, channels, times, and one line for what is no film."""

import importlib.util
import re

import numpy as np
import pytest
from scipy.io import netcdf_file

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.film_options import FilmOptions
from tracker.camera.readers.labelled_array import LabelledArray, name_axes
from tracker.camera.recordings import make_recording, open_frames, open_source

FILM = np.random.default_rng(0).integers(0, 256, (12, 20, 30)).astype(np.uint8)
SECONDS = np.array([0, 1, 2, 3, 6, 7, 8, 9, 10, 11, 12, 13]) * 0.004
needs_zarr = pytest.mark.skipif(not importlib.util.find_spec("zarr"), reason="zarr is not installed: synthcam[zarr]")
needs_hdf5 = pytest.mark.skipif(not importlib.util.find_spec("h5py"), reason="h5py is not installed: synthcam[hdf5]")


def zarr_store(path, data, axes=None, times=None, about=None, of=3):
    import zarr

    root = zarr.open_group(path, mode="w", zarr_format=of)
    known = {"dimension_names": axes} if of == 3 else {"attributes": {"_ARRAY_DIMENSIONS": axes}} if axes else {}
    root.create_array("film", data=data, chunks=(5, *data.shape[1:]), **known)
    root.create_array("small", data=data[:, ::2])
    if times is not None:
        root.create_array("time", data=times[0]).update_attributes({"units": times[1]})
    root.update_attributes(about or {})


def hdf5_file(path, data, axes=(), times=None):
    import h5py

    with h5py.File(path, "w") as file:
        film = file.create_dataset("entry/film", data=data, chunks=(5, *data.shape[1:]), compression=1)
        for k, name in enumerate(axes):
            film.dims[k].label = name
        if times is not None:
            scale = file.create_dataset("entry/time", data=times[0])
            scale.attrs["units"] = times[1]
            scale.make_scale("time")
            film.dims[0].attach_scale(scale)
        file["names"] = np.array([b"a", b"b"])


def classic_file(path, data, axes=("time", "y", "x"), times=None):
    with netcdf_file(path, "w", version=2) as file:
        for name, length in zip(axes, data.shape, strict=True):
            file.createDimension(name, length)
        kept = data.view(np.int8) if data.dtype == np.uint8 else data.astype(">i2")
        file.createVariable("film", kept.dtype, axes)[:] = kept
        if times is not None:
            variable = file.createVariable("time", "f8", ("time",))
            variable[:], variable.units = times


OME = {"multiscales": [{"axes": [{"name": "t", "unit": "millisecond"}, {"name": "c"}, {"name": "y"}, {"name": "x"}],
                        "datasets": [{"path": "film", "coordinateTransformations": [
                            {"type": "scale", "scale": [4.0, 1.0, 1.0, 1.0]}]}]}]}  # fmt: skip
TWO = np.stack([FILM[::-1], FILM], axis=1)


@pytest.mark.parametrize(
    ("write", "select", "fps"),
    [
        pytest.param(lambda p: zarr_store(p, FILM), "", 0, marks=needs_zarr, id="zarr without names"),
        pytest.param(
            lambda p: zarr_store(p, np.moveaxis(FILM, 0, 1), ["y", "time", "x"], of=2), "", 0, marks=needs_zarr,
            id="zarr 2, time in the middle"),
        pytest.param(lambda p: zarr_store(p, TWO, about=OME), "C=1", 250, marks=needs_zarr, id="OME-Zarr"),
        pytest.param(lambda p: zarr_store(p, TWO, about={"ome": OME}), "C=1", 250, marks=needs_zarr, id="OME-Zarr .5"),
        pytest.param(
            lambda p: zarr_store(p, TWO.swapaxes(0, 1), ["clip", "frame", "y", "x"]), "P=1", 0, marks=needs_zarr,
            id="zarr of clips"),
        pytest.param(lambda p: zarr_store(p, FILM.astype(np.int64)), "", 0, marks=needs_zarr, id="zarr of int64"),
        pytest.param(lambda p: hdf5_file(p, FILM), "", 0, marks=needs_hdf5, id="hdf5"),
        pytest.param(
            lambda p: hdf5_file(p, np.moveaxis(FILM, 0, -1), "yxt"), "", 0, marks=needs_hdf5, id="hdf5, time last"),
        pytest.param(lambda p: classic_file(p, FILM), "", 0, id="netcdf 3 of bytes"),
        pytest.param(lambda p: classic_file(p, FILM.astype(np.uint16)), "", 0, id="netcdf 3 of int16"),
    ],
)  # fmt: skip
def test_frames_are_those_written(write, select, fps, tmp_path):
    path = tmp_path / ("film.nc" if write.__code__.co_names[0] != "zarr_store" else "film.zarr")
    write(path)
    frames = open_frames(path, FilmOptions(select=select))
    assert [np.array_equal(frames[k], FILM[k]) for k in (11, 0, 3, 7, 5)] == [True] * 5
    assert (len(frames), frames.fps) == (12, fps)
    assert (frames.dtype == np.uint8) == (np.asarray(frames[0]).dtype == np.uint8)
    assert open_source(path).clips == ((0, path),)


TIMES = [
    ((SECONDS, "s"), 250, [0, 1, 2, 3, 6]),
    ((SECONDS * 1e3, "milliseconds since 2020-01-01 00:00:00"), 250, [0, 1, 2, 3, 6]),
    ((SECONDS, ""), 250, [0, 1, 2, 3, 6]),
    ((SECONDS, "furlong"), 0, [0, 1, 2, 3, 4]),
]


@pytest.mark.parametrize("kind", [
    pytest.param("zarr", marks=needs_zarr), pytest.param("hdf5", marks=needs_hdf5), "classic"])  # fmt: skip
@pytest.mark.parametrize(("times", "fps", "numbers"), TIMES)
def test_a_coordinate_gives_the_times(kind, times, fps, numbers, tmp_path):
    path = tmp_path / {"zarr": "film.zarr", "hdf5": "film.nc", "classic": "film.nc"}[kind]
    write = {"zarr": zarr_store, "hdf5": hdf5_file, "classic": classic_file}[kind]
    write(path, FILM, *([["time", "y", "x"]] if kind == "zarr" else []), times=times)
    frames = open_frames(path)
    assert frames.fps == pytest.approx(fps, rel=1e-6)
    assert frames.numbers[:5].tolist() == numbers
    assert any("2 frames are missing by the coordinate time" in fault for fault in frames.faults) == bool(fps)


@needs_zarr
def test_uneven_times_are_those_of_each_frame(tmp_path):
    own = np.cumsum(np.tile([0.004, 0.00613], 6))
    zarr_store(tmp_path / "film.zarr", FILM, ["time", "y", "x"], (own, "seconds"))
    camera = Camera.from_dict({"size": [30, 20], "fps": 1 / 0.00613, "scale": 1e-3, "ball_diameter": 4e-3})
    frames = make_recording(0, open_frames(tmp_path / "film.zarr"), camera).frames
    np.testing.assert_allclose(frames.seconds, own - own[0], atol=1e-9)


@needs_zarr
@pytest.mark.parametrize(
    ("data", "message"),
    [
        (FILM.astype(np.float32), "float pixels"),
        (FILM[0], "no array of three axes or more"),
        (FILM.astype(np.int32) - 200, "frame 0 has counts from -200 to 55, expected 0 to 65535"),
    ],
)
def test_what_is_no_film_says_so(data, message, tmp_path):
    zarr_store(tmp_path / "film.zarr", data)
    with pytest.raises(InputError, match=message):
        open_frames(tmp_path / "film.zarr")[0]


def test_damaged_files_and_missing_libraries_have_one_line(tmp_path, monkeypatch):
    classic_file(tmp_path / "cut.nc", FILM)
    (tmp_path / "cut.nc").write_bytes((tmp_path / "cut.nc").read_bytes()[:2000])
    with pytest.raises(InputError, match=r"cut.nc: cannot be read, truncated or damaged \("):
        open_frames(tmp_path / "cut.nc")
    (tmp_path / "store.zarr").mkdir()
    (tmp_path / "store.zarr/zarr.json").write_text("{}")
    (tmp_path / "film.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    for name, library, extra in (("store.zarr", "zarr", "zarr"), ("film.h5", "h5py", "hdf5")):
        monkeypatch.setitem(__import__("sys").modules, library, None)
        with pytest.raises(InputError, match=re.escape(f"needs {library}; type: pip install 'synthcam[{extra}]'")):
            open_frames(tmp_path / name)


@pytest.mark.parametrize(
    ("shape", "axes", "letters"),
    [
        ((9, 20, 30), (None,) * 3, "TYX"),
        ((9, 20, 30, 3), (None,) * 4, "TYXS"),
        ((9, 2, 20, 30), (None,) * 4, "QIYX"),
        ((9, 20, 30, 3), ("time", "y", "x", "channel"), "TYXS"),
        ((9, 3, 20, 30), ("time", "channel", "y", "x"), "TCYX"),
        ((9, 20, 30), ("exposure", "row", "column"), "QYX"),
        ((20, 30, 9), ("Height", "Width", "Time"), "YXT"),
    ],
)
def test_axes_have_the_letters_of_their_names(shape, axes, letters):
    array = LabelledArray("a", shape, np.dtype(np.uint8), axes, shape, lambda i: FILM, lambda a: None)
    assert name_axes(array) == letters
