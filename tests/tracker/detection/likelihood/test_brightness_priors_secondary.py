"""The common reflectance of secondary glints: positions gain what conditioning gains, or nothing."""

import numpy as np
import pytest
from tracker_film import CAMERA, disc, expose, spot

from synthcam.camera.glints import find_glints
from synthcam.camera.pinhole import Lamp, project_glint
from synthcam.camera.pinhole import PinholeCamera as Drawn
from tracker.camera.camera import Camera
from tracker.camera.mirror_images import secondary_flux_ratio
from tracker.camera.recordings import Frames, Recording
from tracker.detection.detect import detect, make_view
from tracker.detection.likelihood.brightness_priors import apply_common_reflectance
from tracker.detection.likelihood.cramer_rao import localisation_bound

POSITION, CROSS = 0.01**2, np.array([0.45, 0.2])  # variance of a position; its correlation with the reflectance by axis


def film(rng, n, noise=0.2, scatter=0.0):
    """n glints with secondary ones of reflectance .55, the errors of both correlated, the noise of each another."""
    true, own = rng.uniform(0, 600, (n, 2)), (noise * rng.uniform(0.5, 2, n)) ** 2
    whole = np.zeros((n, 3, 3))
    whole[:, :2, :2], whole[:, 2, 2] = POSITION * np.eye(2), own
    cross = CROSS * np.sqrt(POSITION * own)[:, None]
    whole[:, 2, :2] = whole[:, :2, 2] = cross
    error = (np.linalg.cholesky(whole) @ rng.standard_normal((n, 3, 1)))[..., 0]
    seen = 0.55 + scatter * rng.standard_normal(n) + error[:, 2]
    return true, true + error[:, :2], np.broadcast_to(POSITION * np.eye(2), (n, 2, 2)).copy(), seen, cross, own


def z_of(miss, cov):
    return np.linalg.solve(np.linalg.cholesky(cov), miss[..., None])[..., 0]


def test_it_gains_what_conditioning_gains():
    true, seen, *rest = film(np.random.default_rng(1), 4000)
    better, cov = apply_common_reflectance(seen, *rest)
    left = ((better - true) ** 2).mean(axis=0) / POSITION
    assert left == pytest.approx(1 - CROSS**2, abs=0.05)
    assert np.diagonal(cov, axis1=1, axis2=2).mean(axis=0) / POSITION == pytest.approx(left, rel=0.05)


