"""Times that a film states: missing, repeated and uneven frames, and fields, held to the times it was made with."""

import itertools
import json

import cv2
import numpy as np
import pytest
import tifffile
from tracker_film import CAMERA, film
from tracker_video import encode

import tracker
from synthcam_shared.errors import InputError
from tracker.camera.fields import FieldOrder
from tracker.camera.film_options import FilmOptions
from tracker.camera.frame_times import find_repeated, read_clock
from tracker.camera.recordings import open_frames, open_source

RNG = np.random.default_rng(45)
NOISE = RNG.integers(60, 200, (24, 48, 64), dtype=np.uint8)
SMALL = {**CAMERA, "size": [64, 48], "K": [[3117.5625, 0, 31.5], [0, 3117.5625, 23.5], [0, 0, 1]]}
ROWS, COLUMNS = np.mgrid[:48, :64]


def moving(count, width=64, speed=1.5, rows=ROWS, columns=COLUMNS):
    """Frames of a soft ball, 10 px wide, that moves by `speed` px a frame."""
    return [
        np.rint(60 + 150 * np.exp(-((columns - 8 - speed * k) ** 2 + (rows - 23.0) ** 2) / 30)).astype(np.uint8)
        for k in range(count)
    ]


def opened(path, camera=None, **options):
    """The recording and its notes as text."""
    (path if path.is_dir() else path.parent).joinpath("camera.json").write_text(json.dumps(camera or SMALL))
    clip = open_source(path, options=FilmOptions(**options)).open_clip(0)
    return clip, "\n".join(map(str, clip.notes))


def write_pictures(folder, numbers, pattern="img_{:04d}.png"):
    folder.mkdir(exist_ok=True)
    for k, number in enumerate(numbers):
        cv2.imwrite(str(folder / pattern.format(number)), NOISE[k % len(NOISE)])
    return folder


@pytest.mark.parametrize("ending", ["mp4", "mkv", "mov", "avi"])
def test_time_stamps_show_missing_frames(tmp_path, ending):
    times = [k + 1 * (k > 8) + 3 * (k > 15) for k in range(24)]
    path = encode(tmp_path / f"film.{ending}", NOISE, "mpeg4", rate=250, times=times)
    clip, notes = opened(path)
    assert clip.frames.numbers.tolist() == times
    assert clip.frames.seconds is None
    assert "4 frames are missing by the time stamps, after frame 8 (32 ms), 16 (64 ms)" in notes
    assert "fps" not in notes


def test_uneven_time_stamps_become_the_times_of_frames(tmp_path):
    times = np.cumsum(RNG.integers(30, 40, 24))  # ms, as a phone has them
    path = encode(tmp_path / "film.mkv", NOISE, "mpeg4", rate=1000, times=times.tolist())
    rate = 1e3 / float(np.median(np.diff(times)))
    clip, notes = opened(path, {**SMALL, "fps": rate})
    assert clip.frames.seconds == pytest.approx((times - times[0]) / 1e3, abs=1e-6)
    assert clip.frames.numbers.tolist() == list(range(24))
    assert "frame times are uneven, 30 to 39 ms apart by the time stamps" in notes


def test_a_late_gap_has_its_time_in_seconds():
    clock = read_clock([k + (k > 120) for k in range(150)], 0.1, "the time stamps")
    assert clock.notes == (
        "1 frame is missing by the time stamps, after frame 120 (12.00 s); frame numbers and times allow for that",
    )


def test_one_late_frame_is_said_by_its_delay():
    times = np.arange(200) * 41.0
    times[90] += 10
    assert "uneven, up to 9.9 ms off a spacing of 41 ms by" in read_clock(times, 1e-3, "the time stamps").notes[0]


def test_time_stamps_rounded_to_milliseconds_are_even(tmp_path):
    times = np.rint(np.arange(24) * 1000 / 240).astype(int).tolist()
    clip, notes = opened(encode(tmp_path / "film.mkv", NOISE, "mpeg4", rate=1000, times=times), {**SMALL, "fps": 240})
    assert clip.frames.seconds is None
    assert clip.frames.numbers.tolist() == list(range(24))
    assert "frame" not in notes


def test_a_playback_rate_keeps_the_rate_of_the_camera_and_still_shows_a_missing_frame(tmp_path):
    times = [k + (k > 8) for k in range(24)]
    clip, notes = opened(encode(tmp_path / "film.mp4", NOISE, "mpeg4", rate=25, times=times))
    assert clip.camera.fps == 250
    assert clip.frames.numbers.tolist() == times
    assert "250 in the camera file, 25 by the film's own times, a factor of 10; the camera file's is used" in notes


