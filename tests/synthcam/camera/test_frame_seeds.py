"""Seeds of frames against numpy's own."""

import numpy as np
import pytest

from synthcam.camera.frame_seeds import FRAMES_AT_ONCE, make_frame_seed


@pytest.mark.parametrize("root_seed", [0, 7, 1 << 32, (1 << 64) + 5, (3 << 128) + (1 << 90) + 1])
@pytest.mark.parametrize("key", [(0, 1), (999_999, 1), (1 << 40, 1)])
def test_sfc64_starts_where_numpy_starts_it(root_seed, key):
    for frame in (0, 1, FRAMES_AT_ONCE - 1, FRAMES_AT_ONCE, 100_003, (1 << 32) - 1):
        own = np.random.SFC64(make_frame_seed(root_seed, key, frame))
        numpys = np.random.SFC64(np.random.SeedSequence(root_seed, spawn_key=(*key, frame)))
        np.testing.assert_array_equal(own.random_raw(5), numpys.random_raw(5))


def test_another_generator_asks_for_other_words():
    with pytest.raises(ValueError, match="SFC64 asks for, not 4"):
        np.random.PCG64(make_frame_seed(0, (0, 1), 0))
