"""Hints of the user: frames, a region, a mask, a colour, and balls that he points at."""

import json

import cv2
import numpy as np
import pytest
from matplotlib.path import Path as MplPath
from tracker_colours import GREEN, ORANGE, draw
from tracker_discs import CAMERA, SIZE, R, apart, disc
from tracker_film import CAMERA as GLINTS
from tracker_film import film

import tracker
from synthcam_shared.errors import InputError
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.film_options import (
    BallExample,
    FilmOptions,
    RegionPart,
    parse_ball,
    parse_colour,
    parse_frames,
    parse_region,
    read_search_area,
)
from tracker.camera.recordings import make_recording
from tracker.cli import main
from tracker.detection.choose import find_radius, select_channel, select_detector

WAYS = apart(24)


def grey_film(noise=2.0):
    rng = np.random.default_rng(3)
    return np.array([
        np.clip(np.rint(70 + 140 * sum(disc(way[k]) for way in WAYS) + rng.normal(0, noise, SIZE)), 0, 255)
        for k in range(WAYS.shape[1])
    ]).astype(np.uint8)  # fmt: skip


@pytest.mark.parametrize(("read", "text", "value"), [
    (parse_frames, "20:80", (20, 80)), (parse_frames, ":80", (0, 80)), (parse_frames, "20:", (20, None)),
    (parse_region, "0,10,50.5,60", (RegionPart(((0, 10), (50.5, 60))),)),
    (parse_ball, "12.5,8@3", BallExample(12.5, 8, None, 3)),
    (parse_ball, "12,8,5@30", BallExample(12, 8, 5, 30)), (parse_colour, "orange", "#ffa500"),
])  # fmt: skip
def test_hints_are_read(read, text, value):
    assert read(text) == value


@pytest.mark.parametrize(("hint", "said"), [
    ({"frames": "8:3"}, "frames '8:3': expected A:B"), ({"frames": "x"}, "frames 'x': expected A:B"),
    ({"frames": "90:"}, "frames: 0 frames from 90 on"), ({"region": "1,2,3"}, "region '1,2,3': expected X0,Y0,X1,Y1"),
    ({"region": "9,2,3,8"}, "region '9,2,3,8'"), ({"region": "not 1,2 3,4"}, "corners X,Y X,Y X,Y"),
    ({"region": "1,2 3,4 5,nan"}, "corners"),
    ({"region": "0,0 9,0 1e308,9"}, "corners"), ({"region": "1,2 3,4 5,6;"}, "corners"),
    ({"region": "500,0,600,9"}, "no pixel of the film is left"),
    ({"ball": ["1,2"]}, "ball '1,2': expected X,Y@FRAME"), ({"ball": ["999,2@3"]}, "ball 999,2@3: expected a place in"),
    ({"ball": ["9,2@99"]}, "ball 9,2@99: .* a frame from 0 to 23"), ({"colour": "oramge"}, "colour: unknown 'oramge'"),
    ({"mask": "no.png"}, "mask no.png: no picture"), ({"colour": "red", "channel": "red"}, "colour, .*channel"),
])  # fmt: skip
def test_a_wrong_hint_is_one_line(hint, said):
    with pytest.raises(InputError, match=said) as error:
        tracker.track(grey_film(), CAMERA, **hint)
    assert "\n" not in str(error.value)


def test_frames_keep_their_numbers():
    result = tracker.track(grey_film(), CAMERA, frames="6:20")
    assert sorted(set(result.tracks["frame"])) == list(range(6, 20))
    away = result.found.xy[:, None] - np.swapaxes(WAYS, 0, 1)[result.found.frame]
    assert np.hypot(*away.transpose(2, 0, 1)).min(axis=1).max() < 0.2


@pytest.mark.parametrize("masked", [False, True])
def test_balls_outside_a_region_are_left_out(tmp_path, masked):
    middle = int(WAYS[:, :, 1].mean())  # one ball is above, the other below
    hint = {"region": f"0,{middle},{SIZE[1]},{SIZE[0]}"}
    if masked:
        picture = np.zeros(SIZE, np.uint8)
        picture[middle:] = 255
        cv2.imwrite(f"{tmp_path}/mask.png", picture)
        hint = {"mask": tmp_path / "mask.png"}
    result = tracker.track(grey_film(), CAMERA, **hint)
    low = WAYS[WAYS[:, :, 1].mean(axis=1).argmax()]
    assert len(result.tracks) == len(low)
    assert np.hypot(*(result.found.xy - low).T).max() < 0.2