def test_uneven_times_of_a_slowed_film_are_scaled_to_the_rate_of_the_camera(tmp_path):
    times = np.cumsum(RNG.choice([30, 40, 40, 50], 24))
    clip, _ = opened(encode(tmp_path / "film.mkv", NOISE, "mpeg4", rate=1000, times=times.tolist()))
    assert clip.frames.seconds == pytest.approx((times - times[0]) / 40 / 250, rel=1e-6)  # 40 ms are shown for 4 ms


def test_options_take_the_rate_of_the_film_or_even_frames(tmp_path):
    times = [k + (k > 8) for k in range(24)]
    path = encode(tmp_path / "film.mp4", NOISE, "mpeg4", rate=25, times=times)
    assert opened(path, times="file")[0].camera.fps == pytest.approx(25)
    assert opened(path, times="even")[0].frames.numbers.tolist() == list(range(24))
    with pytest.raises(InputError, match="--times: expected one of auto, file, even, not 'never'"):
        FilmOptions(times="never")
    with pytest.raises(InputError, match="--times file: the film states no times"):
        opened(write_pictures(tmp_path / "pictures", range(5)), times="file")


@pytest.mark.parametrize("pattern", ["img_{:04d}.png", "run3_{}.png", "{:06d}.bmp", "a-{:05d}-b2.png"])
def test_every_second_picture_has_half_the_rate(tmp_path, pattern):
    clip, notes = opened(write_pictures(tmp_path / "film", range(10, 34, 2), pattern))
    assert clip.camera.fps == 125
    assert clip.frames.numbers.tolist() == list(range(12))
    assert "fps: one frame in 2 is there, 125 of 250 a second" in notes
    assert "--times even" in notes
    assert opened(tmp_path / "film", times="even")[0].camera.fps == 250


def test_missing_pictures_are_counted(tmp_path):
    numbers = [3, 4, 5, 6, 13, 14, 15]
    clip, notes = opened(write_pictures(tmp_path / "film", numbers))
    assert clip.frames.numbers.tolist() == [0, 1, 2, 3, 10, 11, 12]
    assert clip.camera.fps == 250
    assert "6 frames are missing by the numbers of the pictures, after frame 3" in notes


@pytest.mark.parametrize(
    "names", [["t0.004", "t0.008", "t0.012"], ["a1_07", "a3_08", "a4_10"], ["12000", "12417", "12831"]]
)
def test_names_that_count_no_frames_are_said(tmp_path, names):
    for k, name in enumerate(names):
        cv2.imwrite(str(tmp_path / f"{name}.png"), NOISE[k])
    clip, notes = opened(tmp_path)
    assert clip.frames.numbers.tolist() == [0, 1, 2]
    assert clip.camera.fps == 250
    assert "do not count frames" in notes


def test_pictures_numbered_by_microseconds_keep_their_rate(tmp_path):
    clip, _ = opened(write_pictures(tmp_path / "film", range(0, 24 * 4000, 4000), "{:07d}.png"))
    assert clip.camera.fps == 250
    assert clip.frames.numbers.tolist() == list(range(24))


@pytest.mark.parametrize("kind", ["tif", "zlib.tif", "pictures", "memory", "mp4", "mkv"])
def test_a_film_with_every_frame_twice_has_half_the_rate(tmp_path, kind):
    twice = np.repeat(NOISE, 2, axis=0) if kind != "mp4" else np.repeat(np.array(moving(24)), 2, axis=0)
    path = tmp_path / f"film.{kind}"
    if kind == "memory":
        notes = "\n".join(map(str, tracker.track(twice, SMALL, detector="centroid").notes))
        assert "24 frames repeat the previous one" in notes
        return
    if kind == "pictures":
        path = tmp_path / "pictures"
        path.mkdir()
        for k, picture in enumerate(twice):
            cv2.imwrite(str(path / f"{k:03d}.png"), picture)
    elif kind.endswith("tif"):
        tifffile.imwrite(path, twice, **({"compression": "zlib"} if kind == "zlib.tif" else {}))
    else:
        encode(path, twice, "libx264" if kind == "mp4" else "ffv1", "yuv420p" if kind == "mp4" else "gray", rate=250)
    clip, notes = opened(path)
    assert len(clip.frames) == 24
    assert clip.camera.fps == 125
    assert clip.frames.numbers.tolist() == list(range(24))
    assert "24 frames repeat the previous one and are left out: 1, 3, 5, 7, 9, 11, ..." in notes
    assert opened(path, times="even")[0].camera.fps == 250
    if kind != "mp4":
        assert np.array_equal(np.array(list(clip.frames)), NOISE)


