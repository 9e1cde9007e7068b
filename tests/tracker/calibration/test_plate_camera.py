"""A tilted camera with a lens, by OpenCV alone: its view, and a collision of balls above the plate, are found again."""

import json
import sys

import cv2
import numpy as np
import pandas as pd
import pytest

import synthcam
import tracker
from synthcam_shared.errors import InputError
from tracker import cli
from tracker.calibration.calibrate import keys_from_options
from tracker.calibration.plate_camera import calibrate_plate, fit_view
from tracker.calibration.plate_points import PlatePoints, find_board, read_points
from tracker.camera.camera import Camera
from tracker.camera.views import perturb_view

SIZE = (640, 480)
DIAMETER = 2.38e-3
FOCAL = 800.0
HEIGHT = FOCAL * 1.6e-4
NOISE = 0.02  # px, of tracks
ERROR = 0.1  # px, of points
GIVEN = keys_from_options(DIAMETER, 250.0)
QUANTITIES = ["v0", "r", "mu_k"]


def eye(tilt, k1=0.0, aside=(0.0, 0.0)):
    """K, dist, rotation vector and t of a camera that looks down, tilted by so many degrees.

    aside: of the principal point from the picture's middle, px.
    """
    matrix = np.array([[FOCAL, 0, 319.5 + aside[0]], [0, FOCAL, 239.5 + aside[1]], [0, 0, 1.0]])
    turn = cv2.Rodrigues(np.array([np.radians(tilt), 0.03, 0.1]))[0] @ np.diag([1.0, -1.0, -1.0])
    return matrix, np.array([k1, 0, 0, 0, 0.0]), cv2.Rodrigues(turn)[0], np.array([0.002, -0.001, HEIGHT])


def seen(places, camera):
    matrix, dist, turn, shift = camera
    return cv2.projectPoints(np.asarray(places, float), turn, shift, matrix, dist)[0].reshape(-1, 2)


def grid(across, down):
    x, y = np.meshgrid(np.linspace(-0.036, 0.036, across), np.linspace(-0.024, 0.024, down))
    return np.column_stack([x.ravel(), y.ravel()])


def marked(camera, places, rng=None, error=ERROR):
    pixels = seen(np.column_stack([places, np.zeros(len(places))]), camera)
    return PlatePoints(pixels + (0 if rng is None else error * rng.standard_normal(pixels.shape)), places, "points.csv")


def calibrated(view):
    keys = {"K": view.K, "dist": view.dist, "R": view.R, "t": view.t, "view_errors": view.errors}
    given = {"size": list(SIZE), "fps": 250.0, "ball_diameter": DIAMETER}
    return Camera.from_dict(given | {key: value.tolist() for key, value in keys.items()})


def test_without_noise_the_camera_is_found():
    matrix, dist, turn, shift = eye(25, -0.1)
    view = fit_view(marked((matrix, dist, turn, shift), grid(6, 5)), SIZE, 1e-3)
    assert np.allclose(view.K, matrix, rtol=1e-3)
    assert view.dist[0] == pytest.approx(-0.1, abs=5e-3)
    assert np.allclose(view.R, cv2.Rodrigues(turn)[0], atol=1e-3)
    assert np.allclose(view.t, shift, atol=1e-3 * HEIGHT)


@pytest.mark.parametrize(
    ("tilt", "k1", "points"),
    [(25, 0.0, (2, 2)), (2, 0.0, (2, 2)), pytest.param(20, -0.1, (5, 4), marks=pytest.mark.gate)],
)
def test_lengths_above_the_plate_are_within_their_errors(tilt, k1, points):
    """Between centres of balls, principal points as they scatter; from above, heights as usual cameras have them."""
    rng, off = np.random.default_rng(1), []
    ends = np.array([[-0.025, -0.01, DIAMETER / 2], [0.02, 0.015, DIAMETER / 2]])
    true = np.linalg.norm(ends[1] - ends[0])

    def length(one):
        return float(np.linalg.norm(np.subtract(*one.unproject(pixels)[0])))

    for _ in range(8):
        camera = eye(tilt, k1, 0.015 * SIZE[0] * rng.standard_normal(2))
        pixels = seen(ends, camera)
        found = calibrated(fit_view(marked(camera, grid(*points), rng), SIZE, ERROR))
        std = np.linalg.norm(
            [(length(perturb_view(found, 1e-3 * e)) - length(found)) / 1e-3 for e in found.view_errors]
        )
        assert std < 0.01 * true
        off.append((length(found) - true) / std)
    assert np.sqrt(np.mean(np.square(off))) < 1 + 3 / np.sqrt(2 * len(off))
    assert tilt < 10 or np.std(off) > 1 - 3 / np.sqrt(2 * len(off))


