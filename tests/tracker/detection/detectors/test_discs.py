"""Matte discs on textured plates: found in every frame, at rest too, with true errors, near the bound."""

import numpy as np
import pytest
from tracker_discs import CAMERA, SIZE, R, collision, disc, film, lit_film, plate, recorded
from tracker_film import CAMERA as GLINT_CAMERA

import tracker
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import make_recording
from tracker.detection.background.still_background import estimate_still_background
from tracker.detection.choose import SelectedDetector
from tracker.detection.detect import detect, make_view
from tracker.detection.detectors.discs import Discs
from tracker.detection.glints import PositionFlag
from tracker.detection.outlines.disc_fit import DiscAppearance, DiscScene, fit_disc


def bound(ball, ground, noise):
    """Cramer-Rao of one coordinate of a disc of known look, px: by differences of its picture."""
    step, at = 1e-1, np.array([90.3, 80.6])
    pictures = [(ball - ground) * disc(at + np.array([side * step, 0])) for side in (1, -1)]
    slope = (pictures[0] - pictures[1]) / (2 * step)
    return np.sqrt((noise**2 + 1 / 12) / (slope**2).sum())


@pytest.mark.parametrize(("ball", "level"), [(210.0, 70.0), (25.0, 150.0)])
def test_both_balls_in_every_frame_near_the_bound(ball, level):
    """Bright on dark and dark on bright; at rest for half the film, where the plate is seen only later."""
    rng, ways = np.random.default_rng(3), collision()
    ground = plate(rng, level)
    pictures = film(rng, ways, ball, ground=ground)
    clip = recorded(pictures, Camera.from_dict(CAMERA))
    found = detect(clip, make_view(clip, "discs"), "discs").glints
    places = ways[:, found.frame]
    ball_of = np.hypot(*np.moveaxis(places - found.xy, -1, 0)).argmin(axis=0)
    miss = found.xy - places[ball_of, np.arange(len(found))]
    assert np.bincount(ball_of).tolist() == [ways.shape[1]] * 2  # and the lamp's glare is none
    assert np.sqrt((miss**2).mean()) < 2 * bound(ball, ground, 2.0)
    seen_well = (ball_of == 0) & (found.frame >= 35)  # moving, over a plate that is seen before and after
    z = (miss / np.sqrt(np.diagonal(found.cov, axis1=1, axis2=2)))[seen_well]
    assert z.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * z.size))


def oval(place, axes, size=SIZE, fine=8):
    """Coverage (h, w) of an ellipse with half axes along x and y, by fine x fine samples a pixel."""
    x, y = ((np.arange(n * fine) + 0.5) / fine - 0.5 for n in size[::-1])
    inside = ((x - place[0]) / axes[0]) ** 2 + ((y[:, None] - place[1]) / axes[1]) ** 2 < 1
    return inside.reshape(size[0], fine, size[1], fine).mean(axis=(1, 3))


@pytest.mark.parametrize("ball", [25.0, 230.0])
def test_a_ball_that_looks_oblong_in_a_part_of_the_picture_is_found_there(ball):
    """The picture stretches towards its left edge, as under a lens or in an oblique view: 1.3 times as long as high."""
    rng, radius = np.random.default_rng(6), 11.0
    ground, places = plate(rng, 120.0), np.linspace([170.0, 100.0], [24.0, 90.0], 50)
    ratio = 1 + 0.3 * np.clip((110 - places[:, 0]) / 86, 0, 1)
    pictures = []
    for place, q in zip(places, ratio, strict=True):
        cover = oval(place, (radius * np.sqrt(q), radius / np.sqrt(q)))
        light = ground + (ball - ground) * cover + rng.normal(0, 2.0, SIZE)
        pictures.append(np.clip(np.rint(light), 0, 255).astype(np.uint8))
    clip = recorded(np.array(pictures), Camera.from_dict({**CAMERA, "ball_diameter": 2 * radius * 1e-3}))
    found = detect(clip, make_view(clip, "discs"), "discs").glints
    assert found.frame.tolist() == list(range(50))
    assert np.hypot(*(found.xy - places).T).max() < 0.5


@pytest.mark.parametrize("sunk", [0.0, 0.5])
def test_a_ball_that_rolls_along_the_rim_of_the_picture_is_found(sunk):
    """Its outline touches the rim in all frames, or the rim cuts half a pixel off it."""
    rng, ground, radius = np.random.default_rng(7), plate(np.random.default_rng(8)), 24.0
    places = np.linspace([30.0, SIZE[0] - 0.5 - radius + sunk], [170.0, SIZE[0] - 0.5 - radius + sunk], 50)
    pictures = film(rng, places[None], ground=ground, radius=radius)
    pictures[:25, 40:44, 60:100] = 200  # something else changes too
    clip = make_recording(0, wrap_frames(pictures), None)  # nothing says how large it is
    found = detect(clip, make_view(clip, "discs"), "discs").glints
    assert found.frame.tolist() == list(range(50))
    assert np.hypot(*(found.xy - places).T).max() < 0.2


