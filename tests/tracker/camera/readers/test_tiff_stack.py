"""A TIFF stack whose header is damaged gives the frames that were written, or says that it is damaged."""

import struct

import numpy as np
import pytest
import tifffile

from synthcam_shared.errors import InputError
from tracker.camera.readers.tiff_stack import read_tiff_stack

RNG = np.random.default_rng(0)
MOVIE = RNG.integers(0, 200, (6, 24, 32)).astype(np.uint16)
KINDS = {
    "ImageJ": {"imagej": True},
    "plain": {},
    "OME": {"ome": True, "metadata": {"axes": "TYX"}},
    "packed": {"compression": "zlib"},
    "large": {"bigtiff": True},
    "big-endian": {"byteorder": ">"},
}


def write(path, kind):
    tifffile.imwrite(path, MOVIE, photometric="minisblack", **KINDS[kind])
    with tifffile.TiffFile(path) as tif:
        whole = tif.series[0].dataoffset is not None
        parts = [part for page in tif.pages for part in zip(page.dataoffsets, page.databytecounts, strict=True)]
        return [(tif.series[0].dataoffset, MOVIE.nbytes)] if whole else parts


def read(path):
    frames = read_tiff_stack(path)
    return np.stack([frames[k] for k in range(len(frames))]), frames.faults


@pytest.mark.parametrize("kind", KINDS)
def test_no_damaged_byte_beside_the_pixels_gives_other_frames_without_a_word(kind, tmp_path):
    """Every byte of the header, of the first tags and of some others is set to zero, inverted and raised by one."""
    path = tmp_path / "stack.tif"
    pixels = write(path, kind)
    whole = bytearray(path.read_bytes())
    assert np.array_equal(read(path)[0], MOVIE)
    assert read(path)[1] == ()
    beside = np.ones(len(whole), dtype=bool)
    for first, count in pixels:
        beside[first : first + count] = False
    places = np.flatnonzero(beside)
    refused = 0
    for at in [*places[:100], *RNG.choice(places[100:], 20)]:
        for value in {0, whole[at] ^ 0xFF, (whole[at] + 1) % 256} - {whole[at]}:
            path.write_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
            try:
                film, notes = read(path)
            except InputError:
                refused += 1
                continue
            assert notes or np.array_equal(film, MOVIE), f"byte {at}: {whole[at]} became {value}"
    assert refused > 50


def test_a_stack_that_declares_fewer_frames_than_it_has_pages_is_refused(tmp_path):
    path = tmp_path / "stack.tif"
    write(path, "ImageJ")
    path.write_bytes(path.read_bytes().replace(b"images=6", b"images=4").replace(b"channels=6", b"channels=4"))
    with pytest.raises(InputError, match="6 pages, but its metadata declare 4"):
        read(path)


def test_a_stack_that_lost_its_last_pages_says_so(tmp_path):
    """The chain of pages ends after the first, where the description declares one; all pixels still lie in the file."""
    path = tmp_path / "stack.tif"
    write(path, "plain")
    whole = bytearray(path.read_bytes().replace(b"[6, 24, 32]", b"[1, 24, 32]"))
    (tags,) = struct.unpack_from("<H", whole, 8)
    struct.pack_into("<I", whole, 10 + 12 * tags, 0)
    path.write_bytes(whole)
    film, notes = read(path)
    assert len(film) == 1
    assert "bytes in a row belong to no page: are frames lost?" in "".join(notes)


@pytest.mark.filterwarnings("ignore:.*reading array from closed file")
def test_a_stack_in_several_files_is_no_damaged_one(tmp_path):
    """OME-TIFF: each file has one frame and names them all, and their pixels begin at the same byte."""
    names = [f"frame_{k}.ome.tif" for k in range(3)]
    entries = "".join(
        f'<TiffData FirstT="{k}" FirstC="0" FirstZ="0" IFD="0"><UUID FileName="{name}">u{k}</UUID></TiffData>'
        for k, name in enumerate(names)
    )
    pixels = (
        '<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16"'
        ' SizeX="32" SizeY="24" SizeZ="1" SizeC="1" SizeT="3">'
        f'<Channel ID="Channel:0:0" SamplesPerPixel="1"/>{entries}</Pixels>'
    )
    film = MOVIE[:3] // np.array([1, 4, 50], np.uint16)[:, None, None]  # each is compressed to other lengths
    for k, name in enumerate(names):
        head = f'<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="u{k}">'
        text = f'<?xml version="1.0" encoding="UTF-8"?>{head}<Image ID="Image:0">{pixels}</Image></OME>'
        tifffile.imwrite(tmp_path / name, film[k], description=text, metadata=None, compression="zlib")
    got, notes = read(tmp_path / names[0])
    assert np.array_equal(got, film)
    assert notes == ()


