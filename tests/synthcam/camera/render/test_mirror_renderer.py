"""The film against a ray tracer written here: plain float64, one ray a sample, nothing shared with the program."""

from functools import cache
from itertools import pairwise, product

import cv2
import numpy as np
import pytest
from scipy.ndimage import correlate1d, minimum_filter
from scipy.special import ndtr

from benchmarks.camera import camera_reference
from synthcam.camera import reflections
from synthcam.camera.exposure import merge_boxes
from synthcam.camera.glints import ImageSelection, find_glints
from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.render import MirrorRenderer
from synthcam.camera.surface import STEEL_REFLECTANCE

R = 1.19e-3
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)
ALL = slice(None)


def overhead(**changes):
    settings = {"size": (640, 480), "scale": 1.6e-4, "height": 0.5, "ball_radius": R}
    return PinholeCamera.overhead(**settings | {"fps": 250, "exposure": 5e-4, "psf_sigma_px": 1.0} | changes)


def trace(camera, centres, pixels, radii):
    """Rays through pixels (M, 2): bounces, reflectance kept, by how much the lamp's centre is missed, m, last rise."""
    steps = 10 if np.any(camera.dist) else 1  # enough for the last bit
    flat = cv2.undistortPoints(
        pixels.reshape(-1, 1, 2), camera.K, camera.dist, criteria=(cv2.TERM_CRITERIA_MAX_ITER, steps, 0)
    ).reshape(-1, 2)
    way = np.c_[flat, np.ones(len(flat))] @ camera.R
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    point = np.tile(-camera.R.T @ camera.t, (len(way), 1))
    bounces, kept, last = np.zeros(len(way), int), np.ones(len(way)), np.full(len(way), -1)
    ray = np.arange(len(way))
    while len(ray):
        nearest, ball = np.full(len(ray), np.inf), np.full(len(ray), -1)
        for k, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
            offset = point[ray] - centre
            b, c = np.einsum("ij,ij->i", offset, way[ray]), np.einsum("ij,ij->i", offset, offset) - radius**2
            root = b * b - c
            far = np.where((root > 0) & (b < 0) & (last[ray] != k), -b - np.sqrt(np.maximum(root, 0)), np.inf)
            closer = far < nearest
            nearest[closer], ball[closer] = far[closer], k
        hit = ball >= 0
        ray, ball = ray[hit], ball[hit]
        point[ray] += nearest[hit, None] * way[ray]
        normal = (point[ray] - np.array(centres)[ball]) / np.array(radii)[ball, None]
        cosine = -(way[ray] * normal).sum(1)
        kept[ray] *= STEEL_REFLECTANCE + (1 - STEEL_REFLECTANCE) * (1 - cosine) ** 5
        way[ray] += 2 * cosine[:, None] * normal
        bounces[ray] += 1
        last[ray] = ball
        ray = ray[bounces[ray] < 10]
    rise = np.where(way[:, 2] > 0, way[:, 2], np.nan)
    over = point + ((LAMP.position[2] - point[:, 2]) / rise)[:, None] * way
    miss = np.nan_to_num(np.linalg.norm(over - LAMP.position, axis=1), nan=np.inf)
    return bounces, kept, np.where(bounces > 0, miss, np.inf), way[:, 2]


def lamp_images(camera, centres, radii, highest=3):
    """Images of order 1 to highest: (order, pixel, flux in px^2, variance); the balls are scanned, then zoomed in."""
    found = []
    for centre, radius in zip(centres, radii, strict=True):
        middle = cv2.projectPoints(np.array(centre), cv2.Rodrigues(camera.R)[0], camera.t, camera.K, camera.dist)[0]
        side = np.arange(-1.03, 1.03, 0.01) * radius / camera.scale
        grid = square(middle.ravel(), side)
        bounces, _, miss, _ = trace(camera, centres, grid, radii)
        for order in range(1, highest + 1):
            gap = np.where(bounces == order, miss, np.inf).reshape(len(side), -1)
            lowest = (gap == minimum_filter(gap, 3)) & (gap < 0.4 * order)
            for start in grid[lowest.ravel()]:
                middle = nearest(camera, centres, radii, order, start)
                # Next to a touching ball the scan sees a part of that one too.
                if middle is not None and not any(np.abs(middle - other[1]).max() < 0.05 for other in found):
                    found.append(zoom(camera, centres, radii, order, middle))
    return found


