"""Many touching discs of one region: racks drawn by supersampling, and shapes that are no discs."""

import time

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tracker_discs import disc

from tracker.detection.outlines.contrast_regions import split_region
from tracker.detection.outlines.disc_packing import fit_disc_packing, pack_region

SIZE = (150, 160)


def rack(rows, radius, start=(30.3, 70.6), gap=0.0):
    """Centres (n, 2) of a triangle of discs that touch, its head first."""
    step = 2 * radius + gap
    return np.array([
        [start[0] + row * step * np.sqrt(3) / 2, start[1] + (k - row / 2) * step]
        for row in range(rows) for k in range(row + 1)
    ])  # fmt: skip


def cover_of(centres, radius, noise=0.03):
    """The share of each pixel that discs of this radius cover, with noise."""
    bare = np.prod([1 - disc(at, radius, size=SIZE) for at in centres], axis=0)
    return 1 - bare + np.random.default_rng(0).normal(0, noise, SIZE)


@pytest.mark.parametrize(("rows", "radius"), [(2, 11.2), (3, 5.6), (3, 11.2), (5, 8.3)])
def test_all_balls_of_a_rack_are_found(rows, radius):
    centres = rack(rows, radius)
    fits = fit_disc_packing(np.where(cover_of(centres, radius) > 0.3, cover_of(centres, radius), 0), (0, 0), radius,
                            2 * radius)  # fmt: skip
    away = np.hypot(*(centres[:, None] - [fit.position for fit in fits]).transpose(2, 0, 1))
    assert len(fits) == len(centres)
    assert away.min(axis=1).max() < 0.25  # px
    assert sorted(away.argmin(axis=1).tolist()) == list(range(len(centres)))


def test_discs_that_a_plane_enlarges_are_told_apart():
    """Discs of 7 px whose centres are 11.2 px apart, as a plane that saturates shows balls of 5.6 px."""
    centres = rack(3, 5.6)
    radii = np.array([7.0, 6.6, 7.2, 7.0, 5.2, 7.0])
    cover = 1 - np.prod([1 - disc(at, r, 0.4, size=SIZE) for at, r in zip(centres, radii, strict=True)], axis=0)
    fits = fit_disc_packing(cover, (100, 50), 7.0, 11.2)
    found = np.array([fit.position for fit in fits]) - np.array([100, 50])
    away = np.hypot(*(centres - found[:, None]).transpose(2, 0, 1))
    assert len(fits) == 6
    assert away.min(axis=1).max() < 1.0


def test_a_full_rack_is_found_although_its_gaps_do_not_show():
    """Discs of 13.2 px whose centres are 22.4 px apart leave no gap; the three inner ones have no outline."""
    centres = rack(5, 11.2)
    cover = cover_of(centres, 13.2)
    found = np.array([fit.position for fit in fit_disc_packing(np.where(cover > 0.3, cover, 0), (0, 0), 12.6, 22.4)])
    away = np.hypot(*(centres[:, None] - found.reshape(-1, 2)).transpose(2, 0, 1))
    assert len(found) == 15
    assert away.min(axis=1).max() < 0.1  # px


def test_a_faint_ball_is_found_beside_those_that_it_touches():
    """The plane shows it at a third of the contrast of the others, in the middle of a side of the rack."""
    centres, faint = rack(4, 11.2), 3
    others = np.delete(centres, faint, axis=0)
    cover = np.maximum(cover_of(others, 12.4, 0.0), 0.35 * disc(centres[faint], 11.2, size=SIZE))
    own = cover > 0.5
    rows, columns = np.nonzero(own)
    at = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    (region,) = split_region(cover[at], own[at], (at[1].start, at[0].start), 0, 0.5, 3.0)
    found = np.array([fit.position for fit in pack_region(region, cover, 12.4, 22.4)]).reshape(-1, 2)
    away = np.hypot(*(centres[:, None] - found).transpose(2, 0, 1)).min(axis=1, initial=99)
    assert len(found) == len(centres)
    assert away[faint] < 1.5  # px
    assert np.delete(away, faint).max() < 0.5


@pytest.mark.parametrize("shape", ["bar", "palm", "ring"])
def test_what_is_no_group_of_discs_has_no_fit(shape):
    """None of these shapes has the outline of discs of 8 px, although each has the area of several."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    far = np.hypot(x - 80, y - 75)
    shapes = {
        "bar": (np.abs(y - 75) < 5) & (np.abs(x - 80) < 50),
        "palm": (far < 23) | ((np.abs(y - 75) < 4) & (x > 80) & (x < 140)),
        "ring": (far < 40) & (far > 30),
    }
    cover = gaussian_filter(shapes[shape].astype(float), 0.7)
    assert fit_disc_packing(cover, (0, 0), 8.0, 16.0) == []


def test_a_region_beside_others_is_fitted_alone():
    """Another group 4 px away keeps its pixels, and a hole of a dim stripe does not count."""
    centres = np.array([[40.2, 60.4], [62.6, 60.4], [95.0, 60.4]])
    cover = cover_of(centres, 11.2, 0.0)
    cover[58:63, 38:43] = 0.2
    own = cover > 0.5
    own[:, 80:] = False
    rows, columns = np.nonzero(own)
    at = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    (region,) = split_region(cover[at], own[at], (at[1].start, at[0].start), 0, 0.5, 3.0)
    fits = pack_region(region, cover, 11.2, 22.4)
    assert np.allclose(sorted(fit.position[0] for fit in fits), centres[:2, 0], atol=0.15)


def test_a_wide_bar_is_no_pack_of_discs():
    """Discs of 9 px cover nine tenths of it, and their hull covers all."""
    cover = np.zeros(SIZE)
    cover[10:140, 60:101] = 1.0
    assert fit_disc_packing(cover, (0, 0), 9.3, 16.2) == []


def test_balls_of_many_that_hardly_show_do_not_hide_the_others():
    """Most of two balls has the plate's colour; a stripe of each is left, which touches the others."""
    centres = rack(4, 11.2)
    dim, others = centres[[6, 9]], np.delete(centres, [6, 9], axis=0)  # two corners
    stripe = np.abs(np.mgrid[: SIZE[0], : SIZE[1]][1] - dim[0, 0]) < 4
    cover = np.maximum(cover_of(others, 11.2, 0.0), cover_of(dim, 11.2, 0.0) * stripe)
    found = np.array([fit.position for fit in fit_disc_packing(cover, (0, 0), 11.2, 22.4)]).reshape(-1, 2)
    away = np.hypot(*(others[:, None] - found).transpose(2, 0, 1)).min(axis=1, initial=99)
    assert away.max() < 0.5


def test_a_person_is_refused_at_once():
    """The area of 500 discs of 8 px is too much for 24; the search for first centres would take seconds."""
    y, x = np.mgrid[:800, :800]
    began = time.process_time()
    assert fit_disc_packing((np.hypot(x - 400, y - 400) < 180).astype(float), (0, 0), 8.0, 14.0) == []
    assert time.process_time() - began < 0.5  # s
