"""The example films: made once, of scenes of the package, or an error of one line."""

import subprocess

import pytest
from repository import ROOT

from synthcam_shared.errors import InputError
from tracker.app.scene_previews import SCENES, make_examples


def test_they_are_made_once(tmp_path, monkeypatch):
    def generate(words, **kwargs):
        started.append(words)
        (tmp_path / "synthcam/examples").mkdir(parents=True, exist_ok=True)
        return subprocess.CompletedProcess(words, failing, "", "synthcam: progress\nsynthcam: no space left\n")

    started, failing = [], 2
    monkeypatch.setenv("XDG_CACHE_HOME", f"{tmp_path}")
    monkeypatch.setattr(subprocess, "run", generate)
    with pytest.raises(InputError, match=r"could not be made \(synthcam: no space left\)"):
        make_examples()
    (tmp_path / "synthcam/examples").rmdir()
    (tmp_path / "synthcam").rmdir()
    failing = 0
    assert make_examples() == make_examples() == tmp_path / "synthcam/examples"
    assert len(started) == 2
    assert all((ROOT / f"src/synthcam/scenes/{name}.yaml").is_file() for name in SCENES)
