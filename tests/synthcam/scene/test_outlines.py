"""Outlines of balls against points on spheres that OpenCV projects."""

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


def outline(camera, centre, radius):
    """The hull of points on a sphere, as OpenCV projects them: (n, 2) px, in turn."""
    k = np.arange(40_000) + 0.5
    z, angle = 1 - 2 * k / len(k), np.pi * (1 + 5**0.5) * k
    points = centre + radius * np.stack([*(np.sqrt(1 - z**2) * [np.cos(angle), np.sin(angle)]), z], axis=1)
    turn, _ = cv2.Rodrigues(camera.R)
    pixels = cv2.projectPoints(points, turn, camera.t, camera.K, camera.dist)[0]
    return cv2.convexHull(pixels.astype(np.float32))[:, 0]


def label(camera, centres, radii):
    centres, radii = np.array(centres, float), np.array(radii, float)
    return label_pixels(camera, centres, radii, find_boxes(camera, centres, radii), np.arange(1, len(radii) + 1))


@pytest.mark.parametrize("lens", [{}, LENS], ids=["plain", "tilted and distorted"])
@pytest.mark.parametrize("at", [(0.0, 0.0), (0.03, -0.02), (-0.062, 0.045)])
def test_a_ball_covers_what_lies_within_its_outline(lens, at):
    seen = camera(**lens)
    centre = np.array([*at, RADIUS])
    hull = outline(seen, centre, RADIUS)
    corner = np.array(seen.size) - 0.5
    (box,) = find_boxes(seen, centre[None], np.array([RADIUS]))
    np.testing.assert_allclose(box, np.clip([*hull.min(axis=0), *hull.max(axis=0)], -0.5, [*corner] * 2), atol=0.01)
    covered = label(seen, [centre], [RADIUS])
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