def test_each_number_of_an_error_does_what_the_format_says():
    """Held to OpenCV's projection with the same changes made by hand."""
    matrix, dist, turn, shift = eye(20, -0.1)
    known = calibrated(fit_view(marked((matrix, dist, turn, shift), grid(6, 5)), SIZE, ERROR))
    change = np.array([0.02, 3.0, -2.0, 0.05, -0.03, 0.01, -0.02, 0.03, 1e-3, 2e-3, -3e-3])
    other = known.K.copy()
    other[:2, :2] *= 1.02
    other[:2, 2] += [3.0, -2.0]
    turned = cv2.Rodrigues(cv2.Rodrigues(change[5:8])[0] @ known.R)[0]
    places = np.column_stack([grid(3, 3), np.full(9, DIAMETER / 2)])
    bent = np.add(known.dist, [0.05, -0.03, 0, 0, 0])
    wanted = seen(places, (other, bent, turned, known.t + change[8:]))
    assert np.allclose(perturb_view(known, change).project(places), wanted, rtol=0, atol=1e-6)


@pytest.fixture(scope="module")
def collision():
    """Centres of two balls in the world (frames, balls, 3), m, and what they do, from synthcam's motion alone."""
    scene = synthcam.Scene.read("painter_behringer", timing={"exposure": 1e-6})
    clip = scene.draw(1, 3)
    return clip.tracks, clip.truth


def tracks_of(table, camera, rng):
    pixels = seen(table[["x", "y", "z"]].to_numpy(), camera)
    pixels += NOISE * rng.standard_normal(pixels.shape)
    rows = table[["frame", "particle"]].assign(x=pixels[:, 0], y=pixels[:, 1], x_std=NOISE, y_std=NOISE)
    return rows.reset_index(drop=True)


def scores(table, truth, camera, known, rng):
    row = tracker.measure(tracks_of(table, camera, rng), known).estimates.iloc[0]
    return np.array([(row[name] - truth[name]) / row[f"{name}_std"] for name in QUANTITIES]), row


@pytest.mark.parametrize("views", [2, pytest.param(6, marks=pytest.mark.gate)])
def test_collisions_are_measured_within_their_errors(collision, views):
    table, truth = collision
    camera, rng, off = eye(25), np.random.default_rng(2), []
    for _ in range(views):
        known = calibrated(fit_view(marked(camera, grid(2, 2), rng), SIZE, ERROR))
        z, row = scores(table, truth, camera, known, rng)
        assert row["status"] == "ok"
        assert row["v0_std"] < 0.005 * row["v0"]
        off.append(z)
    assert (np.sqrt(np.mean(np.square(off), axis=0)) < 1 + 3 / np.sqrt(2 * len(off))).all()
    without = scores(table, truth, camera, tracker.Camera.from_dict(known.to_dict() | {"view_errors": []}), rng)[1]
    assert row["v0_std"] > 2 * without["v0_std"]
    cov = json.loads(row["cov"])
    assert set(cov["shared"]) == {f"view_errors[{k}]" for k in range(9)}