def test_a_ball_under_a_line_has_one_position():
    """The lines of a plot are drawn over its discs, and divide them into two parts."""
    places = np.linspace([20.0, 90.0], [180.0, 92.0], 60)
    pictures = film(np.random.default_rng(9), places[None], 25.0, ground=plate(np.random.default_rng(8), 150.0, 5.0))
    pictures[:, 90:92], pictures[:, :, 100:102] = 160, 160
    clip = recorded(pictures, Camera.from_dict(CAMERA))
    found = detect(clip, make_view(clip, "discs"), "discs").glints
    assert np.bincount(found.frame).max() == 1
    assert len(found) > 55  # where both lines cross it, it is in four parts
    assert np.hypot(*(found.xy - places[found.frame]).T).max() < 0.5


def test_dim_discs_in_noise_are_all_found():
    """Contrast 25, noise 6; at rest too, where a pixel alone does not tell the ball from the plate."""
    ways = collision()
    clip = recorded(film(np.random.default_rng(1), ways, 95.0, 6.0), Camera.from_dict(CAMERA))
    found = detect(clip, make_view(clip, "discs"), "discs").glints
    away = np.hypot(*np.moveaxis(ways[:, found.frame] - found.xy, -1, 0))
    assert np.bincount(away.argmin(axis=0)).tolist() == [ways.shape[1]] * 2
    assert away.min(axis=0).max() < 0.5


def test_the_background_that_balls_leave_free_has_true_errors():
    """Over a strong texture; a ball rests for half the film."""
    rng, ways = np.random.default_rng(2), collision()
    ground = plate(rng, texture=150.0)
    clip = recorded(film(rng, ways, ground=ground), Camera.from_dict(CAMERA))
    found = Discs(make_view(clip, "discs")).scenes[0]
    z = (found.level - ground)[found.known] / found.error[found.known]
    assert found.known.mean() > 0.99
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("lossy", [False, True])
def test_a_note_says_that_errors_of_lossy_video_are_too_small(lossy):
    clip = recorded(film(np.random.default_rng(1), collision(12, 6)), Camera.from_dict(CAMERA))
    clip.frames.lossy = lossy
    notes = detect(clip, make_view(clip, "discs"), "discs").notes
    assert [note.startswith("lossy video: ") for note in notes].count(True) == lossy


def test_ground_alone_is_no_disc():
    """Clipped black, without noise: nothing differs from the ground, so the residuals are zero."""
    black = np.zeros((40, 40), np.uint8)
    ground = estimate_still_background([black] * 5, 0.0)
    look = DiscAppearance(radius=9.0, noise=0.0)
    assert fit_disc(DiscScene(black, ground, look, np.zeros(2)), np.array([20.0, 20.0])) is None


@pytest.mark.usefixtures("unfitted")
def test_the_diameter_is_found_from_the_film():
    pictures = film(np.random.default_rng(4), collision(40, 16))
    clip = recorded(pictures, Camera.unknown((SIZE[1], SIZE[0]), 8))
    discs = Discs(make_view(clip, "discs"))
    assert discs.radius == pytest.approx(R, rel=0.03)
    _, tally = discs.examine(0, pictures[0])
    discs(pictures[0])  # as from another thread
    assert discs.examine(0, pictures[0])[1] == tally
    tracks = tracker.track(pictures, detector="discs").tracks
    assert tracks.groupby("particle").size().tolist() == [40, 40]
    assert not tracks["flags"].str.contains("glint").any()


def test_what_never_moves_is_no_ball():
    rng = np.random.default_rng(5)
    ground = plate(rng)
    still = np.clip(np.rint(ground + rng.normal(0, 2.0, (20, *SIZE))), 0, 255).astype(np.uint8)
    assert len(tracker.track(still, CAMERA, detector="discs").tracks) == 0


def test_the_background_under_a_ball_that_rests_for_most_of_the_film():
    """A pixel's median is then the ball; the level nearer to what lies around is the plate."""
    rng, ways = np.random.default_rng(6), collision(contact=45)
    ground = plate(rng)
    pictures = film(rng, ways, ground=ground)
    found = estimate_still_background(wrap_frames(pictures), 2.0)
    level, known = found.level, found.known
    assert np.abs(level - ground)[known].max() < 30
    assert np.sqrt(np.mean((level - ground)[known] ** 2)) < 1.0
    assert np.mean(~known) < 0.02