def square(middle, side):
    return np.stack(np.meshgrid(side, side), -1).reshape(-1, 2) + middle


def nearest(camera, centres, radii, order, middle):
    """Find where near a pixel the lamp is seen best by so many bounces, if at all."""
    half = 0.08
    for _ in range(8):
        grid = square(middle, np.linspace(-half, half, 41))
        bounces, _, miss, _ = trace(camera, centres, grid, radii)
        miss = np.where(bounces == order, miss, np.inf)
        middle, half = grid[miss.argmin()], half / 3
    return middle if miss.min() <= LAMP.radius else None


def zoom(camera, centres, radii, order, middle):
    half, lit = 2e-4, np.ones(1681, bool)
    while lit.reshape(41, 41)[[0, -1]].any() or lit.reshape(41, 41)[:, [0, -1]].any():
        half *= 1.5
        bounces, _, miss, _ = trace(camera, centres, square(middle, np.linspace(-half, half, 41)), radii)
        lit = (bounces == order) & (miss < LAMP.radius)
    side = (np.arange(160) + 0.5) / 80 * half - half
    grid = square(middle, side)
    bounces, kept, miss, _ = trace(camera, centres, grid, radii)
    weight = kept * ((bounces == order) & (miss < LAMP.radius))
    position = weight @ grid / weight.sum()
    return order, position, weight.sum() * (half / 80) ** 2, weight @ (grid - position) ** 2 / weight.sum()


@cache
def images_of(name):
    """Lamp images of a scene; of balls that touch, those by up to seven bounces."""
    camera, centres = SCENES[name]
    return lamp_images(camera, np.array(centres, float), radii_of(name), highest=7 if name == "touching" else 3)


def brute_picture(camera, centres, radii, room, unit, plate, images, fineness=8):
    """The whole picture by one ray a sub-sample, body and plate only, blurred and integrated over pixels."""
    w, h = camera.size
    x, y = (np.arange(w * fineness) + 0.5) / fineness - 0.5, (np.arange(h * fineness) + 0.5) / fineness - 0.5
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    bounces, kept, _, rise = trace(camera, centres, grid, radii)
    dark = plate
    body = kept * (dark + (room / STEEL_REFLECTANCE - dark) * np.maximum(rise, 0))
    image = np.where(bounces > 0, body, dark).reshape(h * fineness, w * fineness)
    span = (np.arange(-6 * fineness, 6 * fineness + 1)) / fineness
    kernel = (ndtr((span + 0.5) / camera.psf_sigma_px) - ndtr((span - 0.5) / camera.psf_sigma_px)) / fineness
    for axis in (0, 1):
        image = correlate1d(image, kernel / kernel.sum(), axis=axis, mode="nearest")
    # A pixel's centre lies between samples: the mean of the four around it.
    at = fineness // 2 - 1
    parts = [image[at + dy :: fineness, at + dx :: fineness] for dy in (0, 1) for dx in (0, 1)]
    image = sum(parts) / 4
    columns, rows = np.arange(w) - 0.5, np.arange(h) - 0.5
    for _, (px, py), flux, variance in images:
        sx, sy = np.sqrt(variance + camera.psf_sigma_px**2)
        across = ndtr((columns + 1 - px) / sx) - ndtr((columns - px) / sx)
        down = ndtr((rows + 1 - py) / sy) - ndtr((rows - py) / sy)
        image += unit * flux * np.outer(down, across)
    return image


def still(*centres):
    return lambda times: np.broadcast_to(np.array(centres), (len(times), len(centres), 3))


def one_frame(film, *centres):
    (picture,) = film.frames(still(*centres), [[0.0, 0.0]])
    return picture


