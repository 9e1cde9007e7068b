"""The figures of a search's page: error bars that hold when the residuals of a collision depend on each other."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from discrepancy_clips import collisions

from discrepancy.data.launch import T_C
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.report.figures import _residual_figures, average_clusters, find_chi2_scatter
from synthcam.model import Model


def test_the_error_of_an_average_holds_for_values_that_share_an_offset():
    """The square of the error estimates (offsets^2 + noise^2 / values) / clusters without bias."""
    clusters, values, offsets, noise, draws = 9, 4, 3.0, 1.0, 2000
    rng = np.random.default_rng(1)
    cluster = np.repeat(np.arange(clusters), values)
    drawn = np.repeat(offsets * rng.standard_normal((draws, clusters)), values, axis=1)
    drawn += noise * rng.standard_normal(drawn.shape)
    means, errors = np.transpose([average_clusters(cluster, row) for row in drawn])
    variance = (offsets**2 + noise**2 / values) / clusters
    assert np.mean(errors**2) == pytest.approx(variance, rel=0.05)
    assert np.var(means) == pytest.approx(variance, rel=0.1)


@pytest.mark.parametrize("offset", [0.0, 3.0, 40.0])
def test_the_scatter_of_chi2_holds_for_wrong_models_too(offset):
    points = 300
    drawn = np.random.default_rng(2).noncentral_chisquare(points, points * offset**2 + 1e-9, 4000) / points
    claimed = np.sqrt(np.mean(find_chi2_scatter(drawn, np.array(points)) ** 2))
    assert claimed == pytest.approx(drawn.std(), rel=0.05)


def test_clusters_count_the_same_and_two_have_no_error():
    mean, error = average_clusters(np.array([4, 4, 4, 7]), np.array([1.0, 2.0, 3.0, 8.0]))
    assert mean == 5.0
    assert np.isnan(error)


def test_error_bars_follow_from_the_scatter_between_collisions():
    """Residuals that are one number of each collision, along the path of its ball after the contact."""
    clips, noise = collisions(Model(), 6, 3), Noise(NoiseComponent(1.0))
    fit, sizes = fit_model(clips, Model(), (), noise), 1e-5 * np.arange(1.0, 7.0) ** 2
    white = []
    for clip, launch, xy, size in zip(
        clips, fit.launches, predict_tracks(fit.model, fit.launches, clips), sizes, strict=True
    ):
        late, left = clip.frame / clip.fps + clip.exposure / 2 > launch[T_C], np.zeros_like(xy)
        for ball in (0, 1):
            first, *_, last = np.flatnonzero((clip.ball == ball) & late)
            left[clip.ball == ball] = size * (xy[last] - xy[first]) / np.hypot(*(xy[last] - xy[first]))
        white.append(ClipWhitener.of(clip, noise)(left))
    found = SimpleNamespace(
        data=SimpleNamespace(clips=clips, noise=noise, is_cut=False),
        base_fit=dataclasses.replace(fit, residuals=tuple(white)),
        best_fit=fit,
        free_law=None,
        is_empty=True,
        gap=SimpleNamespace(floor_um=1.0),
    )
    means, rms = _residual_figures(found)
    um, square = 1e6 * sizes, (1e6 * sizes) ** 2 / 2
    along, across = (um.mean(), um.std(ddof=1) / np.sqrt(6)), (0.0, 0.0)
    for axis, expected in zip(means.axes, (along, across, along, across), strict=True):
        assert last_bar(axis) == pytest.approx(expected, abs=1e-6)
    root = np.sqrt(square.mean())
    for axis in rms.axes:
        assert last_bar(axis) == pytest.approx((root, square.std(ddof=1) / np.sqrt(6) / (2 * root)))


def last_bar(axis):
    """The height and the error of the last of the first set of points, where every collision has positions."""
    line, _, (bars,) = axis.containers[0]
    part = bars.get_segments()[-1]
    return line.get_ydata()[-1], (part[1, 1] - part[0, 1]) / 2