def test_balls_lit_from_one_side_that_cast_shadows():
    """Every ball is found at its own place, not at that of its bright side, and no shadow is taken for one."""
    ways = collision(20, 8)
    clip = recorded(lit_film(np.random.default_rng(7), ways), Camera.from_dict(CAMERA))
    discs = Discs(make_view(clip, "discs"))
    detections = discs.detect(enumerate(clip.frames))
    found = detections.glints
    places = ways[:, found.frame]
    ball_of = np.hypot(*np.moveaxis(places - found.xy, -1, 0)).argmin(axis=0)
    miss = found.xy - places[ball_of, np.arange(len(found))]
    assert np.bincount(ball_of).tolist() == [ways.shape[1]] * 2
    assert np.abs(miss).max() < 0.025 * R
    assert any("for their shadows" in note and "1 % of the radius" in note for note in detections.notes)


def test_balls_lit_from_one_side_on_a_plate_too_dark_for_shadows():
    """Their bright sides alone tell the lamp: found at their own places, with errors that know of it."""
    ways = collision(20, 8)
    ground = plate(np.random.default_rng(9), 14.0, 1.0) - plate(np.random.default_rng(9), 0.0, 0.0)
    clip = recorded(lit_film(np.random.default_rng(7), ways, (0.35, -0.2), ground=ground), Camera.from_dict(CAMERA))
    found = Discs(make_view(clip, "discs")).detect(enumerate(clip.frames)).glints
    places = ways[:, found.frame]
    ball_of = np.hypot(*np.moveaxis(places - found.xy, -1, 0)).argmin(axis=0)
    miss = found.xy - places[ball_of, np.arange(len(found))]
    assert np.bincount(ball_of).tolist() == [ways.shape[1]] * 2
    assert (found.flags & PositionFlag.SHADED).all()
    assert np.abs(miss.mean(axis=0)).max() < 0.02 * R


@pytest.mark.usefixtures("unfitted")
def test_what_one_detector_misses_is_left_to_the_other(monkeypatch):
    """The film is of discs; told that it is of glints, the tracker tries both and says so."""
    monkeypatch.setattr("tracker.recording.select_detector", lambda *_: SelectedDetector("maximum_likelihood"))
    pictures = film(np.random.default_rng(8), collision(40, 16), 25.0, 0.3, np.full(SIZE, 150.0))
    known = {key: GLINT_CAMERA[key] for key in ("psf", "sensor")}  # else they are estimated first, which takes seconds
    result = tracker.track(pictures, CAMERA | known)
    assert result.tracks.groupby("particle").size().tolist() == [40, 40]
    assert any(
        note.startswith("detector: discs, because maximum_likelihood finds nothing (")
        for note in map(str, result.notes)
    )


@pytest.mark.parametrize("lit", [pytest.param(False, marks=pytest.mark.gate), True])
def test_the_coarse_search_finds_what_the_search_of_whole_frames_finds(monkeypatch, lit):
    """Plain discs, and lit spheres with shadows, which touch as they collide."""
    rng, ways = np.random.default_rng(3), collision(14, 6)
    clip = recorded(lit_film(rng, ways) if lit else film(rng, ways), Camera.from_dict(CAMERA))

    def locate():
        return detect(clip, make_view(clip, "discs"), "discs").glints

    coarse = locate()
    monkeypatch.setattr("tracker.detection.background.windows.TILE_PX", 240)  # one tile is the whole frame
    whole = locate()
    assert len(coarse) == len(whole) > 24
    std = np.sqrt(np.diagonal(whole.cov, axis1=1, axis2=2))
    assert (np.abs(coarse.xy - whole.xy) / std).max() < 1e-3


def test_a_ball_that_is_a_streak_in_every_frame():
    """A film without a frame in which a ball looks round: its radius comes from the short axes of the streaks."""
    way = np.linspace([15.0, 60.0], [185.0, 90.0], 15)[None]  # 12 px a frame
    pictures = film(np.random.default_rng(4), way, shutter=1.0)
    tracks = tracker.track(pictures, detector="discs").tracks
    assert np.hypot(*(tracks[["x", "y"]].to_numpy() - way[0, tracks.frame]).T).max() < 0.5
    assert len(tracks) > 10
    assert np.sqrt(tracks.flux / np.pi).to_numpy() == pytest.approx(R, rel=0.1)