@pytest.mark.parametrize(("first", "next_one"), [(10, 20), (1, 59), (59, None)])
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_stack_whose_chain_of_pages_skips_frames_says_so(first, next_one, order, tmp_path):
    """The frames lie one after the other, so that the description of an ImageJ stack is enough to read all of them."""
    path, film = tmp_path / "stack.tif", np.resize(MOVIE, (60, 24, 32)) + np.arange(60, dtype=np.uint16)[:, None, None]
    tifffile.imwrite(path, film, photometric="minisblack", imagej=True, byteorder=order)
    with tifffile.TiffFile(path) as tif:
        offsets = [page.offset for page in tif.pages]
    whole = bytearray(path.read_bytes())
    (tags,) = struct.unpack_from(f"{order}H", whole, offsets[first - 1])
    after = 0 if next_one is None else offsets[next_one]
    struct.pack_into(f"{order}I", whole, offsets[first - 1] + 2 + 12 * tags, after)
    path.write_bytes(whole)
    got, notes = read(path)
    assert np.array_equal(got, film)
    pages = first if next_one is None else first + 60 - next_one
    assert f"{pages} pages, but the metadata declare 60 frames" in "".join(notes)


def test_a_stack_of_one_page_for_all_frames_is_ordinary(tmp_path):
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, MOVIE, photometric="minisblack", truncate=True)
    film, notes = read(path)
    assert np.array_equal(film, MOVIE)
    assert notes == ()


def test_dark_frames_that_take_few_bytes_have_lost_none(tmp_path):
    """A frame takes 20 bytes, and the program left 24 bytes free between its tags."""
    path = tmp_path / "dark.tif"
    tifffile.imwrite(path, np.zeros((50, 32, 40), np.uint8), compression="zlib", metadata={"note": "x" * 3000})
    assert read(path)[1] == ()


def test_pages_with_the_pixels_of_others_are_counted_once_for_all_strips(tmp_path):
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, MOVIE, photometric="minisblack", rowsperstrip=4, metadata=None)
    with tifffile.TiffFile(path) as tif:
        first, second = (page.tags["StripOffsets"].valueoffset for page in (tif.pages[0], tif.pages[1]))
    whole = bytearray(path.read_bytes())
    whole[second : second + 24] = whole[first : first + 24]
    path.write_bytes(whole)
    assert any(note.startswith("1 pages have the pixels of another page") for note in read(path)[1])


@pytest.mark.parametrize("kind", ["ImageJ", "plain", "large", "big-endian"])
def test_of_pages_with_the_same_tags_few_are_parsed_and_any_other_is(kind, tmp_path, monkeypatch):
    """A damaged tag of a late page is found, although that page need not be read for its pixels."""
    path, parsed, parse = tmp_path / "stack.tif", [], tifffile.TiffPage.__init__
    tifffile.imwrite(path, np.resize(MOVIE, (60, 24, 32)), photometric="minisblack", **KINDS[kind])
    with tifffile.TiffFile(path) as tif:
        tag = tif.pages[50].tags["BitsPerSample"]
    monkeypatch.setattr(tifffile.TiffPage, "__init__", lambda self, *a, **k: parsed.append(0) or parse(self, *a, **k))
    read(path)
    assert len(parsed) < 15
    whole = bytearray(path.read_bytes())
    whole[tag.offset + 2 : tag.offset + 4] = b"\xff\xff"  # no type of a value has this number
    path.write_bytes(whole)
    with pytest.raises(InputError, match="damaged"):
        read(path)


@pytest.mark.parametrize("kind", ["ImageJ", "plain", "large", "big-endian"])
def test_a_late_page_with_another_value_of_a_tag_is_read_too(kind, tmp_path):
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, np.resize(MOVIE, (60, 24, 32)), photometric="minisblack", **KINDS[kind])
    with tifffile.TiffFile(path) as tif:
        tag, order = tif.pages[50].tags["Compression"], tif.byteorder
    whole = bytearray(path.read_bytes())
    struct.pack_into(f"{order}H", whole, tag.valueoffset, 3)  # a fax, of black and white pixels
    path.write_bytes(whole)
    with pytest.raises(InputError, match="16 bits, compressed as black and white"):
        read(path)


def test_a_late_page_with_another_value_that_lies_apart_from_its_tag_is_read_too(tmp_path, monkeypatch):
    path, parsed, parse = tmp_path / "stack.tif", [], tifffile.TiffPage.__init__
    tifffile.imwrite(path, np.zeros((60, 24, 32, 3), np.uint8), photometric="rgb")
    with tifffile.TiffFile(path) as tif:
        tag = tif.pages[50].tags["BitsPerSample"]
    monkeypatch.setattr(tifffile.TiffPage, "__init__", lambda self, *a, **k: parsed.append(0) or parse(self, *a, **k))
    whole = bytearray(path.read_bytes())
    struct.pack_into("<I", whole, tag.offset + 8, len(whole))
    counts = []
    for bits in (8, 16):
        path.write_bytes(whole + struct.pack("<3H", bits, bits, bits))
        parsed.clear()
        read(path)
        counts.append(len(parsed))
    assert counts[1] == counts[0] + 1
