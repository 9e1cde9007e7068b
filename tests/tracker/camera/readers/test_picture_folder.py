"""A folder of pictures as a film: each picture is decoded once, as long as a few of them fit into memory."""

import cv2
import numpy as np
import pytest

from tracker.camera.readers import picture_folder
from tracker.camera.readers.picture_folder import read_picture_folder


@pytest.mark.parametrize(("kept", "decoded"), [(4, 4), (0, 8), (2, 8)])
def test_a_picture_is_decoded_once_if_memory_allows(tmp_path, monkeypatch, kept, decoded):
    """The planes of a film's colours are tried one after the other, each over the same frames."""
    pictures, count = np.random.default_rng(1).integers(0, 256, (4, 6, 8, 3)).astype(np.uint8), []

    def decode(*given, original=cv2.imdecode):
        count.append(given)
        return original(*given)

    for k, picture in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"{k}.png"), picture[..., ::-1])
    monkeypatch.setattr(picture_folder, "KEPT_BYTES", kept * pictures[0].nbytes)
    frames = read_picture_folder(tmp_path)
    monkeypatch.setattr(cv2, "imdecode", decode)
    for _ in range(2):
        for k, picture in enumerate(pictures):
            assert frames.colours(k).tolist() == picture.tolist()
    assert len(count) == decoded
    frames.colours(0)[:] = 0  # as a detector may do; the others get the picture as it is
    assert frames.colours(0).tolist() == pictures[0].tolist()
