"""Identities through collisions, gaps, arrivals and departures, on positions made here."""

from dataclasses import replace

import numpy as np
import pytest
from tracker_film import CAMERA, collision, film
from tracker_paths import box, driven, glints, scattered

import synthcam
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import Recording
from tracker.detection import link
from tracker.detection.detect import load_linker
from tracker.detection.following import assignment
from tracker.detection.glints import Glints, PositionFlag
from tracker.detection.link import assign_track_numbers, estimate_velocities, link_into_tracks
from tracker.recording import track_clip

CAM = Camera.from_dict({**CAMERA, "size": [640, 480]})


def pure(ids, truth):
    """Test whether ids and truth have the same groups."""
    pairs = {(int(a), int(b)) for a, b in zip(ids, truth, strict=True)}
    return len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs}) and (ids >= 0).all()


def collisions(rng, count, speed=None):
    for _ in range(count):
        fast = rng.uniform(2.0, 20.0) if speed is None else speed
        yield collision(
            40,
            contact=rng.uniform(12, 20),
            speed=fast,
            angle=rng.uniform(0, 2 * np.pi),
            offset=rng.uniform(-0.95, 0.95),
            centre=(320.0, 240.0),
        )


@pytest.mark.gate
def test_no_swap_in_four_hundred_collisions():
    rng = np.random.default_rng(0)
    for paths in collisions(rng, 400):
        found, truth = scattered(rng, paths)
        assert pure(assign_track_numbers(found, CAM), truth)


def test_without_the_bounce_identities_are_swapped(monkeypatch):
    none = np.empty(0, np.int64)
    monkeypatch.setattr(assignment, "find_near_balls", lambda *args: (none, none))
    rng = np.random.default_rng(1)
    swapped = 0
    for paths in collisions(rng, 100, speed=20.0):
        found, truth = scattered(rng, paths)
        swapped += not pure(assign_track_numbers(found, CAM), truth)
    assert swapped > 10


def test_gaps_are_bridged_and_long_ones_are_not():
    rng = np.random.default_rng(2)
    paths = collision(60, contact=40.2, speed=6.0, centre=(320.0, 240.0))
    short = {(k, 1) for k in range(10, 14)} | {(k, 0) for k in range(20, 25)}
    found, truth = scattered(rng, paths, lost=short)
    assert pure(assign_track_numbers(found, CAM), truth)
    found, truth = scattered(rng, paths, lost={(k, 1) for k in range(10, 25)})
    assert len(np.unique(assign_track_numbers(found, CAM))) == 3


@pytest.mark.parametrize("lost", [(0,), pytest.param((1,), marks=pytest.mark.gate), (0, 1)])
def test_a_ball_not_seen_as_it_is_hit_goes_on(lost):
    """Either or both are missing in the first frame, or two, after the contact, where encoders smear them together."""
    rng = np.random.default_rng(8)
    for paths in collisions(rng, 20, speed=10.0):
        apart = np.hypot(*(paths[:, 0] - paths[:, 1]).T)
        hit = int(np.argmin(apart))
        for frames in ((hit,), (hit + 1,), (hit, hit + 1)):
            found, truth = scattered(rng, paths, lost={(k, ball) for k in frames for ball in lost})
            assert pure(assign_track_numbers(found, CAM), truth)


def test_balls_enter_and_leave():
    rng = np.random.default_rng(3)
    time = np.arange(50.0)
    paths = np.stack(
        [np.column_stack([-60 + 9 * time, 100 + 0 * time]), np.column_stack([600 - 3 * time, 250 + 5 * time])], 1
    )
    paths[(paths[..., 0] < 0) | (paths[..., 1] > 479)] = np.nan
    found, truth = scattered(rng, paths)
    ids = assign_track_numbers(found, CAM)
    assert pure(ids, truth)
    assert ids[0] == 0  # numbered by first appearance: the ball in view from the start comes first
    assert truth[0] == 1