@pytest.mark.parametrize("n", [2, 4, 12])
def test_few_stay_honest(n):
    """None counts itself twice: with two, each knows only the other."""
    rng, z = np.random.default_rng(n), []
    for _ in range(6000 // n):
        true, seen, *rest = film(rng, n)
        better, cov = apply_common_reflectance(seen, *rest)
        z.append(z_of(better - true, cov))
    assert np.concatenate(z).std() == pytest.approx(1.0, abs=0.02)


def test_balls_that_differ_share_little():
    true, seen, cov, *rest = film(np.random.default_rng(3), 400, noise=0.05, scatter=1.0)
    better, surer = apply_common_reflectance(seen, cov, *rest)
    assert np.abs(better - seen).max() < 0.2 * np.sqrt(POSITION)
    np.testing.assert_allclose(surer, cov, atol=0.01 * POSITION)
    alone, same = apply_common_reflectance(seen[:1], cov[:1], *[part[:1] for part in rest])
    np.testing.assert_array_equal(alone, seen[:1])
    np.testing.assert_array_equal(same, cov[:1])
    assert len(true) == 400


@pytest.mark.parametrize("gap", [2.0, 2.3, 4.0])
def test_the_share_of_light_is_the_films(gap):
    """Against the camera's own images: two mirrors of 55 % over one."""
    camera, rng = Camera.from_dict(CAMERA), np.random.default_rng(int(10 * gap))
    drawn = Drawn(
        camera.K, camera.dist, camera.R, camera.t, camera.size, camera.fps, 0.0, camera.scale, camera.sigma or 1.0
    )
    lamp, radii = Lamp(np.array(camera.lamp.position), 0.005), np.full(2, camera.radius)
    for turn in rng.uniform(0, 2 * np.pi, 4):
        way = gap * camera.radius * np.array([np.cos(turn), np.sin(turn), 0])
        centres = np.array([0.002, -0.001, camera.radius]) + np.array([0 * way, way])
        found = find_glints(drawn, lamp, centres[None], radii, np.ones((1, 2), bool))
        one, two = (np.array([found.flux[(found.ball == k) & (found.order == n)][0] for k in (0, 1)]) for n in (1, 2))
        seen = project_glint(drawn, lamp, centres, camera.radius)
        np.testing.assert_allclose(0.55 * secondary_flux_ratio(camera, seen, seen[::-1]), two / one, rtol=0.025)


@pytest.mark.gate
def test_small_balls_that_touch_are_where_the_bound_says():
    """Ten pixels wide, all images of the lamp as the camera has them: errors, and what is claimed, beside the bound."""
    rng, radius, size = np.random.default_rng(7), 1.19e-3, 25
    K = [[2095.8, 0, 99.5], [0, 2095.8, 79.5], [0, 0, 1]]
    camera = Camera.from_dict(CAMERA | {"scale": 2.38e-4, "K": K})
    drawn = Drawn(np.array(K), camera.dist, camera.R, camera.t, camera.size, 250, 0.0, 2.38e-4, 1.0)
    lamp, pictures, true = Lamp(np.array(camera.lamp.position), 0.002), [np.full((160, 200), 0.5)], []
    for _ in range(40):
        picture = np.full((160, 200), 0.5)
        for column, row in ((40, 40), (150, 40), (40, 120), (150, 120)):
            middle, _ = camera.unproject(np.array([column, row]) + rng.uniform(-0.5, 0.5, 2))
            turn = rng.uniform(0, np.pi)
            way = rng.uniform(1, 1.05) * radius * np.array([np.cos(turn), np.sin(turn), 0])
            centres = np.array([*middle, radius]) + np.array([-way, way])
            found = find_glints(drawn, lamp, centres[None], np.full(2, radius), np.ones((1, 2), bool))
            part = picture[row - size : row + size, column - size : column + size]
            corner = np.array([column, row]) - size
            for position in drawn.project(centres) - corner:
                part += 4 * disc(part.shape, *position, 5.0)
            bright = found.flux / found.flux[found.order == 1].mean() * 200 * 2 * np.pi
            for position, flux in zip(found.pixels - corner, bright, strict=True):
                part += flux * spot(part.shape, *position, 1.0)
            true.append([[len(pictures), *position] for position in found.pixels[found.order == 1]])
        pictures.append(picture)
    frames = np.array([expose(rng, picture) for picture in pictures])
    clip = Recording(0, camera, Frames(len(frames), frames.shape[1:], frames.dtype, lambda k: frames[k]))
    found, positions = detect(clip, make_view(clip)).glints, np.concatenate(true)
    far = np.hypot(*(found.xy[:, None] - positions[:, 1:]).T) + 1e3 * (positions[:, :1] != found.frame)
    assert len(found) == len(positions) == 320
    order = far.argmin(axis=1)
    miss, cov = found.xy[order] - positions[:, 1:], found.cov[order]
    bound = localisation_bound(camera, np.full(320, 400 * np.pi), positions[:, 1:], background=12.5)
    unit = np.sqrt(np.trace(bound.mean(axis=0)) / 2)
    assert np.sqrt(np.mean(miss**2)) / unit == pytest.approx(1.0, abs=0.07)
    assert np.sqrt(np.trace(cov.mean(axis=0)) / 2) / unit == pytest.approx(1.0, abs=0.06)
    assert np.sqrt(np.mean(z_of(miss, cov) ** 2)) == pytest.approx(1.0, abs=0.07)