def test_a_film_with_every_frame_twice_at_the_files_rate_keeps_the_cameras(tmp_path):
    """A camera of 30 frames a second in a file of 60."""
    path = encode(tmp_path / "film.mkv", np.repeat(NOISE, 2, axis=0), "ffv1", "gray", rate=60)
    clip, notes = opened(path, {**SMALL, "fps": 30})
    assert clip.camera.fps == 30
    assert len(clip.frames) == 24
    assert "fps" not in notes


def test_a_single_copy_in_place_of_a_lost_frame_is_left_out(tmp_path):
    movie = NOISE.copy()
    movie[10] = movie[9]
    tifffile.imwrite(tmp_path / "film.tif", movie)
    clip, notes = opened(tmp_path / "film.tif")
    assert clip.frames.numbers.tolist() == [*range(10), *range(11, 24)]
    assert clip.camera.fps == 250
    assert "1 frames repeat the previous one and are left out: 10" in notes


def test_a_picture_where_nothing_moves_is_not_called_repeated():
    assert not len(find_repeated(np.array([0.0] * 10 + [5.0] * 10 + [0.0] * 10)))
    assert not len(find_repeated(np.zeros(30)))
    assert find_repeated(np.array([5.0, 5, 0, 5, 5, 5, 0.1, 6])).tolist() == [3]
    assert find_repeated(np.array([5.0, 5, 0, 5, 5, 5, 0.1, 6]), 0.1).tolist() == [3, 7]


def test_flicker_is_not_called_repeated():
    """Between its extremes a lamp changes the picture much, at an extreme hardly, while balls move."""
    level = 100 * (1 + 0.2 * np.sin(0.7 * np.arange(60)))
    assert not len(find_repeated(np.diff(level) ** 2 + 0.5, 0.02))


def test_every_third_frame_is_fresh_wherever_the_film_begins():
    changes = np.tile([6.0, 0.05, 0.1], 9)
    assert find_repeated(changes, 0.02).tolist() == [k for k in range(28) if k % 3 != 1]


def test_times_of_ome_planes_and_intervals_of_imagej(tmp_path):
    times = np.arange(24) * 0.004
    times[12:] += 0.008
    tifffile.imwrite(
        tmp_path / "a.ome.tif", NOISE, metadata={"axes": "TYX", "Plane": {"DeltaT": times.tolist()}}, photometric=1
    )
    clip, notes = opened(tmp_path / "a.ome.tif")
    assert clip.frames.numbers.tolist() == [*range(12), *range(14, 26)]
    assert "2 frames are missing by DeltaT, after frame 11 (44 ms)" in notes
    tifffile.imwrite(tmp_path / "b.tif", NOISE, imagej=True, metadata={"axes": "TYX", "finterval": 0.01})
    clip, notes = opened(tmp_path / "b.tif")
    assert "250 in the camera file, 100 by the film's own times, a factor of 2.5" in notes


def test_tracks_of_a_film_with_missing_frames_lie_on_the_motion_that_was_filmed(tmp_path):
    """A ball of 2.5 px a frame and one that rests; frames 12 to 14 and 20 are lost."""
    numbers = [k for k in range(40) if k not in (12, 13, 14, 20)]
    paths = np.array([[[40 + 2.5 * k, 60.0], [150.0, 120.0]] for k in range(40)])
    pictures = film(np.random.default_rng(5), paths)
    folder = tmp_path / "film"
    folder.mkdir()
    for k in numbers:
        cv2.imwrite(str(folder / f"{k:05d}.png"), pictures[k])
    result = tracker.track(folder, CAMERA)
    assert not any("motion blur" in str(note) for note in result.notes)  # it is that of the way of one frame
    found = result.tracks
    ball = found[found.particle == found.loc[found.glint_x.idxmin(), "particle"]]
    assert ball.frame.tolist() == numbers
    assert np.abs(ball.glint_x - (40 + 2.5 * ball.frame)).max() < 0.2


