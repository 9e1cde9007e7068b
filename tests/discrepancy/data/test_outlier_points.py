"""Single wrong places are taken out before anything is read from the tracks; noise, jumps and contacts are not."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import FRAMES, STD, collisions, exact, noisy, only

from discrepancy.data.launch import T_C
from discrepancy.data.outlier_points import _Offsets, _Paths, find_outliers, note_removed_points, remove_outliers
from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting.base_fit import CLAIMED_NOISE, fit_base_model
from discrepancy.fitting.parameters import find_parameter
from discrepancy.fitting.predict import predict_tracks
from discrepancy.policy import SearchPolicy
from discrepancy.preparation import prepare_data
from discrepancy.search import search
from synthcam.library import library
from synthcam.model import Model

CLIPS = collisions(Model(), 8, 3)


def moved(clip, rows, by):
    xy = clip.xy.copy()
    xy[rows] += by
    return dataclasses.replace(clip, xy=xy)


@pytest.mark.parametrize("by", [[20, 0], [0, -20], [1e3, 1e3]])
def test_a_place_far_off_its_path_is_an_outlier(by):
    for clip in CLIPS:
        rows = [row_of(clip, 0, 6), row_of(clip, 1, 69), row_of(clip, 1, 71)]
        assert find_outliers(moved(clip, rows, STD * np.array(by))) == set(rows)


def row_of(clip, ball, frame):
    return int(np.flatnonzero((clip.ball == ball) & (clip.frame == frame))[0])


def found_beside_a_model(clips):
    """Find outliers about the base model, which was fitted to the clips with their outliers: rows."""
    base = fit_base_model(clips, Model(), CLAIMED_NOISE)
    return [find_outliers(c, x) for c, x in zip(clips, predict_tracks(base.model, base.launches, clips), strict=True)]


@pytest.mark.parametrize(("sigma", "wrong"), [(6.0, False), (11.0, True)])
def test_a_place_is_an_outlier_beyond_eight_sigma(sigma, wrong):
    """The noise is that of a position and of the parabola through eight others, whose value there has 708/2064."""
    for clip, true in zip(CLIPS, exact(Model(), 8, 3), strict=True):
        row = row_of(clip, 1, 70)
        xy = clip.xy.copy()
        xy[row] = true.xy[row] + [sigma * np.sqrt(1 + 708 / 2064) * STD, 0]
        assert find_outliers(dataclasses.replace(clip, xy=xy)) == ({row} if wrong else set())


@pytest.mark.parametrize(("last", "wrong"), [(70, False), (71, True)])
def test_a_place_is_tested_beside_five_others_or_more(last, wrong):
    """Two on either side leave one degree of freedom, which chance makes smooth."""
    clip, row = CLIPS[0], row_of(CLIPS[0], 1, 68)
    some = (clip.ball == 0) | ((clip.frame >= 66) & (clip.frame <= last))
    few = moved(clip, [row], 40 * STD).select(np.flatnonzero(some))
    assert find_outliers(few) == ({row_of(few, 1, 68)} if wrong else set())


def test_an_extrapolation_is_the_parabola_through_the_next_five():
    """Of numpy, with its error at the position beside them, and the rms about it."""
    row, others = row_of(CLIPS[0], 1, 60), [row_of(CLIPS[0], 1, f) for f in range(61, 66)]
    design, xy = np.vander(np.arange(1.0, 6.0), 3), CLIPS[0].xy[others]
    fitted = np.polyfit(np.arange(1.0, 6.0), xy, 2)
    rms = np.sqrt(((xy - design @ fitted) ** 2).sum() / (2 * (5 - 3))) / STD
    std = STD * np.sqrt(np.linalg.inv(design.T @ design)[2, 2])
    found = _Paths.of(CLIPS[0], None)._extrapolate(1).values[row]
    assert found == pytest.approx([*fitted[2], *fitted[1], std, rms])


def test_a_contact_needs_smooth_paths_on_both_sides():
    """One of them tells nothing of a position in the exposure of the contact; elsewhere it is enough."""
    paths = _Paths.of(CLIPS[0], exact(Model(), 8, 3)[0].xy)
    rests = np.array([paths._extrapolate(direction).rest for direction in (-1, 1)])
    hit, free = np.flatnonzero(paths.phase < 0)[0], row_of(CLIPS[0], 0, 70)
    for row in (hit, free):
        known = [np.isfinite(paths.outer(smooth).off[row]).all() for smooth in (rests[:, row].mean(), np.inf)]
        assert known == [row == free, True]


def test_the_worst_goes_first_because_others_are_measured_from_it():
    """Beside the three that are wrong, frame 1 is far off the path through the rest of them."""
    rows = [row_of(CLIPS[4], 1, frame) for frame in (0, 3, 4)]
    clip = moved(CLIPS[4], rows, STD * np.array([[9, 0], [-40, 0], [-40, 0]]))
    assert find_outliers(clip, exact(Model(), 8, 3)[4].xy) == set(rows)


@pytest.mark.parametrize(("rough", "wrong"), [(1.4, True), (2.8, False)])
def test_places_that_are_twice_as_rough_as_noise_tell_of_no_outlier(rough, wrong):
    offsets = _Offsets(np.array([[0.0, -30.0]]), np.array([1.5 * rough]))
    assert (offsets.outlier_sizes(1.5, SearchPolicy()) == [30.0 * wrong]).all()


@pytest.mark.parametrize(("off", "wrong"), [(7.0, True), (14.0, False)])
def test_a_model_that_is_ten_errors_off_tells_of_no_outlier(off, wrong):
    clip, row = CLIPS[0], row_of(CLIPS[0], 1, 70)
    expected = exact(Model(), 8, 3)[0].xy + off * STD
    assert find_outliers(moved(clip, [row], 40 * STD), expected) == ({row} if wrong else set())


@pytest.mark.parametrize(("clips", "gone"), [(2, 2), (3, 0)])
def test_what_three_clips_have_in_one_frame_is_kept(clips, gone):
    wrong = [moved(c, [row_of(c, 1, 70)], 40 * STD) if k < clips else c for k, c in enumerate(CLIPS)]
    kept = remove_outliers(wrong, [c.xy for c in exact(Model(), 8, 3)])
    assert sum(len(c.frame) for c in wrong) - sum(len(c.frame) for c in kept) == gone


@pytest.mark.parametrize("at", ["contact", "slide end", "first", "last"])
def test_beside_a_model_it_is_found_at_every_event_and_at_both_ends(at):
    wrong, rows = [], []
    for k, clip in enumerate(collisions(Model(), 24, 3)):  # at each of six shifts, each ball moved along x and along y
        ball, shift = k % 2, k // 4 - 2
        frame = {"contact": clip.launch[T_C], "slide end": clip.slide_ends[ball]}.get(at, 0.0) * clip.fps + shift
        frame = {"first": shift + 2, "last": FRAMES - 3 + shift}.get(at, int(frame))
        rows.append({row_of(clip, ball, min(max(frame, 0), FRAMES - 1))})
        wrong.append(moved(clip, list(rows[-1]), STD * np.array([[300, 0], [0, -300]][k // 2 % 2])))
    assert found_beside_a_model(wrong) == rows


def test_so_are_neighbours():
    where = [(5, 6), (60, 62), (0, 1, 2), ()]
    rows = [[row_of(clip, 0, f) for f in where[k % 4]] for k, clip in enumerate(CLIPS)]
    wrong = [moved(moved(c, r, 300 * STD), r[:1], 100 * STD) for c, r in zip(CLIPS, rows, strict=True)]
    assert found_beside_a_model(wrong) == [set(r) for r in rows]


@pytest.mark.parametrize("effect", ["hop.share", "velocity_restitution.e", "exposure_blur.longer", "camera_tilt.x"])
@pytest.mark.parametrize(
    "longer", [pytest.param(1, marks=pytest.mark.gate), pytest.param(4, marks=pytest.mark.gate), 8]
)
def test_what_a_model_lacks_makes_none(effect, longer):
    """At its realistic size, and where the exposures take up to the whole time from frame to frame."""
    truth = Model().replace({effect: find_parameter(Model(), effect).typical})
    camera = dataclasses.replace(CLIPS[0].camera, exposure=longer * CLIPS[0].camera.exposure)
    clips = [dataclasses.replace(c, camera=camera) for c in exact(truth, 6, 3)]
    places = predict_tracks(truth, np.array([c.launch for c in clips]), clips)
    clips = noisy([dataclasses.replace(c, xy=xy) for c, xy in zip(clips, places, strict=True)], 3)
    assert not any(found_beside_a_model(clips))


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_noise_has_none(rho):
    assert not any(find_outliers(clip) for clip in collisions(Model(), 12, 4, rho))


def test_errors_that_are_claimed_to_vary_make_none():
    rng = np.random.default_rng(2)
    for clip in CLIPS:
        claimed = clip.covariance * rng.uniform(0.9, 1.1, (len(clip.frame), 1, 1))
        assert not find_outliers(dataclasses.replace(clip, covariance=claimed))


def test_a_jump_is_none():
    """As where a frame is lost: all that follows stands elsewhere."""
    for clip in CLIPS:
        late = np.flatnonzero((clip.ball == 1) & (clip.frame >= 70))
        assert find_outliers(moved(clip, late, 50 * STD)) == set()


def test_what_is_left_is_the_clip_without_them_and_it_is_said():
    row = row_of(CLIPS[2], 1, 70)
    given = [*CLIPS[:2], moved(CLIPS[2], [row], 30 * STD)]
    kept = remove_outliers(given)
    assert kept[:2] == CLIPS[:2]
    assert np.array_equal(kept[2].xy, np.delete(CLIPS[2].xy, row, axis=0))
    assert np.array_equal(kept[2].covariance, np.delete(CLIPS[2].covariance, row, axis=0))
    (said,) = note_removed_points(given, kept)
    assert str(said) == "clip 2: 1 of 160 positions, in frame 70, far off the path through their neighbours"


def test_one_note_lists_what_all_stretches_of_a_clip_lose():
    stretches = cut_stretches(CLIPS[:1])
    kept = [s.select(np.arange(len(s.frame)) >= few) for s, few in zip(stretches, (2, 0, 5), strict=True)]
    (said,) = note_removed_points(stretches, kept)
    total = sum(len(s.frame) for s in stretches)
    first, last = (s.frame[:few].tolist() for s, few in zip(stretches[::2], (2, 5), strict=True))
    frames = ", ".join(map(str, [*first, *last[:3]]))
    assert first[-1] < last[0]
    assert str(said).startswith(f"clip 0: 7 of {total} positions, in frame {frames} and 2 more, far off the path")


@pytest.mark.parametrize("frame", [1.0, pytest.param(40.0, marks=pytest.mark.gate), 78.0, 79.0])
def test_a_lost_frame_is_none_however_near_the_end(frame):
    lost = Model().replace({"dropped_frame.lost": 1.0, "dropped_frame.frame": frame})
    assert prepare_data(collisions(lost, 8, 3), Model()).left_out == ()


def test_a_lost_frame_at_the_end_is_named(monkeypatch):
    """Both balls have one position after it, in every clip."""
    only(monkeypatch, ("lag_speed",), dropped_frame=library()["dropped_frame"])
    lost = Model().replace({"dropped_frame.lost": 1.0, "dropped_frame.frame": FRAMES - 1.0})
    found = search(collisions(lost, 8, 3), Model())
    assert [n.effect for n in found.named] == ["dropped_frame"]
    assert found.model.value("dropped_frame.lost") == pytest.approx(1, abs=0.01)
    assert found.data.left_out == ()


def test_three_wrong_places_make_no_discovery(monkeypatch):
    only(monkeypatch)
    wrong = [moved(c, [x], 300 * STD) for c, x in zip(CLIPS, (40, row_of(CLIPS[1], 1, 0), 62), strict=False)]
    found = search([*wrong, *CLIPS[3:]], Model())
    assert found.verdict == "none"
    assert found.data.noise.scale == pytest.approx(1, abs=0.1)
    lines = sorted(str(note).partition(",")[0] for note in found.data.left_out)
    assert lines == [f"clip {k}: 1 of 160 positions" for k in range(3)]