@pytest.mark.gate
def test_without_it_they_are_not(collision):
    """Straight above at the right scale in the middle; and the plate's own plane in place of the balls' centres."""
    table, truth = collision
    camera, rng = eye(25), np.random.default_rng(3)
    right = calibrated(fit_view(marked(camera, grid(5, 4)), SIZE, ERROR))
    assert np.abs(scores(table, truth, camera, right, rng)[0]).max() < 4
    exact = tracker.Camera.from_dict(right.to_dict() | {"view_errors": []})
    flat = {"size": list(SIZE), "fps": 250, "ball_diameter": DIAMETER, "scale": right.scale}
    z, row = scores(table, truth, camera, flat, rng)
    assert row["status"] == "misfit" or np.abs(z).max() > 10
    lowered = exact.to_dict() | {"t": (exact.t + exact.R[:, 2] * DIAMETER / 2).tolist(), "scale": right.scale}
    z, row = scores(table, truth, camera, lowered, rng)
    assert row["status"] == "misfit" or np.abs(z).max() > 10


def wrong(change):
    places = grid(2, 2) if change != "far" else grid(3, 3)
    points = marked(eye(25), places)
    pixels, metres = points.pixels.copy(), points.metres.copy()
    if change == "three":
        return PlatePoints(pixels[:3], metres[:3], "p")
    if change == "line":
        metres[:] = [[0, 0], [0.01, 0.01], [0.02, 0.02], [0.03, 0.0]]
        return marked(eye(25), metres)
    if change == "mirrored":
        metres[:, 1] *= -1
    if change == "exchanged":
        pixels[[0, 1]] = pixels[[1, 0]]
    if change == "outside":
        pixels[2] = [-30, 20]
    if change == "far":
        pixels[4] += [12, 0]
    return PlatePoints(pixels, metres, "p")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("three", "p: 3 points, expected at least 4"),
        ("line", "points.csv: the points lie on a line, or all but one do"),
        ("mirrored", "p: x, y are mirrored"),
        ("exchanged", "are some of them exchanged?"),
        ("outside", "p: -30, 20 px lies outside the picture of 640 x 480"),
        ("far", "far more than the error given; worst is number 5"),
    ],
)
def test_points_that_tell_no_view_are_refused(change, said):
    with pytest.raises(InputError) as error:
        fit_view(wrong(change), SIZE, ERROR)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


BOARDS = {
    "7x5,square=0.01": 24,
    "7x5,square=0.01,marker=0.007,dict=4x4_50": 24,
    "marker=0.04": 4,
}


def drawn(board):
    """The board's picture, and m a px."""
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    if board == "marker=0.04":
        return np.pad(cv2.aruco.generateImageMarker(words, 3, 160), 40, constant_values=255), 0.04 / 160
    if "marker" in board:
        return cv2.aruco.CharucoBoard((7, 5), 0.01, 0.007, words).generateImage((280, 200)), 0.01 / 40
    squares = np.kron((np.indices((5, 7)).sum(axis=0) % 2 * 255).astype(np.uint8), np.ones((40, 40), np.uint8))
    return np.pad(squares, 40, constant_values=255), 0.01 / 40


@pytest.mark.parametrize("board", BOARDS)
def test_boards_are_found(board, tmp_path):
    """Drawn by OpenCV, put on the plate and filmed from aside by a homography of this test's own."""
    picture, metre = drawn(board)
    height, width = picture.shape
    camera = eye(20)
    corners = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    places = np.column_stack([(corners[:, 0] - width / 2) * metre, (height / 2 - corners[:, 1]) * metre, np.zeros(4)])
    warp = cv2.getPerspectiveTransform(corners.astype(np.float32), seen(places, camera).astype(np.float32))
    shown = cv2.warpPerspective(picture, warp, SIZE, flags=cv2.INTER_AREA, borderValue=255)
    cv2.imwrite(str(tmp_path / "board.png"), cv2.GaussianBlur(shown, (0, 0), 0.8))
    points = find_board(tmp_path / "board.png", board)
    assert len(points.pixels) == BOARDS[board]
    found = calibrated(fit_view(points, SIZE, 0.3))
    ends = np.array([[-0.02, 0.0, DIAMETER / 2], [0.02, 0.01, DIAMETER / 2]])
    length = np.linalg.norm(np.subtract(*found.unproject(seen(ends, camera))[0]))
    assert length == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=0.01)