SCENES = {
    "touching": (overhead(), [[0, 0, R], [2 * R * np.cos(0.7), 2 * R * np.sin(0.7), R]]),
    "touching in a corner": (overhead(), [[0.045, 0.03, R], [0.045, 0.03 + 2 * R, R]]),
    "tilted": (overhead(tilt=(0.1, -0.15)), [[0.01, -0.02, R], [0.01 + 2.2 * R, -0.02, R]]),
    "bent lens": (overhead(distortion=(-0.2, 0.1, 1e-3, -2e-3, 0)), [[0.04, 0.02, R], [0.04, 0.02 - 2.3 * R, R]]),
    "one over the other": (overhead(), [[0, 0, R], [1.0 * R, 0.3 * R, 3.2 * R]]),
    "unequal, one in the air": (overhead(), [[0.01, 0, R], [0.01 + 2.3 * R, 0, 1.5 * R]]),
}


def radii_of(name):
    return np.array([R, 1.2 * R if "unequal" in name else R])


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.gate] * (n == "bent lens")) for n in SCENES])
def test_every_lamp_image_stands_and_shines_as_traced(name):
    camera, centres = SCENES[name]
    traced = [image for image in images_of(name) if image[0] < 4]
    glints = find_glints(camera, LAMP, np.array([centres], float), radii_of(name), np.ones((1, 2), bool))
    assert sorted(order for order, *_ in traced) == sorted(glints.order[glints.order < 4])
    assert len(traced) == 1 if name == "one over the other" else len(traced) >= 4
    for order, position, flux, variance in traced:
        far = np.linalg.norm(glints.pixels - position, axis=1) + (glints.order != order)
        k = far.argmin()
        assert far[k] < 0.002
        assert glints.flux[k] == pytest.approx(flux, rel=0.01)
        np.testing.assert_allclose(glints.spread[k], variance, rtol=0.03, atol=3e-6)


@pytest.mark.gate
def test_glints_among_many_neighbours_are_all_there_and_stand_as_traced():
    around = (0.1, 2.0), (1.2, 2.3), (2.4, 3.5), (3.3, 2.05), (4.4, 2.6), (5.4, 5.0), (5.5, 14.0)
    rings = [[0.01 + far * R * np.cos(turn), far * R * np.sin(turn), R] for turn, far in around]
    centres, radii, faint = np.array([[0.01, 0, R], *rings]), np.full(8, R), 1e-3
    glints = find_glints(
        overhead(), LAMP, centres[None], radii, np.ones((1, 8), bool), selection=ImageSelection(faintest=faint)
    )
    bright, eye = glints.flux > faint * glints.flux.max(), overhead().centre
    for order in (2, 3):
        chains = [c for c in product(range(8), repeat=order) if all(a != b for a, b in pairwise(c))]
        paths = reflections.reflect(LAMP.position, eye, centres[np.array(chains)], np.full((len(chains), order), R))
        open_ = 0
        for chain, points, transfer, cosines, exists in zip(
            chains, paths.points, paths.transfer, paths.cosines, paths.exists, strict=True
        ):
            slope = overhead().project_with_slope(points[-1])[1] @ transfer[:, :2]
            kept = np.prod(STEEL_REFLECTANCE + (1 - STEEL_REFLECTANCE) * (1 - cosines) ** 5)
            flux = abs(np.linalg.det(slope)) * kept * np.pi * LAMP.radius**2
            ends = np.array([LAMP.position, *points, eye])
            hidden = any(
                np.linalg.norm(np.cross(b - a, centres[k] - a)) < R * np.linalg.norm(b - a)
                and 0 < (centres[k] - a) @ (b - a) < (b - a) @ (b - a)
                for leg, (a, b) in enumerate(pairwise(ends))
                for k in set(range(8)) - {*chain[max(leg - 1, 0) : leg + 1]}
            )
            open_ += bool(exists and not hidden and flux > faint * glints.flux.max())
        assert open_ == (glints.order[bright] == order).sum() > 5
    for k in np.flatnonzero(glints.ball == 0):
        found = camera_reference.lamp_image(overhead(), LAMP, centres, radii, glints.pixels[k], int(glints.order[k]))
        np.testing.assert_allclose(glints.pixels[k], found[0], atol=0.003)
        assert glints.flux[k] == pytest.approx(found[1], rel=0.01)


