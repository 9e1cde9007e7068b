"""Outlines of balls and discs against points on spheres and rims that OpenCV projects."""

import cv2
import numpy as np
import pytest

from synthcam.camera.pinhole import PinholeCamera
from synthcam.scene.outlines import find_boxes, label_pixels

RADIUS = 0.0119
LENS = {"tilt": (0.15, -0.1), "distortion": (-0.3, 0.2, 2e-3, -1e-3, 0.05)}


def camera(**more):
    fields = {"fps": 250, "exposure": 1e-3, "psf_sigma_px": 0.7}
    return PinholeCamera.overhead((160, 120), 8e-4, 0.3, ball_radius=RADIUS, **fields, **more)


def outline(camera, centre, radius, height):
    """The hull of points on a sphere, or on the rims of a disc, as OpenCV projects them: (n, 2) px, in turn."""
    k = np.arange(1_000 if height else 40_000) + 0.5
    z, angle = 1 - 2 * k / len(k), np.pi * (1 + 5**0.5) * k
    ring = np.stack([np.cos(angle), np.sin(angle)])
    points = centre + radius * np.stack([*(np.sqrt(1 - z**2) * ring), z], axis=1)
    if height:
        points = centre + np.stack([*(radius * ring), np.sign(z) * height / 2], axis=1)
    turn, _ = cv2.Rodrigues(camera.R)
    pixels = cv2.projectPoints(points, turn, camera.t, camera.K, camera.dist)[0]
    return cv2.convexHull(pixels.astype(np.float32))[:, 0]


def label(camera, centres, radii, height=0.0):
    centres, radii = np.array(centres, float), np.array(radii, float)
    heights = np.full(len(radii), height)
    boxes = find_boxes(camera, centres, radii, heights)
    return label_pixels(camera, centres, radii, boxes, np.arange(1, len(radii) + 1), heights)


@pytest.mark.parametrize("lens", [{}, LENS], ids=["plain", "tilted and distorted"])
@pytest.mark.parametrize(
    ("at", "height"), [((0.0, 0.0), 0), ((0.03, -0.02), 0), ((-0.062, 0.045), 0), ((0.03, -0.02), 0.008)]
)
def test_a_body_covers_what_lies_within_its_outline(lens, at, height):
    seen = camera(**lens)
    centre = np.array([*at, RADIUS])
    hull = outline(seen, centre, RADIUS, height)
    corner = np.array(seen.size) - 0.5
    (box,) = find_boxes(seen, centre[None], np.array([RADIUS]), np.array([height]))
    np.testing.assert_allclose(box, np.clip([*hull.min(axis=0), *hull.max(axis=0)], -0.5, [*corner] * 2), atol=0.01)
    covered = label(seen, [centre], [RADIUS], height)
    rows, columns = np.mgrid[: seen.size[1], : seen.size[0]]
    pixels = zip(columns.ravel().tolist(), rows.ravel().tolist(), strict=True)
    inside = np.array([cv2.pointPolygonTest(hull, pixel, True) for pixel in pixels]).reshape(covered.shape)
    sure = np.abs(inside) > 0.02
    np.testing.assert_array_equal(covered[sure] > 0, inside[sure] > 0)
    assert 50 < covered.sum() < 900


def test_the_nearer_ball_is_in_front():
    """A small ball flies over a large one; another one rolls away under it, and one is out of view."""
    centres = [[0.0, 0, 0.04], [0.004, 0.0, 0.012], [-0.0205, 0, 0.012], [0.5, 0, 0.012]]
    found = label(camera(), centres, [0.006, 0.012, 0.012, 0.012])
    alone = [label(camera(), [c], [r]) > 0 for c, r in zip(centres, (0.006, 0.012, 0.012, 0.012), strict=True)]
    assert (alone[0] & alone[1]).sum() > 20
    assert not alone[3].any()
    np.testing.assert_array_equal(found == 1, alone[0])
    np.testing.assert_array_equal(found == 2, alone[1] & ~alone[0])
    np.testing.assert_array_equal(found == 3, alone[2] & ~alone[0])
    assert set(np.unique(found)) == {0, 1, 2, 3}


def test_the_disc_nearer_to_the_camera_is_in_front():
    """Its top hides a part of the other; the large one is behind, though its centre is as near as that of the small."""
    centres, radii = [[0.06, 0.0, 0.012], [0.0845, 0.0, 0.012]], [0.004, 0.02]
    found = label(camera(), centres, radii, 0.024)
    alone = [label(camera(), [c], [r], 0.024) > 0 for c, r in zip(centres, radii, strict=True)]
    assert (alone[0] & alone[1]).sum() > 5
    np.testing.assert_array_equal(found == 1, alone[0])