@pytest.mark.parametrize(
    "board", ["", "7", "7x5", "7x5,square=-1", "7x5,square=0.01,marker=0.02", "2x2,square=0.01", "marker=0.04,dict=5x5"]
)
def test_wrong_boards(board, tmp_path):
    cv2.imwrite(str(tmp_path / "board.png"), np.zeros((100, 100), np.uint8))
    with pytest.raises(InputError, match="--board: ") as error:
        find_board(tmp_path / "board.png", board)
    assert "\n" not in str(error.value)


def test_no_board_in_the_picture(tmp_path):
    cv2.imwrite(str(tmp_path / "board.png"), np.zeros((100, 100), np.uint8))
    for board in BOARDS:
        with pytest.raises(InputError, match=r"no board .* found in it"):
            find_board(tmp_path / "board.png", board)


def test_by_command(tmp_path, monkeypatch, capsys):
    points = marked(eye(25), grid(3, 3), np.random.default_rng(0))
    table = pd.DataFrame(np.column_stack([points.pixels, points.metres]), columns=["x_px", "y_px", "x", "y"])
    table.to_csv(tmp_path / "points.csv", index=False)
    cv2.imwrite(str(tmp_path / "plate.png"), np.zeros(SIZE[::-1], np.uint8))
    words = ["calibrate", tmp_path / "plate.png", "--points", tmp_path / "points.csv", "--diameter", DIAMETER]
    words += ["--fps", 250, "-o", tmp_path / "camera.json"]
    for _ in range(2):  # what it made itself it writes anew
        monkeypatch.setattr(sys, "argv", ["tracker", *map(str, words)])
        cli.app(standalone_mode=False)
    said = capsys.readouterr().out
    assert "point 9: off by" in said
    assert "tilt: 2" in said
    camera = Camera.read(tmp_path / "camera.json")
    assert camera.view_errors.shape == (10, 11)
    assert camera.unmodelled == ()
    assert Camera.from_dict(camera.to_dict()).view_errors.tolist() == camera.view_errors.tolist()


def test_a_height_tells_what_a_view_from_above_does_not(tmp_path):
    points = marked(eye(1), grid(2, 2), np.random.default_rng(0))
    table = pd.DataFrame(np.column_stack([points.pixels, points.metres]), columns=["x_px", "y_px", "x", "y"])
    table.to_csv(tmp_path / "points.csv", index=False)
    cv2.imwrite(str(tmp_path / "plate.png"), np.zeros(SIZE[::-1], np.uint8))
    known, unknown = (
        calibrate_plate(tmp_path / "plate.png", GIVEN, tmp_path / "points.csv", "", ERROR, height).summary()
        for height in (HEIGHT, None)
    )

    def number(lines, name):
        return [float(word) for line in lines if line.startswith(name) for word in line.split()[1:4:2]]

    height, std = number(known, "height:")
    assert height == pytest.approx(HEIGHT, rel=0.05)
    assert std < 0.025 * HEIGHT
    assert number(unknown, "height:")[1] > 0.2 * HEIGHT
    assert number(unknown, "scale:")[1] > 5 * number(known, "scale:")[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [("x_px,y_px,x\n1,2,3\n", "no column y, expected x_px"), ("x_px,y_px,x,y\n1,2,3,\n", "four numbers in each row")],
)
def test_wrong_tables(text, said, tmp_path):
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_points(tmp_path / "points.csv")


@pytest.mark.parametrize("value", [[[1, 2]], [[0] * 11] * 12, "all", [["a"] * 11], 3])
def test_wrong_view_errors(value):
    keys = calibrated(fit_view(marked(eye(25), grid(2, 2)), SIZE, ERROR)).to_dict()
    with pytest.raises(InputError, match="view_errors: expected"):
        Camera.from_dict(keys | {"view_errors": value})
    with pytest.raises(InputError, match="view_errors: expected K, R and t"):
        Camera.from_dict({"size": [10, 10], "fps": 1, "scale": 1e-3, "view_errors": [[0] * 11]})