def draw_early_hits(rng, count):
    """Paths (2, 2, 2) of two balls that hit one another before the second frame, and lose any share of their speed."""
    diameter = CAM.diameter_px
    while count:
        start, velocity = rng.uniform(-2, 2, 2) * diameter, rng.normal(0, 1, (2, 2)) * diameter
        relative, gap = velocity[1] - velocity[0], start @ start - diameter**2
        a, b = relative @ relative, start @ relative
        root = b * b - a * gap
        if gap < 0 or b > 0 or root < 0 or (when := (-b - np.sqrt(root)) / a) > 1:
            continue
        normal = (start + when * relative) / diameter
        kick = (1 + rng.uniform(0, 1)) / 2 * (relative @ normal) * normal
        after = velocity + np.array([kick, -kick])
        first = np.array([[0, 0], start])
        yield np.array([first, first + when * velocity + (1 - when) * after])
        count -= 1


def test_right_links_of_two_balls_that_hit_once_never_pass_through_one_another():
    """So the rule that exchanges new balls makes no error unless a third body takes part, and repairs most links."""
    from_one = np.array([paths[:, 1] - paths[:, 0] for paths in draw_early_hits(np.random.default_rng(4), 400)])
    start, end = from_one[:, 0] / CAM.diameter_px, from_one[:, 1] / CAM.diameter_px
    right, wrong = (assignment._find_least_distance(start, sign * end) for sign in (1, -1))
    assert right.min() > 1 - 1e-9
    assert ((wrong < 0.8) & (right >= 0.8)).mean() > 0.6


def test_three_balls_cross():
    rng = np.random.default_rng(4)
    two = collision(50, contact=20.3, speed=12.0, centre=(320.0, 240.0))
    third = np.column_stack([320 + 8 * (np.arange(50.0) - 10), 275 + 0 * np.arange(50.0)])
    paths = np.concatenate([two, third[:, None]], axis=1)
    found, truth = scattered(rng, paths)
    assert pure(assign_track_numbers(found, CAM), truth)


@pytest.mark.parametrize(("scene", "seed"), [("crowd", 1), ("tray", 1), ("crowd", 11)])
def test_a_crowd_keeps_its_identities(scene, seed):
    """Through contacts, walls, missed balls and spots that are none; in film 11 two balls hit in the first frame."""
    clip, rng = synthcam.Scene.read(scene).draw(seed=seed), np.random.default_rng(9)
    seen = clip.tracks[clip.tracks.visible & (rng.random(len(clip.tracks)) > 0.01)]
    xy = seen[["x_mean_px", "y_mean_px"]].to_numpy() + 0.05 * rng.standard_normal((len(seen), 2))
    spots = glints(rng.integers(5, clip.frames - 5, clip.frames), rng.uniform(60, 420, (clip.frames, 2)))
    ids = assign_track_numbers(
        Glints.join([glints(seen.frame.to_numpy(), xy), spots]), Camera.from_dict(clip.camera_json)
    )
    assert pure(ids[: len(seen)], seen.particle.to_numpy())


