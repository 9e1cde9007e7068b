"""Settings of the tracker: strict files, one line for a mistake, and what they change."""

import sys

import numpy as np
import pytest
from tracker_film import CAMERA, collision, film

import tracker
from tracker import cli
from tracker.settings import TrackerSettings


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lnk: {}", "lnk: unknown key; did you mean link?"),
        ("link: {max_gap: 3}", "link.max_gap: unknown key; did you mean link.max_gap_frames?"),
        ("link: {max_gap_frames: 1.5}", "link.max_gap_frames: expected a whole number, found 1.5"),
        ("link: {max_gap_frames: '3'}", "link.max_gap_frames: expected a whole number, found '3'"),
        ("detection: {candidate_sigma: -1}", "detection.candidate_sigma: expected a number above 0, found -1"),
        ("detection: {glint_sigma: .nan}", "detection.glint_sigma: expected a finite number, found nan"),
        ("link: 3", "link: "),
    ],
)
def test_a_mistake_in_a_settings_file_is_one_line(tmp_path, monkeypatch, capsys, text, message):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    with pytest.raises(tracker.InputError) as error:
        TrackerSettings.of(path)
    assert str(error.value).startswith(f"{path}: {message}")
    words = ["tracker", "track", str(tmp_path), "-o", str(tmp_path / "out"), "--settings", str(path)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_threshold_of_a_glint_reaches_the_detector():
    """No glint has a flux of a million standard errors."""
    pictures = film(np.random.default_rng(1), collision(20))
    strict = tracker.track(pictures, CAMERA, settings={"detection": {"glint_sigma": 1e6}})
    plain = tracker.track(pictures, CAMERA, settings=TrackerSettings())
    assert len(strict.tracks) == 0
    assert len(plain.tracks) > 20
