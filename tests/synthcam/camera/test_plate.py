"""The plate's light, gloss, shadows and outline, against integrals and geometry written out here."""

import numpy as np
import pytest
from scipy.special import ndtr

from synthcam.camera import plate
from synthcam.camera.lamp import Lamp
from synthcam.camera.pinhole import PinholeCamera
from synthcam.camera.render import MirrorRenderer
from synthcam.camera.surface import IRON_N_K, Surface

R = 1.19e-3
SIDE = Lamp(np.array([0.3, 0.0, 0.4]), 0.002)
CAMERA = PinholeCamera.overhead((160, 100), 5e-5, 0.5, ball_radius=R, fps=250, exposure=0, psf_sigma_px=1.0)


def one_frame(film, *centres):
    positions = np.array(centres, float)
    (picture,) = film.frames(lambda t: np.broadcast_to(positions, (len(t), *positions.shape)), [[0.0, 0.0]])
    return picture


def test_a_wide_lamp_lights_the_plate_as_its_area_does():
    lamp = Lamp(np.array([0.1, 0.05, 0.3]), 0.12)
    points = np.array([[0.0, 0, 0], [0.2, -0.1, 0]])
    side = (np.arange(400) + 0.5) / 200 * 0.12 - 0.12
    u, v = np.meshgrid(side, side)
    inside = u * u + v * v < 0.12**2
    for point, got in zip(points, plate.compute_irradiance(lamp, points), strict=True):
        square = (lamp.position[0] + u - point[0]) ** 2 + (lamp.position[1] + v - point[1]) ** 2 + 0.3**2
        assert got == pytest.approx(np.mean((0.3**4 / square**2)[inside]), rel=2e-3)
    turned = Lamp(SIDE.position, 0.002, towards=np.zeros(3))
    # the cosine is 0.8, and the lamp is twice as near
    assert plate.compute_irradiance(turned, np.zeros(3)) == pytest.approx(0.8 * (0.4 / 0.5) ** 2)


def test_pixels_of_the_plate():
    camera = PinholeCamera.overhead(
        (64, 48), 1e-3, 0.5, (0.1, -0.2), (-0.1, 0.05, 1e-3, 0, 0), ball_radius=R, fps=1, exposure=0, psf_sigma_px=1
    )
    points = plate.plate_points(camera)
    assert np.abs(points[..., 2]).max() < 1e-12
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    np.testing.assert_allclose(camera.project(points), np.stack([x, y], -1), atol=1e-6)


def test_a_shadow_falls_where_the_ball_stands_in_the_light():
    film = MirrorRenderer(CAMERA, SIDE, [R], 1.0, Surface(plate_shadow=True, steel=IRON_N_K))
    picture = one_frame(film, [0, 0, R])
    points = plate.plate_points(CAMERA)
    way = SIDE.position - points
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    offset = np.array([0, 0, R]) - points
    apart = np.linalg.norm(np.cross(way, offset), axis=-1)
    clear = np.linalg.norm(points[..., :2], axis=-1) > R + 4 * CAMERA.scale  # off the ball
    ratio = picture.image / picture.plate
    assert (clear & (apart < R - 4 * CAMERA.scale)).sum() > 100
    assert np.abs(ratio[clear & (apart < R - 4 * CAMERA.scale)]).max() < 2e-3
    np.testing.assert_allclose(ratio[clear & (apart > R + 4 * CAMERA.scale)], 1, atol=2e-3)
    plain = one_frame(MirrorRenderer(CAMERA, SIDE, [R], 1.0, Surface(steel=IRON_N_K)), [0, 0, R])
    assert np.abs(plain.image / plain.plate)[clear].min() > 0.99


def test_two_shadows_in_any_order():
    film = MirrorRenderer(CAMERA, SIDE, [R, R], 1.0, Surface(plate_shadow=True, plate_gloss=0.05, plate_texture=0.1))
    a, b = (
        one_frame(film, [0, 0, R], [1.9 * R, 0.65 * R, 2.5 * R]),
        one_frame(film, [1.9 * R, 0.65 * R, 2.5 * R], [0, 0, R]),
    )
    np.testing.assert_allclose(a.image, b.image, atol=3e-6)
    assert a.image.min() > -1e-6  # two shadows on one position take its light once