@pytest.mark.parametrize(
    "corners", [[(20, 30), (150, 10.5), (180, 150), (90, 60), (30, 140)], [(5, 5), (9, 5), (7, 9)]]
)
def test_a_polygon_holds_the_pixels_whose_centres_it_holds(corners):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    expected = MplPath(corners).contains_points(np.stack([x, y], axis=-1).reshape(-1, 2)).reshape(SIZE)
    text = " ".join(f"{x},{y}" for x, y in corners)
    on_a_side = 1e-3 * expected.size  # whose centres may count either way
    for region, wanted in ((text, expected), (f"not {text}", ~expected), (f"0,0,999,999; not {text}", ~expected)):
        assert (read_search_area(region, "", SIZE) != wanted).sum() < on_a_side
    both = read_search_area(f"{text};100,100,199,159;not 0,0,120,120", "", SIZE)
    assert not both[:121, :121].any()
    assert both[125:, 125:].all()


def test_a_mask_of_another_size_is_refused(tmp_path):
    cv2.imwrite(f"{tmp_path}/mask.png", np.zeros((9, 8), np.uint8))
    with pytest.raises(InputError, match=r"mask.png: 8x9 pixels, expected 200x160 as the film"):
        read_search_area("", f"{tmp_path}/mask.png", SIZE)


@pytest.mark.parametrize("detector", ["maximum_likelihood", "centroid"])
def test_what_shines_outside_a_region_hides_no_glint_inside(detector):
    """Thirty bright specks that flicker are more than the candidates that are looked at in a frame."""
    rng, ways = np.random.default_rng(5), np.array([[[30 + 1.5 * k, 120.0]] for k in range(30)])
    pictures = film(rng, ways)
    for picture in pictures:
        for row, column in np.argwhere(rng.random((5, 14)) < 0.4):
            picture[5 + 14 * row : 8 + 14 * row, 8 + 14 * column : 11 + 14 * column] = 250
    settings = {"detection": {"max_candidates_per_frame": 12}}
    found = tracker.track(pictures, GLINTS, detector=detector, region="0,90,200,160", settings=settings).tracks
    assert len(found) == 30
    assert np.hypot(found.glint_x - ways[found.frame, 0, 0], found.glint_y - 120).max() < 0.5


def test_a_ball_that_is_pointed_at_in_vain_has_a_note():
    (x, y), (u, v) = WAYS[0, 10], WAYS[1, 3]
    hints = [f"{x:.0f},{y:.0f}@10", f"{u:.0f},{v:.0f},{R}@3", f"{x + 30:.0f},{y:.0f}@10"]
    notes = [note for note in map(str, tracker.track(grey_film(), CAMERA, ball=hints).notes) if "is followed" in note]
    assert len(notes) == 1
    assert notes[0].startswith(f"argument ball {x + 30:.0f},{y:.0f}@10: no ball is followed within 10 px of it, ")
    assert "the nearest is 30 px away; try another frame" in notes[0]


@pytest.mark.parametrize("radius", ["", f",{R}"])
def test_a_ball_that_is_pointed_at_gives_radius_and_plane(radius):
    way = WAYS[:1] + np.array([25.0, -5.0])
    x, y = way[0, 10]
    options = FilmOptions(ball=(f"{x:.0f},{y:.0f}{radius}@10",))
    clip, why = select_channel(make_recording(0, wrap_frames(draw(way, [ORANGE])), None, options=options), None)
    assert why.startswith("channel: ")
    assert abs(find_radius(clip) / R - 1) < 0.15
    assert select_detector(clip).name == "discs"


def test_a_colour_selects_the_balls_of_it():
    ways = np.stack([WAYS[0] + [10.0, -10.0], WAYS[1] + [10.0, -15.0]])
    pictures = draw(ways, [ORANGE, (60.0, 60.0, 190.0)], GREEN)
    result = tracker.track(pictures, CAMERA, colour="#eb961e")
    assert np.hypot(*(result.found.xy - ways[0][result.found.frame]).T).max() < 1.0
    assert len(result.found) > 20


def test_hints_are_recorded(tmp_path, monkeypatch, capsys):
    film = tmp_path / "film.npy.avi"
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter_fourcc(*"FFV1"), 60, SIZE[::-1])
    for picture in grey_film():
        writer.write(cv2.merge([picture] * 3))
    writer.release()
    hints = ["--frames", "2:22", "--region", "0,0,200,160", "--ball", "90,80@10"]
    monkeypatch.setattr("sys.argv", ["tracker", "track", str(film), "-o", str(tmp_path / "out"), *hints, "--no-pages"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0, capsys.readouterr().err
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["film"] == {"frames": "2:22", "region": "0,0,200,160", "ball": ["90,80@10"]}


@pytest.mark.parametrize("detector", ["centroid", "linear_fit"])
def test_a_hundred_glints_are_followed(detector):
    x, y = np.meshgrid(np.arange(10, 160, 15.0), np.arange(8, 158, 15.0))
    ways = np.stack([np.column_stack([x.ravel() + 0.5 * k, y.ravel()]) for k in range(4)])
    found = tracker.track(film(np.random.default_rng(2), ways), GLINTS, detector=detector).tracks
    assert found.groupby("frame").size().tolist() == [100] * 4
    assert found["particle"].nunique() == 100
