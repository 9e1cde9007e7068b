"""Pictures of matte balls: where they stand, how bright they are, what moves and what does not."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from synthcam.camera.lamp import Flicker, Lamp
from synthcam.camera.pinhole import PinholeCamera
from synthcam.camera.room.finish import BallFinish, SurfaceFinish
from synthcam.camera.room.room_renderer import RoomRenderer
from synthcam.camera.surface import IRON_N_K, Surface
from synthcam.scene.outlines import find_boxes, label_pixels
from synthcam.scene.scene import check_scene

R = 0.01
LAMP = Lamp(np.array([0.15, 0.1, 0.5]), 0.02)
BLACK, WHITE = BallFinish((0.0,), (0.0,)), BallFinish((0.8,), (0.8,))


def overhead(**changes):
    settings = {"size": (160, 120), "scale": 8e-4, "height": 0.6, "ball_radius": R}
    return PinholeCamera.overhead(**settings | {"fps": 50, "exposure": 1e-3, "psf_sigma_px": 0.8} | changes)


def look(*balls, plate=(0.5,), **more):
    return SurfaceFinish(balls or (WHITE,), plate, **more)


def still(*centres):
    return lambda times: np.broadcast_to(np.array(centres, float), (len(times), len(centres), 3))


def unturned(balls):
    return lambda times: np.broadcast_to(np.eye(3), (len(times), balls, 3, 3))


def one(film, *centres, span=(0.0, 0.0)):
    return next(film.frames(still(*centres), unturned(len(centres)), [span]))


def test_the_plate_alone():
    film = RoomRenderer(overhead(), LAMP, [R], look(BallFinish((0.8,) * 3, (0.8,) * 3), plate=(0.4, 0.2, 0.1)), None)
    pictures = one(film, [0.4, 0.4, R])
    assert len(pictures) == 3
    for picture, plate in zip(pictures, (0.4, 0.2, 0.1), strict=True):
        assert picture.boxes == ()
        assert picture.image[59:61, 79:81].mean() == pytest.approx(plate, rel=2e-3)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.45), (31.2, 20.7)])
@pytest.mark.parametrize("change", [{}, {"tilt": (0.1, -0.05), "distortion": (-0.1, 0.0, 0.0, 0.0, 0.0)}])
def test_a_black_ball_hides_its_outline(shift, change):
    """In even light without a lamp's shadow: what is missing has the outline's own area and middle."""
    camera = overhead(**change)
    film = RoomRenderer(camera, LAMP, [R], look(BLACK, ambient=0.0), None)
    film.shade.cells, centre = [], np.array([shift[0] * 8e-4, shift[1] * 8e-4, R])
    film.shade.finish = SurfaceFinish((BLACK,), (0.5,), ambient=1.0)
    film.shade._unshadowed_shares = lambda ball, points, centre, soft=0.0: (np.zeros(0, int), np.ones((0, 1)))
    film._bare = np.ones(film._bare.shape)
    image = one(film, centre)[0].image / film.plates[0]
    missing = 1 - image
    eye = camera.centre - centre
    far = np.linalg.norm(eye)
    side = np.cross(eye, [0, 1, 0]) / np.linalg.norm(np.cross(eye, [0, 1, 0]))
    turn = np.linspace(0, 2 * np.pi, 2000, endpoint=False)[:, None]
    ring = R**2 / far**2 * eye + R * np.sqrt(1 - (R / far) ** 2) * (
        np.cos(turn) * side + np.sin(turn) * np.cross(eye / far, side)
    )
    x, y = camera.project(centre + ring).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = cross.sum() / 2
    middle = np.array([((a + np.roll(a, -1)) * cross).sum() / (6 * area) for a in (x, y)])
    rows, columns = np.mgrid[:120, :160]
    assert missing.sum() == pytest.approx(abs(area), rel=2e-3)
    found = np.array([(missing * columns).sum(), (missing * rows).sum()]) / missing.sum()
    np.testing.assert_allclose(found, middle, atol=0.01)


def test_an_exposure_is_the_mean_of_its_moments():
    film = RoomRenderer(overhead(), LAMP, [R], look(texture="wood"), Surface(steel=(1.5, 0.0)))

    def rolling(times):
        return np.stack([0.5 * times - 0.01, 0 * times, 0 * times + R], axis=1)[:, None]

    (long,) = next(film.frames(rolling, unturned(1), [[0.0, 0.02]]))
    times = (np.arange(24) + 0.5) / 24 * 0.02
    short = [p[0].image for p in film.frames(rolling, unturned(1), np.stack([times, times], 1))]
    assert np.abs(long.image - np.mean(short, axis=0)).max() < 0.012
    assert np.abs(long.image - short[12]).max() > 0.1


def test_frames_are_the_same_again_and_alone():
    def make():
        return RoomRenderer(overhead(), LAMP, [R, R], look(WHITE, WHITE, texture="cloth"), Surface(steel=(1.5, 0.0)))

    centres = still([0, 0, R], [2 * R, 0, R])
    both = list(make().frames(centres, unturned(2), [[0, 0], [1e-3, 2e-3]]))
    again = next(make().frames(centres, unturned(2), [[1e-3, 2e-3]]))
    np.testing.assert_array_equal(both[1][0].image, again[0].image)


def test_a_pattern_turns_with_its_ball():
    film = RoomRenderer(overhead(), LAMP, [R], look(BallFinish((0.0,), (0.9,), "half")), None)
    over = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    images = []
    for turn in (np.eye(3), over):

        def turned(times, turn=turn):
            return np.broadcast_to(turn, (len(times), 1, 3, 3))

        images.append(next(film.frames(still([0, 0, R]), turned, [[0, 0]]))[0].image)
    assert images[0][60, 80] > 0.7
    assert images[1][60, 80] < 0.1


def test_the_lamp_shows_in_varnish_and_metal():
    dull, varnished = (
        one(RoomRenderer(overhead(), LAMP, [R], look(), m), [0, 0, R])[0].image
        for m in (None, Surface(steel=(1.5, 0.0)))
    )
    assert varnished.max() > 1.5 * dull.max()
    steel = one(RoomRenderer(overhead(), LAMP, [R], look(BLACK, texture="wood"), Surface(steel=IRON_N_K)), [0, 0, R])[
        0
    ].image
    assert steel.max() > 5
    assert steel[57, 72] == pytest.approx(0.51 * 0.3, rel=0.25)  # the sky, mirrored by iron


def test_shadows_fall_away_from_the_lamp():
    film = RoomRenderer(overhead(), LAMP, [R], look(ambient=0.2), None)
    image = one(film, [0, 0, R])[0].image / film.plates[0]
    x, y = film.camera.project([-1.3 * R * 0.83, -1.3 * R * 0.55, 0.0])
    u, v = film.camera.project([1.5 * R * 0.83, 1.5 * R * 0.55, 0.0])
    assert image[round(y), round(x)] < 0.5
    assert image[round(v), round(u)] > 0.85


def test_mains_and_rolling_shutter():
    lamp = Lamp(LAMP.position, LAMP.radius, flicker=Flicker(0.3, 100.0, 0.0))
    film = RoomRenderer(overhead(), lamp, [R], look(), None)
    bright, dark = (p[0].image for p in film.frames(still([0, 0, R]), unturned(1), [[0, 0], [5e-3, 5e-3]]))
    np.testing.assert_allclose(dark / bright, 0.7 / 1.3, rtol=1e-3)
    rolling = RoomRenderer(overhead(line_time=5e-5), LAMP, [R], look(), None)

    def moving(times):
        return np.stack([1.0 * times, 0 * times, 0 * times + R], axis=1)[:, None]

    (leaning,) = next(rolling.frames(moving, unturned(1), [[0.0, 0.0]]))
    (flat,) = next(RoomRenderer(overhead(), LAMP, [R], look(), None).frames(moving, unturned(1), [[3e-3, 3e-3]]))
    row = 60  # exposed 3 ms late
    assert np.abs(leaning.image[row] - flat.image[row]).max() < 0.02
    assert np.abs(leaning.image[row - 8] - flat.image[row - 8]).max() > 0.05


def test_what_no_film_can_show():
    with pytest.raises(ValueError, match="is between the camera and the plate"):
        RoomRenderer(overhead(), Lamp(np.array([0.0, 0.0, 0.3]), 0.01), [R], look(), None)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.3, -0.2)])
def test_a_black_disc_hides_its_outline(tilt):
    """Beside a ball, in even light without shadows: what is missing is what `label_pixels` says."""
    camera, height = overhead(tilt=tilt), 0.012
    at, radii, heights = np.array([[0.02, -0.01, height / 2], [0.045, -0.01, R]]), [1.2 * R, R], [height, 0.0]
    film = RoomRenderer(camera, LAMP, radii, look(BLACK, BLACK, ambient=0.0), None, heights)
    film.shade.cells = []
    film.shade.finish = SurfaceFinish((BLACK, BLACK), (0.5,), ambient=1.0)
    film.shade._unshadowed_shares = lambda ball, points, centre, soft=0.0: (np.zeros(0, int), np.ones((0, 1)))
    film._bare = np.ones(film._bare.shape)
    missing = 1 - one(film, *at)[0].image / film.plates[0]
    radii, heights = np.array(radii), np.array(heights)
    covered = label_pixels(camera, at, radii, find_boxes(camera, at, radii, heights), np.array([1, 2]), heights) > 0
    blurred = gaussian_filter(covered.astype(float), 0.8)
    assert missing.sum() == pytest.approx(covered.sum(), rel=0.01)
    assert np.abs(missing - blurred).max() < 0.3  # half a pixel of an edge
    assert np.abs(missing - blurred).mean() < 0.003


def test_each_body_is_drawn_in_its_own_colour():
    """A red and a blue ball, and discs likewise."""
    sections = {"camera": {"size": [60, 30], "scale": 1.2e-4, "colour": True}, "surface": {"ball": "matte"}}
    launches = [{"position": [-0.002, 0.0]}, {"position": [0.002, 0.0]}]
    for kind in ({}, {"shape": "disc", "support": {"kind": "air"}}):
        bodies = [{"colour": [0.8, 0.1, 0.1], **kind}, {"colour": [0.1, 0.1, 0.8], **kind}]
        clip = check_scene(sections | {"launches": launches, "bodies": bodies}, "scene").draw()
        picture = clip.sketch(0).astype(float)
        for place, own in zip(clip.camera.project(clip.launch.states[:, :3]), (0, 2), strict=True):
            red_green_blue = picture[round(float(place[1])), round(float(place[0]))]
            assert red_green_blue[own] > 2 * np.delete(red_green_blue, own).max()