IN_PIXELS = Camera.from_dict({key: value for key, value in CAMERA.items() if key != "scale"} | {"size": [720, 720]})


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_balls_that_nearly_fill_a_tray_keep_their_identities(seed):
    """64 balls that cover 75 % of a tray hit a neighbour in each frame, so no frame confirms the step before it."""
    x, y = 0.01069, 0.00888  # m, half of the sides
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    walls = [{"start": a, "end": b} for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    inside = [2 * x - 2.383e-3, 2 * y - 2.383e-3]
    group = {"count": 64, "arrangement": "lattice", "size": inside, "gap": 1e-6, "rms_speed": 0.15}
    camera = {"size": [244, 208], "scale": 1e-4}
    clip = synthcam.Scene.build("full tray", groups=[group], walls=walls, camera=camera, timing={"frames": 8}).draw(
        seed=seed
    )
    true = clip.tracks
    xy = true[["x_mean_px", "y_mean_px"]].to_numpy()
    ids = assign_track_numbers(glints(true.frame.to_numpy(), xy), Camera.from_dict(clip.camera_json))
    assert pure(ids, true.particle.to_numpy())


@pytest.mark.parametrize("seed", [1, 2])
def test_pushes_between_hits_exchange_no_identities(seed):
    """Magnetic or shaken bodies change their velocity in every frame; some of them are lost for a few frames."""
    rng = np.random.default_rng(seed)
    paths = driven(rng)
    lost = {(0, 7), (0, 20)}  # the first frame lacks two
    for body in rng.choice(paths.shape[1], 10, replace=False):
        begin = int(rng.integers(5, 30))
        lost |= {(k, int(body)) for k in range(begin, begin + int(rng.integers(1, 4)))}
    found, truth = scattered(rng, paths, lost=lost)
    assert pure(assign_track_numbers(found, IN_PIXELS, 44.0), truth)


def test_a_long_first_step_is_not_confirmed_by_another_ball_that_happens_to_lie_there():
    """A ball turns, another appears 110 px away, and where the jump between them would lead next, a third one rests."""
    paths = np.full((6, 3, 2), np.nan)
    paths[:, 0] = [(200, 200), (211, 206), (214, 217), (217, 228), (220, 239), (223, 250)]
    paths[1:, 1] = (300, 150)
    paths[:, 2] = (400, 98)
    found, truth = scattered(np.random.default_rng(0), paths)
    assert pure(assign_track_numbers(found, IN_PIXELS, 44.0), truth)


IN_BOX = Camera.from_dict({key: value for key, value in CAMERA.items() if key != "scale"} | {"size": [400, 400]})


def link_boxes(seeds, **settings):
    """Count the steps to another disc, those of which there is a doubt within 4 frames, discs lost, and doubts."""
    wrong = doubted = lost = doubts = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        found, truth = scattered(rng, box(rng, **settings), noise=0.3)
        links = link.link_detections(found, IN_BOX, 40.0)
        doubts += int(links.doubtful.sum())
        for number in range(links.ids.max() + 1):
            rows = np.flatnonzero(links.ids == number)  # by frame
            changed = found.frame[rows[1:]][np.diff(truth[rows]) != 0]
            when = found.frame[rows[links.doubtful[rows]]]
            wrong += len(changed)
            doubted += sum(bool((np.abs(when - k) <= 4).any()) for k in changed)
        lost += links.ids.max() + 1 - len(np.unique(truth))
    return wrong, doubted, lost, doubts


def test_discs_that_fall_and_bounce_keep_their_numbers_or_are_doubtful():
    """Discs of 40 px move by up to 30 px a frame, and bounce off walls where the picture cuts them off."""
    wrong, doubted, lost, doubts = link_boxes(range(3))
    assert lost <= 2
    assert wrong <= 6
    assert doubted == wrong < doubts < 60


def test_discs_without_gravity_are_never_in_doubt():
    assert link_boxes([1], gravity=0.0, speed=10.0, frames=60) == (0, 0, 0, 0)


@pytest.mark.gate
def test_most_exchanges_in_twenty_boxes_are_warned_of():
    wrong, doubted, lost, doubts = link_boxes(range(20, 40))
    assert lost < 10
    assert 0 < wrong < 50
    assert doubted >= 0.9 * wrong
    assert doubts < 250


def test_a_ball_that_bounces_while_it_is_not_seen_keeps_its_number():
    """It falls to the lower rim, which cuts it off for some frames, and comes back at the speed that it had."""
    time = np.arange(36.0)
    height = 380 - np.abs(320 - 18 * time)
    paths = np.stack([np.column_stack([100 + 3 * time, 100 + 0 * time]), np.column_stack([300 - 4 * time, height])], 1)
    paths[paths[..., 1] > 350] = np.nan
    found, truth = scattered(np.random.default_rng(3), paths)
    assert np.isnan(paths[:, 1, 0]).sum() >= 2
    assert pure(assign_track_numbers(found, IN_BOX, 40.0), truth)


def test_a_ball_at_rest_that_something_unseen_hits_keeps_its_number():
    """It is hit within a frame, so that its first step shows a third of its speed, of two diameters a frame."""
    x = np.where(np.arange(30) < 20, 100.0, 100 + 66 * (np.arange(30) - 19.67))
    paths = np.stack([np.column_stack([x, 0 * x + 200]), np.column_stack([0 * x + 60, 0 * x + 60])], axis=1)
    found, truth = scattered(np.random.default_rng(4), paths)
    assert pure(assign_track_numbers(found, replace(IN_BOX, size=(1920, 1080)), 36.0), truth)


@pytest.mark.parametrize("step", [3, 8])
def test_a_large_ball_with_uneven_steps_is_followed(step):
    """A film of 24 pictures a second at 60: a ball of 72 px rolls alone, and its times are off by half a frame."""
    frame = np.floor(np.arange(49) * 2.5).astype(int)
    x = 60 + step * np.arange(49)
    found = glints(frame, np.column_stack([x, np.full(49, 319.0)]), flux=4015.0)
    ids = assign_track_numbers(found, replace(IN_BOX, size=(612, 354)), 71.5)
    assert (ids == 0).all()


def test_blips_and_faint_companions_are_refused():
    rng = np.random.default_rng(5)
    paths = collision(40, contact=15.2, speed=6.0, centre=(320.0, 240.0))
    found, truth = scattered(rng, paths)
    companion = glints(np.arange(40), paths[:, 0] + [5.2, 0.0], flux=70.0)
    blips = glints(np.array([3, 3, 17, 30]), rng.uniform(0, 400, (4, 2)), flux=100.0)
    everything = Glints.join([found, companion, blips])
    ids = assign_track_numbers(everything, CAM)
    assert pure(ids[: len(found)], truth)
    assert (ids[len(found) :] == -1).all()


def test_a_ball_seen_in_two_frames_only_is_kept():
    found = Glints.join(
        [
            glints(np.arange(30), np.column_stack([np.full(30, 100.0), np.full(30, 90.0)])),
            glints(np.array([28, 29]), np.array([[2.0, 300.0], [10.0, 300.0]])),
        ]
    )
    assert np.unique(assign_track_numbers(found, CAM)).tolist() == [0, 1]


def test_nothing_found_is_no_tracks():
    assert len(link_into_tracks(Glints.none(), CAM)) == 0


def test_velocities_take_the_calm_side_of_a_collision():
    paths = collision(40, contact=20.5, speed=10.0)
    frame = np.tile(np.arange(40), 2)
    ids = np.repeat([0, 1], 40)
    xy = np.concatenate([paths[:, 0], paths[:, 1]])
    truth = np.concatenate(
        [np.where(np.arange(40)[:, None] < 20.5, p[1] - p[0], p[-1] - p[-2]) for p in (paths[:, 0], paths[:, 1])]
    )
    assert np.abs(estimate_velocities(frame, ids, xy) - truth).max() < 1e-9


def test_tracks_hold_centres_and_say_when_they_do_not():
    paths = collision(30, contact=12.5, speed=6.0, centre=(320.0, 240.0))
    found, _ = scattered(np.random.default_rng(6), paths)
    tracks = link_into_tracks(found, CAM)
    assert tracks.particle.tolist() == sorted(tracks.particle.tolist())
    assert (tracks.flags == "").all()
    shift = np.hypot(tracks.x - tracks.glint_x, tracks.y - tracks.glint_y)
    assert 0.1 < shift.min() < shift.max() < 1.0
    bare = Camera.from_dict({k: v for k, v in CAMERA.items() if k != "lamp"})
    flagged = link_into_tracks(
        Glints(
            found.frame,
            found.x,
            found.y,
            found.cov,
            found.flux,
            found.background,
            np.full(len(found), PositionFlag.CLIPPED),
        ),
        bare,
    )
    assert (flagged.flags == "glint|clipped").all()
    assert np.array_equal(flagged.x, flagged.glint_x)


@pytest.mark.parametrize("seed", range(3))
def test_order_of_glints_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    found, _ = scattered(rng, collision(40, contact=15.2, speed=12.0, centre=(320.0, 240.0)))
    order = rng.permutation(len(found))
    mixed = link_into_tracks(found.take(order), CAM)
    plain = link_into_tracks(found, CAM)
    assert np.array_equal(mixed.x, plain.x)
    assert np.array_equal(mixed.particle, plain.particle)


def test_another_programs_links_join_the_same_balls():
    pytest.importorskip("laptrack", exc_type=ImportError)
    frames = wrap_frames(film(np.random.default_rng(3), collision(30, contact=14.0, speed=2.0)))
    shown = Recording(0, Camera.from_dict(CAMERA), frames)
    own, other = (track_clip(shown, f"maximum_likelihood{end}").tracks for end in ("", "+laptrack"))
    assert len(np.unique(other.particle)) == 2
    paths = [sorted(t.xy[t.particle == ball].tolist() for ball in (0, 1)) for t in (own, other)]
    assert paths[0] == paths[1]


def test_a_linker_that_there_is_not():
    with pytest.raises(InputError, match=r"no linker 'laptrek' behind \+, expected one of laptrack"):
        load_linker("centroid+laptrek", CAM)
    assert load_linker("centroid", CAM) is None