def test_the_share_of_light_in_higher_orders_at_contact():
    glints = find_glints(overhead(), LAMP, np.array([[[0, 0, R], [0, 2 * R, R]]]), np.full(2, R), np.ones((1, 2), bool))
    share = [glints.flux[glints.order == k].mean() / glints.flux[glints.order == 1].mean() for k in (2, 3, 4)]
    np.testing.assert_allclose(share, [0.053, 0.009, 0.002], rtol=0.1)
    faint = [abs(glints.order - 2) < 1, glints.ball == 0]
    secondary = glints.pixels[faint[0] & faint[1]][0]
    away = np.linalg.norm(secondary - overhead().project([0, 0, R])) * overhead().scale / R
    assert away == pytest.approx(0.7, abs=0.02)


def test_all_light_between_touching_mirrors_is_there():
    """As rays bring it by up to seven bounces: a 65th of what one ball throws on the other comes by five or more."""
    camera, centres = SCENES["touching"]
    glints = find_glints(camera, LAMP, np.array([centres], float), np.full(2, R), np.ones((1, 2), bool))
    thrown = sum(flux for order, _, flux, _ in images_of("touching") if order > 1)
    assert glints.flux[glints.order > 1].sum() == pytest.approx(thrown, rel=0.004)


@pytest.mark.parametrize("name", ["touching", "tilted", "bent lens", "one over the other", "unequal, one in the air"])
def test_the_whole_picture_is_the_traced_one(name):
    camera, centres = SCENES[name]
    radii = radii_of(name)
    film = MirrorRenderer(camera, LAMP, radii, room=0.1)
    picture = one_frame(film, *centres)
    # The tracer looks through a window of 48 x 48 px round the balls.
    left, top = np.round(camera.project(np.mean(centres, axis=0))).astype(int) - 24
    K = camera.K.copy()
    K[:2, 2] -= left, top
    window = PinholeCamera(K, camera.dist, camera.R, camera.t, (48, 48), 250, 0, camera.scale, camera.psf_sigma_px)
    plate = picture.plate[top + 24, left + 24]
    images = [(order, position - [left, top], *rest) for order, position, *rest in images_of(name)]
    expected = brute_picture(window, centres, radii, 0.1, film._unit, plate, images)
    got = picture.image[top : top + 48, left : left + 48]
    inner = (slice(4, -4), slice(4, -4))
    assert np.abs(got - expected)[inner].max() < 1.5e-3  # of which the body's edge, at room = .1
    shifted = np.roll(expected, 1, axis=1)[inner] * 0.01 + expected[inner] * 0.99  # .01 px off would be seen
    assert np.abs(shifted - expected[inner]).max() > 1.5e-3


def test_the_unit_is_the_peak_of_a_centred_glint():
    camera = overhead(size=(641, 481))
    film = MirrorRenderer(camera, LAMP, [R], room=0)
    shift = 0.0
    for _ in range(20):  # push the ball until its glint stands on a pixel's centre
        glint = find_glints(camera, LAMP, np.array([[[shift, 0, R]]]), np.array([R]), np.ones((1, 1), bool)).pixels[0]
        shift -= (glint[0] - 320) * camera.scale
    image = one_frame(film, [shift, 0, R]).image
    assert image.max() == pytest.approx(1, abs=2e-4)
    assert np.unravel_index(image.argmax(), image.shape) == (240, 320)
    assert image[240, 319] == pytest.approx(image[240, 321], rel=1e-5)
    assert one_frame(MirrorRenderer(camera, LAMP, [R], room=0.02), [shift, 0, R]).image.max() == pytest.approx(
        1.02, abs=2e-3
    )