@pytest.mark.parametrize("texture", [0.0, 1e-9], ids=["even plate", "drawn plate"])
def test_the_outline_stands_where_the_sphere_ends(texture):
    """A ball that mirrors nothing hides a bright plate: the area and the middle of what is hidden."""
    far_off = Lamp(np.array([5.0, 0.0, 45.0]), 1e-9)  # the same light everywhere
    film = MirrorRenderer(CAMERA, far_off, [R], 1.0, Surface(steel=IRON_N_K, plate_texture=texture))
    film._uniforms |= {"metal": np.array([1.0, 1e-9]), "zenith": 0.0}  # refracts as air does
    film._unit = 0.0
    cover = 1 - one_frame(film, [0.2e-3, -0.1e-3, R]).image / film.plate
    far = 0.5 - R
    width = CAMERA.K[0, 0] * np.tan(np.arcsin(R / far))
    assert np.sqrt(cover.sum() / np.pi) == pytest.approx(width, abs=2e-3)
    down, across = np.mgrid[:100, :160]
    middle = np.array([(cover * across).sum(), (cover * down).sum()]) / cover.sum()
    np.testing.assert_allclose(middle, CAMERA.project([0.2e-3, -0.1e-3, R]), atol=2e-3)
    # Everywhere along the edge: a disc by 24 x 24 points a pixel, through the Gaussian and the pixel.
    sides = [(np.arange(n * 24) + 0.5) / 24 - 0.5 for n in (160, 100)]
    disc = np.hypot(sides[0] - 83.5, sides[1][:, None] - 51.5) < width
    kernels = [np.diff(ndtr(np.arange(len(at) // 24 + 1)[:, None] - 0.5 - at), axis=0) / 24 for at in sides]
    true = kernels[1] @ disc @ kernels[0].T
    steep = np.hypot(*np.gradient(true))
    edge = steep > 0.6 * steep.max()
    assert np.sqrt(np.mean(((cover - true)[edge] / steep[edge]) ** 2)) < 5e-3  # px


def test_the_plate_mirrors_the_ball():
    """Beside the ball, looked at aslant: rays by way of the plate to the ball and on, less the mirrored room there."""
    far_off = Lamp(np.array([5.0, 0.0, 45.0]), 1e-9)
    camera = PinholeCamera.overhead(
        (160, 100), 5e-5, 0.5, (0.9, 0), ball_radius=R, fps=250, exposure=0, psf_sigma_px=0.3
    )
    film = MirrorRenderer(camera, far_off, [R], 1.0, Surface(plate_gloss=0.3, plate_roughness=0.5))
    film._unit = 0.0
    centre = np.array([0, 0, R])
    got = one_frame(film, centre).image - film.plate
    points = plate.plate_points(camera)
    way = points - camera.centre
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    miss = np.linalg.norm(np.cross(way, centre - points), axis=-1)
    up = way * [1, 1, -1]  # off the plate
    offset = points - centre
    b = (offset * up).sum(-1)
    root = b * b - (offset * offset).sum(-1) + R**2
    seen = (root > 0) & (b < 0) & (miss > R + 4 * camera.scale)  # in the plate, and the ball itself is not in the way
    normal = (offset + (-b - np.sqrt(np.maximum(root, 0)))[..., None] * up) / R
    cosine = -(up * normal).sum(-1)
    last = up + 2 * cosine[..., None] * normal
    dark, zenith = plate.BLACK_PLATE_RADIANCE, 1 / Surface().head_on
    room = dark + (zenith - dark) * np.maximum(np.stack([last, up])[..., 2], 0)
    expected = 0.3 * ((0.55 + 0.45 * (1 - cosine) ** 5) * room[0] - room[1])
    inside = seen & (cosine > 0.4)  # well off the image's own outline
    assert inside.sum() > 30
    np.testing.assert_allclose(got[inside], expected[inside], atol=0.01)
    assert np.abs(expected[inside]).min() > 0.02


def test_gloss_throws_the_lamp_to_the_eye():
    """The lobe is brightest if lamp and eye have equal angles; its integral over directions is the gloss."""
    surface = Surface(plate_gloss=0.04, plate_roughness=0.1)
    lamp, eye = Lamp(np.array([0.1, 0, 0.5]), 0.01), np.array([-0.1, 0, 0.5])
    points = np.stack([np.linspace(-0.1, 0.1, 201), np.zeros(201), np.zeros(201)], axis=1)
    light = plate.compute_gloss(lamp, surface, eye, points)
    assert abs(points[light.argmax(), 0]) < 6e-3
    turn = np.linspace(-0.6, 0.6, 61)
    x, y = np.meshgrid(np.tan(turn), np.tan(turn))
    point, high = np.zeros(3), 40.0  # an eye far away, on a dome over the point
    square = 1 + x * x + y * y
    total = 0.0
    eyes = np.stack([x, y, np.ones_like(x)], -1) / np.sqrt(square)[..., None] * high
    seen = np.array(
        [plate.compute_gloss(Lamp(np.array([0, 0, 0.5]), 0.001), surface, e, point) for e in eyes.reshape(-1, 3)]
    )
    steps = np.gradient(np.tan(turn))
    solid = (steps[:, None] * steps).ravel() / square.ravel() ** 1.5
    total = (seen * solid / np.sqrt(square.ravel())).sum()
    arriving = np.pi * 0.001**2 / 0.5**2
    assert total / arriving == pytest.approx(0.04, rel=0.05)


def test_grain_has_the_contrast_asked_for():
    points = np.zeros((300, 300, 3))
    points[..., :2] = np.stack(np.meshgrid(np.arange(300), np.arange(300)), -1) * 1e-4
    grain = plate.compute_grain(Surface(plate_texture=0.1), points)
    assert grain.std() == pytest.approx(0.1, rel=0.1)
    assert grain.mean() == pytest.approx(1, abs=0.01)
    np.testing.assert_array_equal(grain, plate.compute_grain(Surface(plate_texture=0.1), points))
