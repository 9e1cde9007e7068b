"""Motion blur of another length than the camera file's exposure makes it: seen, reported, and glints placed by them."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from tracker_film import CAMERA, collision, disc, expose, film, spot, write_clip
from typer.testing import CliRunner

from tracker import cli
from tracker.camera.camera import Camera
from tracker.camera.recordings import Frames, Recording
from tracker.detection.detect import detect, detect_until_blur_converges, make_view
from tracker.detection.glints import PositionFlag
from tracker.detection.motion_blur import MotionBlurEvidence

CAM = Camera.from_dict({k: v for k, v in CAMERA.items() if k != "lamp"})  # no lamp: the profile is centred on the glint
SHARE = CAMERA["exposure"] * CAMERA["fps"]
PATHS = collision(frames=40, contact=14.4, speed=7.0, angle=0.5)


def clip(frames):
    return Recording(0, CAM, Frames(len(frames), frames.shape[1:], frames.dtype, lambda k: frames[k]))


def misses(glints):
    """Errors over those claimed, by the truth of PATHS: (n, 2), those in the frames about the contact left out."""
    clear = (glints.frame < 13) | (glints.frame > 16)
    true = PATHS[glints.frame]
    off = glints.xy[:, None] - true
    nearest = np.argmin((off**2).sum(axis=2), axis=1)
    off = off[np.arange(len(off)), nearest]
    clear &= np.hypot(*off.T) < 1.0
    assert clear.sum() > 50
    return (np.linalg.inv(np.linalg.cholesky(glints.cov)) @ off[..., None])[clear, :, 0]


@pytest.mark.parametrize(("longer", "within"), [(1.5, 0.1), (2.5, 0.04)])  # four of its own deviations
def test_a_wrong_exposure_is_seen_and_the_motion_blur_fits(longer, within):
    shown = clip(film(np.random.default_rng(2), PATHS, exposure_share=SHARE * longer))
    found, view = detect_until_blur_converges(shown, make_view(shown))
    glints = found.glints
    assert view.camera.exposure_from_blur == pytest.approx(longer * CAM.exposure, rel=within)
    assert view.camera.exposure == CAM.exposure
    assert np.mean(misses(glints) ** 2) < 1.25
    assert np.mean(glints.flags & PositionFlag.MISFIT > 0) < 0.03


@pytest.mark.parametrize("seed", range(3))
def test_a_right_exposure_changes_nothing(seed):
    shown = clip(film(np.random.default_rng(seed), PATHS, exposure_share=SHARE))
    view = make_view(shown)
    found, same = detect_until_blur_converges(shown, view)
    glints = found.glints
    assert same is view
    plain = detect(shown, view).glints
    assert all(np.array_equal(getattr(glints, n), getattr(plain, n)) for n in ("frame", "x", "y", "cov", "flux"))


def test_a_glint_that_is_long_at_rest_is_no_long_exposure():
    rng, frames = np.random.default_rng(4), []
    steps = np.gradient(PATHS, axis=0) * SHARE
    for positions, ways in zip(PATHS, steps, strict=True):
        picture = np.full((160, 200), 0.5)
        for (x, y), way in zip(positions, ways, strict=True):
            if 0 < x < 200 and 0 < y < 160:
                picture += 1400 * spot(picture.shape, x, y, 1.0, way, steps=8) + 4 * disc(picture.shape, x, y, 7.44)
        frames.append(expose(rng, gaussian_filter1d(picture, 0.6, axis=1)))  # balls come and go along x, nearly
    shown = clip(np.array(frames))
    view = make_view(shown)
    assert detect_until_blur_converges(shown, view)[1] is view


@pytest.mark.parametrize("tried", [("1",), pytest.param(("1", "2"), marks=pytest.mark.gate)])
def test_the_exposure_seen_is_in_the_results_whatever_the_workers(tmp_path, tried):
    for number, share in enumerate((SHARE, 2.5 * SHARE)):
        frames = film(np.random.default_rng(number), PATHS, exposure_share=share)
        write_clip(tmp_path / f"film/clips/{number:06d}", frames)
    for workers in tried:
        command = ["track", str(tmp_path / "film"), "-o", str(tmp_path / workers), "--workers", workers, "--no-pages"]
        done = CliRunner().invoke(cli.app, command)
        assert done.exit_code == 0, done.output
        assert done.stderr.count("motion blur is longer") == 1
        assert "(1 of 2 clips)" in done.stderr
    first, *others = (
        {p.relative_to(tmp_path / w): p.read_bytes() for p in (tmp_path / w).rglob("*") if p.is_file()} for w in tried
    )
    assert all(other == first for other in others)
    seen = json.loads((tmp_path / "1/run.json").read_text())["exposure_seen_s"]
    assert seen == {"1": pytest.approx(2.5 * CAMERA["exposure"], rel=0.06)}
    camera = json.loads((tmp_path / "1/clips/000001/camera.json").read_text())
    assert (camera["exposure"], camera["exposure_seen_s"]) == (CAMERA["exposure"], seen["1"])
    assert "exposure_seen_s" not in json.loads((tmp_path / "1/clips/000000/camera.json").read_text())
    again = CliRunner().invoke(cli.app, command)
    assert again.exit_code == 0
    assert "complete before" in again.output


def test_a_few_misfits_neither_decide_nor_hide():
    told = np.full(48, 100.0)
    noise = 10.0 * np.random.default_rng(0).standard_normal(48)
    for all_longer, sure in ((0.0, False), (40.0, True)):
        blurs, score = MotionBlurEvidence(), noise + all_longer
        score[:2] = 5000.0
        blurs.add(score, told)
        assert (blurs.estimate_length()[2] > 5.0) == sure
    even = MotionBlurEvidence()
    even.add(0.2 * told, told)
    assert even.estimate_length() == (
        pytest.approx(1.4**0.5),
        pytest.approx(4800**-0.5),
        pytest.approx(0.2 * 4800**0.5),
    )