def test_the_plate_is_black_and_only_boxes_differ_from_it():
    film = MirrorRenderer(overhead(), LAMP, [R, R], room=0.02)
    picture = one_frame(film, [0, 0, R], [0.02, 0.01, R])
    assert picture.plate is film.plate
    assert 0 < film.plate.min() < film.plate.max() <= 0.00101
    rest = picture.image.copy()
    for box in picture.boxes:
        rest[box] = film.plate[box]
    np.testing.assert_array_equal(rest, film.plate)
    # Lambert under a small lamp: brightest below it, cos^4 elsewhere.
    down = np.array([[0.02, 0.03, 0.0]])
    x, y = np.round(film.camera.project(down)[0]).astype(int)
    reach = LAMP.position - [0.02, 0.03, 0]
    cosine = reach[2] / np.linalg.norm(reach)
    assert film.plate[y, x] == pytest.approx(0.001 * cosine**4, rel=2e-3)


def test_a_balls_dark_ring_mirrors_the_plate_around_it():
    """Outside sin 45 deg of its radius a ball shows the plate: Schlick's share of Lambert's radiance there."""
    low = Lamp(np.array([0.3, 0.0, 0.4]), 0.002)
    camera = overhead(scale=4e-5, size=(101, 101))
    film = MirrorRenderer(camera, low, [R], room=1)
    image = one_frame(film, [0, 0, R]).image
    seen_at = np.round(0.85 * R / camera.scale)
    cosine = np.sqrt(1 - (seen_at * camera.scale / R) ** 2)
    plate = 0.05 * (0.4 / 0.5) ** 4
    assert film.plate[50, 50] == pytest.approx(plate, rel=1e-3)
    assert image[50 + int(seen_at), 50] == pytest.approx((0.55 + 0.45 * (1 - cosine) ** 5) * plate, rel=0.01)
    assert image[50, 50] == pytest.approx(1, abs=0.02)


def test_boxes_never_overlap():
    """The sensor draws each box once; a pixel in two of them would be drawn twice."""
    film = MirrorRenderer(overhead(), LAMP, [R] * 4)
    picture = one_frame(film, [0, 0, R], [2 * R, 0, R], [0, 5.5 * R, R], [0.02, 0, R])
    count = np.zeros(picture.image.shape, int)
    for box in picture.boxes:
        count[box] += 1
    assert count.max() == 1
    assert len(picture.boxes) < 4
    bridged = merge_boxes([(0, 2, 0, 2), (5, 7, 0, 2), (20, 22, 0, 2), (1, 6, 1, 3), (7, 9, 0, 2)])
    assert sorted((b[0].start, b[0].stop, b[1].start, b[1].stop) for b in bridged) == [
        (0, 7, 0, 3),
        (7, 9, 0, 2),
        (20, 22, 0, 2),
    ]


def kick(times):
    """Two balls, the second flying 12 px an exposure of 1 ms until it bounces off the first at .5 ms."""
    x = 12 * 1.6e-4 * (times - 5e-4) / 1e-3
    hit = np.maximum(x, 0)
    y = 0 * times
    return np.stack(
        [np.stack([hit * 0.6, hit * 0.3, y + R], -1), np.stack([np.minimum(x, x * 0.3) - 2 * R, y, y + R], -1)], axis=1
    )


def test_a_blurred_frame_is_the_mean_of_many_sharp_ones():
    film = MirrorRenderer(overhead(), LAMP, [R, R], room=0.05)
    (blurred,) = film.frames(kick, [[0.0, 1e-3]], breaks=[-1.0, 5e-4, 7.0])
    instants = (np.arange(200) + 0.5) / 200 * 1e-3
    mean = np.mean([p.image for p in film.frames(kick, np.c_[instants, instants])], axis=0)
    assert np.abs(blurred.image - mean).max() < 5e-4
    y, x = np.mgrid[:480, :640]
    for axis in (x, y):
        here = [((image - film.plate) * axis).sum() / (image - film.plate).sum() for image in (blurred.image, mean)]
        assert abs(here[0] - here[1]) < 5e-4
    (careless,) = film.frames(kick, [[0.0, 1e-3]])
    assert np.abs(careless.image - mean).max() > 2 * np.abs(blurred.image - mean).max()  # the break matters


