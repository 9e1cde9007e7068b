"""Free stretches: the motion of one ball between contacts, whatever made it move, is evidence by itself."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import STD, exact, noisy, only

from discrepancy.data.outlier_points import note_removed_points
from discrepancy.data.reading import read_collisions
from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting.base_fit import fit_base_model
from discrepancy.free_laws.ranges import compute_ranges
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.preparation import prepare_data
from discrepancy.search import search
from discrepancy.validate.residual_map import find_disagreements
from synthcam import Scene
from synthcam.library import library
from synthcam.model import Model
from synthcam_shared.errors import InputError

SILENT = Noise(NoiseComponent(1.0))


def scattered(model, count, seed):
    """Collisions with noise, each with a restitution and a spin transfer of its own."""
    rng, clips = np.random.default_rng(seed), []
    for k, clip in enumerate(exact(model, count, seed)):
        other = {"restitution": rng.uniform(0.5, 0.95), "spin_transfer": rng.uniform(0, 0.3)}
        own = exact(model.replace(other), count, seed)[k]
        clips.append(dataclasses.replace(clip, xy=own.xy, slide_ends=own.slide_ends))
    return noisy(clips, seed)


def test_each_collision_gives_the_striker_before_and_both_balls_after():
    clips = exact(Model(), 4, 2)
    cut = cut_stretches(clips)
    assert [c.clip for c in cut] == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert [c.striker for c in cut[:3]] == ["b", "b", "a"]
    for clip, parts in zip(clips, np.reshape(cut, (4, 3)), strict=True):
        off = np.concatenate([(p.frame + 0.5 * p.exposure * p.fps - clip.launch[2] * p.fps) for p in parts])
        assert np.abs(off).min() > 1.5
        seen = {tuple(xy) for p in parts for xy in p.xy}
        assert seen < {tuple(xy) for xy in clip.xy}


def test_a_free_start_follows_any_motion_that_slides_and_then_rolls():
    """The paths are those of collisions; that of a stretch has no collision, and no law of the impact."""
    cut = cut_stretches(exact(Model(), 4, 2))
    fit = fit_base_model(cut, Model(), SILENT)
    assert set(fit.names) == {"sliding_friction", "rolling_drag", "rolling_decel"}
    for name in fit.names:
        assert fit.model.value(name) == pytest.approx(Model().value(name), rel=1e-4)
    assert fit.chi2 < 1e-3 * fit.points  # a thousandth of a claimed error, which is 1.6 um


@pytest.mark.gate
@pytest.mark.usefixtures("undrawn")
def test_an_effect_of_the_plate_is_named_whatever_the_impacts_were(monkeypatch, tmp_path):
    few = ("plate_tilt", "velocity_restitution", "rolling_quadratic")
    only(monkeypatch, ("rolling_speed",), **{name: library()[name] for name in few})
    true = {"plate_tilt.x": 3e-4, "plate_tilt.y": -1e-4}
    clips = scattered(Model().replace(true), 6, 7)
    found = search(clips, Model(), stretches=True)
    assert [claim.effect for claim in found.claims] == ["plate_tilt"]
    for name, value in true.items():
        assert abs(found.claims[0].values[name] - value) < 4 * found.claims[0].std[name]
    assert found.gap.after < 1.15
    assert "velocity_restitution" in found.undetectable
    assert "held-out stretches" in found.sentence()
    page = found.report(tmp_path / "report").read_text()
    assert "fitted stretches" in page


def test_the_phase_that_disagrees_is_found_and_none_without_a_fault():
    for strength, phase in ((3e-4, "rolling"), (0.0, None)):
        cut = cut_stretches(noisy(exact(Model().replace({"plate_tilt.x": strength}), 6, 3), 3))
        largest = find_disagreements(cut, fit_base_model(cut, Model(), SILENT), SILENT)[0]
        assert (largest.phase if largest.sigma > 5 else None) == phase


def test_stretches_of_one_recording_are_all_fitted_or_all_held_out():
    data = prepare_data(noisy(exact(Model(), 6, 3), 3), Model(), stretches=True)
    fitted, held_out = ({c.clip for c in clips} for clips in (data.clips, data.held_out))
    assert fitted.isdisjoint(held_out)
    assert len(fitted | held_out) == 6


def test_the_balls_of_a_crowd_give_stretches_that_hold_no_event():
    clip, rng = Scene.read("crowd", timing={"frames": 120}).draw(seed=1), np.random.default_rng(3)
    x, y = (clip.tracks[f"{axis}_mean_px"] + 0.05 * rng.standard_normal(len(clip.tracks)) for axis in "xy")
    table = clip.tracks[["frame", "particle"]].assign(clip=0, x=x, y=y, x_std=0.05, y_std=0.05, cov_xy=0.0)
    stretches, _ = read_collisions(table[clip.tracks.visible], clip.camera_json, stretches=True)
    assert len(stretches) > 25
    assert all(stretch.is_stretch for stretch in stretches)
    assert cut_stretches(stretches) == stretches
    assert note_removed_points(stretches, stretches) == []
    events, true = clip.solve().events, clip.tracks.set_index(["frame", "particle"])
    for stretch in stretches:
        first = true.loc[stretch.frame[0]]
        ball = int((first[["x", "y"]] - stretch.xy[0]).pow(2).sum(axis=1).idxmin())
        own = events[(events.kind == "contact") & ((events.i == ball) | (events.j == ball))].t_s.to_numpy()
        start, end = (stretch.frame[[0, -1]] + 0.5) / stretch.fps
        assert not ((own > start) & (own < end)).any()


def test_recordings_without_a_long_stretch_are_refused_in_one_line():
    short = [c.select(np.flatnonzero(np.abs(c.frame / c.fps - c.launch[2]) < 0.03)) for c in exact(Model(), 8, 3)]
    with pytest.raises(InputError, match="no clip has free stretches that are long enough"):
        prepare_data([dataclasses.replace(c, xy=c.xy + STD) for c in short], Model(), stretches=True)


def test_the_ranges_of_free_laws_are_those_that_stretches_cover():
    """A stretch is short. Its ball would later roll where no position tells of it, and earlier come from there."""
    clips = cut_stretches(exact(Model(), 4, 2))
    launches = np.array([clip.launch for clip in clips])
    places = compute_ranges(Model(), launches, clips)[""].places
    seen = np.concatenate([clip.xy for clip in clips])
    step = 0.6 / clips[0].fps  # a fast ball's way in a frame, m
    assert np.all(np.abs(places.min(axis=0) - seen.min(axis=0)) < step)
    assert np.all(np.abs(places.max(axis=0) - seen.max(axis=0)) < step)