def test_tracks_of_uneven_frames_hold_their_times(tmp_path):
    steps = np.random.default_rng(6).choice([3, 4, 4, 4, 5], 40)
    times = np.cumsum(steps) - steps[0]
    paths = np.array([[[40 + 0.6 * t, 60.0], [150.0, 120.0]] for t in times])
    path = encode(
        tmp_path / "film.mkv", film(np.random.default_rng(5), paths), "ffv1", "gray", rate=1000, times=times.tolist()
    )
    found = tracker.track(path, CAMERA).tracks
    ball = found[found.particle == found.loc[found.glint_x.idxmin(), "particle"]]
    assert len(ball) == 40
    assert ball.t_s.to_numpy() == pytest.approx(times / 1e3, abs=1e-9)


def interlaced(path, first, progressive=False, flagged=True, speed=1.0):
    """A film whose fields show a ball at twice the rate; the position of the ball in each field."""
    fields = moving(48, speed=speed)
    frames = []
    for k in range(24):
        one, two = fields[2 * k], fields[2 * k + (not progressive)]
        frame = one.copy()
        frame[1 - first :: 2] = two[1 - first :: 2]
        frames.append(frame)
    options = {"crf": "8"} | ({"x264-params": f"{'tff' if first == 0 else 'bff'}=1"} if flagged else {})
    return encode(path, np.array(frames), options=options, rate=125)


@pytest.mark.parametrize("flagged", [True, False])
@pytest.mark.parametrize("first", [0, 1])
def test_fields_of_interlaced_film_become_frames(tmp_path, first, flagged):
    clip, notes = opened(interlaced(tmp_path / "film.mp4", first, flagged=flagged), {**SMALL, "fps": 125})
    assert len(clip.frames) == 48
    assert clip.camera.fps == 250
    pictures = np.array(list(clip.frames)).astype(float)
    light = np.clip(pictures - 80, 0, None)
    x, y = ((light * axis).sum((1, 2)) / light.sum((1, 2)) for axis in (COLUMNS, ROWS))
    inner = slice(4, 44)
    assert np.abs(x - (8 + np.arange(48)))[inner].max() < 0.3
    assert np.abs(y - 23)[inner].max() < 0.15
    assert f"the {('upper', 'lower')[first]} first" in notes
    assert "fps: 250 fields a second" in notes


def test_film_that_is_only_called_interlaced_is_left_whole(tmp_path):
    path = interlaced(tmp_path / "film.mp4", 0, progressive=True)
    clip, notes = opened(path, {**SMALL, "fps": 125})
    assert len(clip.frames) == 24
    assert "both fields of a frame show one instant" in notes
    assert len(opened(path, fields="separate")[0].frames) == 48
    assert len(opened(interlaced(tmp_path / "other.mp4", 0), fields="weave")[0].frames) == 24


def test_pictures_of_two_fields_have_a_note_and_the_option_separates_them(tmp_path):
    fields = moving(48, speed=1.0)
    (tmp_path / "film").mkdir()
    for k in range(24):
        frame = fields[2 * k].copy()
        frame[1::2] = fields[2 * k + 1][1::2]
        cv2.imwrite(str(tmp_path / f"film/{k:03d}.png"), frame)
    for choice, count, said in (("auto", 24, True), ("weave", 24, False), ("separate", 48, False)):
        clip, notes = opened(tmp_path / "film", {**SMALL, "fps": 125}, fields=choice)
        assert (len(clip.frames), "seems to hold two fields" in notes) == (count, said)


@pytest.mark.parametrize("across", [(0.0, 1.0), (0.0, 3.0), (2.0, 1.0), (6.0, 0.0)])
@pytest.mark.parametrize("noise", [0.5, 12.0])
def test_motion_and_noise_alone_are_no_fields(across, noise):
    """A ball that moves up or down looks like its own other field of the next frame."""
    rng, order = np.random.default_rng(1), FieldOrder()
    paths = np.array([40.0, 60.0]) + np.arange(12)[:, None] * across
    pictures = [
        60 + 150 * np.clip(9.5 - np.hypot(np.arange(200) - x, np.arange(160)[:, None] - y), 0, 1) for x, y in paths
    ]
    stored = [np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8) for picture in pictures]
    for before, after in itertools.pairwise(stored):
        order.add(before, after)
    assert order.pixels > 0
    assert order.find_first() is None


def test_open_frames_of_numbers_alone_needs_no_camera(tmp_path):
    assert open_frames(write_pictures(tmp_path / "film", [0, 1, 4])).numbers.tolist() == [0, 1, 4]