def test_a_ball_at_the_edge_or_outside():
    wide, narrow = overhead(size=(200, 100)), overhead(size=(100, 60))
    shift = np.array([(200 - 100) / 2, (100 - 60) / 2]).astype(int)
    large, small = MirrorRenderer(wide, LAMP, [R, R]), MirrorRenderer(narrow, LAMP, [R, R])
    for x, y in [(0.008, 0.0), (0.0085, 0.005), (-0.0079, -0.0048), (0.0095, 0.0), (50.0, 0.0)]:
        positions = ([x, y, R], [0.6 * R, 0.1 * R, R])
        whole, part = one_frame(large, *positions), one_frame(small, *positions)
        crop = whole.image[shift[1] : shift[1] + 60, shift[0] : shift[0] + 100]
        np.testing.assert_allclose(part.image, crop, atol=2e-6)
    assert one_frame(small, [1.0, 0, R], [0, 1.0, R]).boxes == ()
    assert len(one_frame(small, [0, 0, 0.6], [0, 0, R]).boxes) == 1  # the first is behind the camera


def test_any_number_of_balls_in_any_order():
    centres = np.array([[0, 0, R], [2 * R, 0.1 * R, R], [R, 1.9 * R, R], [0.02, 0, R]])
    film = MirrorRenderer(overhead(), LAMP, [R] * 4)
    a, b = one_frame(film, *centres), one_frame(film, *centres[[2, 3, 0, 1]])
    np.testing.assert_allclose(a.image, b.image, atol=1e-6)
    single = one_frame(MirrorRenderer(overhead(), LAMP, [R]), centres[3])
    far = (slice(200, 280), slice(435, 455))
    np.testing.assert_allclose(a.image[far], single.image[far], atol=2e-3)
    expected = sorted(order for order, *_ in lamp_images(overhead(), centres[:3], [R] * 3, highest=2))
    found = find_glints(overhead(), LAMP, centres[None, :3], np.full(3, R), np.ones((1, 3), bool))
    assert sorted(found.order[found.order < 3].tolist()) == expected == [1] * 3 + [2] * 6


def test_a_pair_is_drawn_as_balls_in_any_number_are():
    """Two balls have a shader of their own."""
    centres = np.array([[0, 0, R], [1.7 * R, 1.1 * R, R], [1.0, 0, R]])
    pair, many = (one_frame(MirrorRenderer(overhead(), LAMP, [R] * n), *centres[:n]).image for n in (2, 3))
    np.testing.assert_allclose(pair, many, atol=1e-7)


def test_a_crowd_leaves_out_less_than_the_noise():
    """Faint glints and images of far neighbours are left out, and balls that move little are drawn at one moment."""
    rng = np.random.default_rng(5)
    places = 3.4 * R * np.stack(np.meshgrid(range(-2, 3), range(-2, 3)), -1).reshape(-1, 2) + rng.uniform(
        -6e-4, 6e-4, (25, 2)
    )
    start, speed = (
        np.pad(places, ((0, 0), (0, 1)), constant_values=R),
        np.pad(rng.uniform(-0.2, 0.2, (25, 2)), ((0, 0), (0, 1))),
    )
    noise = 5e-3
    every, few = (MirrorRenderer(overhead(), LAMP, [R] * 25, faintest=faint) for faint in (1e-5, 0.2 * noise))
    shown = [next(film.frames(lambda t: start + t[:, None, None] * speed, [[0.0, 5e-4]])) for film in (every, few)]
    off = np.abs(shown[0].image - shown[1].image)
    assert off.max() < 0.5 * noise
    assert np.sqrt((off**2)[shown[0].image != few.plate].mean()) < 0.1 * noise
    # The sensor draws the listed pixels: all that differ from the plate, and far fewer than lie in merged boxes.
    listed = np.zeros(few.plate.shape, bool)
    listed.flat[shown[1].changed] = True
    assert np.abs(shown[1].image - few.plate)[~listed].max() < 1e-4
    assert 25 * 150 < listed.sum() < 25 * 500


