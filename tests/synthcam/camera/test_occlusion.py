"""Hidden shares of balls against areas of circles that overlap."""

import numpy as np
import pytest

from synthcam.camera.occlusion import compute_hidden_shares
from synthcam.camera.pinhole import PinholeCamera
from synthcam.scene.scene import Scene


def look(height=100.0, tilt=(0.0, 0.0)):
    return PinholeCamera.overhead((640, 480), 1e-4, height, tilt, ball_radius=1e-3, fps=250, exposure=0, psf_sigma_px=1)


def overlap(large, small, apart):
    """Area of the part of a small circle that lies in a large one (a lens), over the area of the small one."""
    one = (apart**2 + small**2 - large**2) / (2 * apart * small)
    other = (apart**2 + large**2 - small**2) / (2 * apart * large)
    square = (large + small - apart) * (apart + small - large) * (apart - small + large) * (apart + small + large)
    area = small**2 * np.arccos(one) + large**2 * np.arccos(other) - np.sqrt(square) / 2
    return area / (np.pi * small**2)


@pytest.mark.parametrize("ratio", [0.3, 0.5, 0.8])
def test_a_larger_ball_that_touches_a_smaller_one_hides_a_part_of_it(ratio):
    large, small = 1e-3, ratio * 1e-3
    apart = 2 * np.sqrt(large * small)  # of the centres, seen from overhead
    centres = np.array([[[0, 0, large]], [[0.6 * apart, 0.8 * apart, small]]])
    shares = compute_hidden_shares(look(), centres, np.array([large, small]))
    assert shares[0, 0] == 0
    assert shares[1, 0] == pytest.approx(overlap(large, small, apart), abs=0.01)


def test_equal_balls_hide_one_another_only_from_the_side():
    radius, count = 1e-3, 5
    row = np.array([[[2 * radius * k, 0, radius]] for k in range(count)])
    assert not compute_hidden_shares(look(), row, np.full(count, radius)).any()
    along = np.deg2rad(80)
    shares = compute_hidden_shares(look(tilt=(0.0, along)), row, np.full(count, radius))[:, 0]
    nearer = overlap(radius, radius, 2 * radius * np.cos(along))
    assert sorted(shares) == pytest.approx([0, *[nearer] * (count - 1)], abs=0.01)


def test_what_two_balls_cover_counts_once():
    centres = np.array([[[0, 0, 1e-3]], [[0, 0, 4e-3]], [[0, 0, 9e-3]]])
    assert compute_hidden_shares(look(), centres, np.array([2e-3, 1e-3, 1e-3]))[0, 0] == pytest.approx(0.25, abs=0.01)
    alone = compute_hidden_shares(look(), centres, np.array([2e-3, np.nan, 1e-3]))
    assert np.isnan(alone[1, 0])
    assert alone[0, 0] == pytest.approx(0.25, abs=0.01)


def test_few_balls_are_compared_in_all_frames_at_once_with_the_same_result():
    """Six balls that cross one another, one of them of unknown size; a crowd is searched frame by frame."""
    centres = np.random.default_rng(4).uniform(0, 8e-3, (6, 40, 3))
    radii = np.array([1e-3, 1e-3, 5e-4, 2e-3, np.nan, 1e-3])
    one, other = (compute_hidden_shares(look(), centres, radii, max_paired=most) for most in (6, 5))
    np.testing.assert_array_equal(one, other)
    assert 10 < np.count_nonzero((other > 0).any(axis=0)) < 40


def test_a_ball_hides_nothing_in_frames_in_which_it_is_nowhere():
    """The second ball hides a quarter of the first, and is nowhere in frame 1; the third, far off, is so in frame 2."""
    centres = np.array([[[0, 0, 1e-3]] * 3, [[0, 0, 4e-3]] * 3, [[9e-3, 0, 1e-3]] * 3])
    centres[1, 1], centres[2, 2] = np.nan, [np.nan, 0, np.nan]
    shares = compute_hidden_shares(look(), centres, np.array([2e-3, 1e-3, 1e-3]))
    assert shares[0] == pytest.approx([0.25, 0, 0.25], abs=0.01)
    assert np.isnan(shares).tolist() == [[False] * 3, [False, True, False], [False, False, True]]


def test_the_truth_of_a_clip_has_the_shares():
    balls = [{"position": [0.0, 0.0], "height": 0.01}, {"position": [0.0, 0.0002]}, {"position": [0.02, 0.0]}]
    clip = Scene.build("over", launches=balls, timing={"frames": 2}).draw(seed=1)
    hidden = clip.tracks[clip.tracks.frame == 0].set_index("particle")["hidden"]
    assert hidden[0] == hidden[2] == 0
    assert hidden[1] > 0.8