def test_frames_do_not_depend_on_their_company(monkeypatch):
    film = MirrorRenderer(overhead(), LAMP, [R, R])
    starts = np.arange(70) * 1e-4
    spans = np.c_[starts, starts + 5e-4]
    together = list(film.frames(kick, spans, breaks=[5e-4]))
    monkeypatch.setattr("synthcam.camera.render.mirror_renderer.EXPOSURES_PER_BATCH", 16)
    monkeypatch.setattr("synthcam.camera.glints.MAX_PATHS_AT_ONCE", 40)
    again = list(MirrorRenderer(overhead(), LAMP, [R, R]).frames(kick, spans, breaks=[5e-4]))
    for k in range(0, 70, 3):
        (alone,) = film.frames(kick, spans[k : k + 1], breaks=[5e-4])
        assert alone.boxes == together[k].boxes
        np.testing.assert_array_equal(alone.image, together[k].image)
        np.testing.assert_array_equal(again[k].image, together[k].image)


def test_settings_it_cannot_draw_are_refused():
    with pytest.raises(ValueError, match="between the camera and the plate"):
        MirrorRenderer(overhead(), Lamp(np.array([0.0, 0.0, 0.3]), 0.01), [R])
    with pytest.raises(ValueError, match="distortion"):
        MirrorRenderer(overhead(distortion=(-20, 0, 0, 0, 0)), LAMP, [R])


def test_a_wide_lamp_is_the_sum_of_its_parts():
    """A ring as 400 small discs of its plane."""
    camera = overhead(size=(101, 81), scale=8e-5)
    ring = Lamp(LAMP.position, 0.12, "ring", 0.1)
    whole = one_frame(MirrorRenderer(camera, ring, [R], room=0), [0, 0, R]).image
    parts, ball = np.zeros((81, 101)), (np.array([[[0, 0, R]]]), np.array([R]), np.ones((1, 1), bool))
    columns, rows = np.arange(102) - 0.5, np.arange(82) - 0.5
    for radius in np.sqrt(np.linspace(0.1**2, 0.12**2, 9)[1::2]):
        for turn in np.arange(100) * 2 * np.pi / 100:
            position = LAMP.position + radius * np.array([np.cos(turn), np.sin(turn), 0])
            glints = find_glints(camera, Lamp(position, 0.002), *ball)
            px, py = glints.pixels[0]
            parts += glints.flux[0] * np.outer(np.diff(ndtr(rows - py)), np.diff(ndtr(columns - px)))
    parts *= whole.sum() / parts.sum()
    assert np.abs(whole - parts).max() < 5e-3
    assert whole.max() == pytest.approx(1, abs=0.05)
    disc = one_frame(MirrorRenderer(camera, Lamp(LAMP.position, 0.12), [R], room=0), [0, 0, R]).image
    assert np.abs(disc * whole.sum() / disc.sum() - parts).max() > 0.1


def test_vignetting_takes_its_share_in_the_corners():
    plain, dark = (MirrorRenderer(overhead(vignetting=v), LAMP, [R], room=0.1) for v in (0.0, 0.4))
    for position in ([0.0, 0, R], [0.045, 0.03, R]):
        before, after = one_frame(plain, position).image, one_frame(dark, position).image
        y, x = np.unravel_index(before.argmax(), before.shape)
        box = np.s_[y - 3 : y + 4, x - 3 : x + 4]
        share = 1 - 0.4 * ((x - 319.5) ** 2 + (y - 239.5) ** 2) / (320**2 + 240**2)
        assert after[box].sum() / before[box].sum() == pytest.approx(share, rel=0.01)
    assert dark.plate[0, 0] == pytest.approx(0.6 * plain.plate[0, 0], rel=0.01)
