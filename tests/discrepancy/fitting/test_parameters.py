"""The numbers that a fit may change, and what a model may lack."""

import pytest

from discrepancy.fitting.parameters import (
    BASE_PARAMETERS,
    difference_step,
    find_parameter,
    list_candidates,
    list_names_to_fit,
    parameter_limits,
    refine_tried_values,
)
from synthcam.library import library
from synthcam.model import Model

TEXTBOOK = Model().replace({"sliding_friction": 0.0, "spin_transfer": 0.0})


def test_base_parameters_are_fitted_unless_they_are_zero():
    assert list_names_to_fit(Model()) == BASE_PARAMETERS
    assert set(BASE_PARAMETERS) - set(list_names_to_fit(TEXTBOOK)) == {"sliding_friction", "spin_transfer"}


def test_a_base_parameter_held_at_zero_is_a_candidate():
    held = [s for s in list_candidates(TEXTBOOK, list_names_to_fit(TEXTBOOK)) if s.kind is None]
    assert [s.name for s in held] == ["sliding_friction", "spin_transfer"]
    freed = list_names_to_fit(Model(sliding_friction=0.0, free=("sliding_friction",)))
    assert "sliding_friction" in freed
    assert all(s.kind is not None for s in list_candidates(Model(), freed))


def test_every_effect_of_the_library_is_a_candidate_until_it_is_fitted():
    assert {s.name for s in list_candidates(Model(), BASE_PARAMETERS)} == set(library())
    half = next(s for s in list_candidates(Model(), (*BASE_PARAMETERS, "plate_tilt.x")) if s.name == "plate_tilt")
    assert half.strengths == ("plate_tilt.y",)
    both = (*BASE_PARAMETERS, "plate_tilt.x", "plate_tilt.y")
    assert "plate_tilt" not in {s.name for s in list_candidates(Model(), both)}


def test_a_shape_that_no_track_tells_is_not_looked_for():
    friction = next(s for s in list_candidates(Model(), BASE_PARAMETERS) if s.name == "ball_friction")
    assert friction.shapes == ("ball_friction.mu",)
    kept = Model().replace({"ball_friction.share": 0.0, "ball_friction.beta": 0.2})
    assert kept.replace({"ball_friction.share": 0.1, **next(friction.grid(kept))}).value("ball_friction.beta") == 0.2


def test_laws_that_bend_friction_mean_nothing_without_any():
    names = {s.name for s in list_candidates(TEXTBOOK, list_names_to_fit(TEXTBOOK))}
    assert {"stribeck", "viscous_friction", "adhesion", "drilling_spin"} & names == set()
    assert {"air_drag", "ball_friction", "hop"} <= names


def test_what_is_taken_out_of_a_model_leaves_no_trace():
    stribeck = next(s for s in list_candidates(Model(), BASE_PARAMETERS) if s.name == "stribeck")
    assert stribeck.remove_from(Model().replace({"stribeck.rise": 0.1, "stribeck.slip": 0.2})) == Model()
    friction = next(s for s in list_candidates(TEXTBOOK, list_names_to_fit(TEXTBOOK)) if s.name == "sliding_friction")
    assert friction.remove_from(Model(spin_transfer=0.0)) == TEXTBOOK


@pytest.mark.parametrize(
    "candidate", [s for s in list_candidates(Model(), BASE_PARAMETERS) if s.shapes], ids=lambda s: s.name
)
def test_shapes_to_try_lie_within_their_limits_and_apart(candidate):
    grid = list(candidate.grid(Model()))
    for name in candidate.shapes:
        low, high = parameter_limits(Model(), name)
        tried = sorted({g[name] for g in grid})
        assert low <= tried[0] < tried[-1] <= high
        declared = find_parameter(Model(), name).tries
        assert tried == list(declared) if declared else 3 <= len(tried) <= 5
        for value in tried:
            near = [refine_tried_values(find_parameter(Model(), name), value, k) for k in (0, 1)]
            assert all(low <= x <= high for x in near[0] + near[1])
            assert max(abs(x - value) for x in near[1]) < max(abs(x - value) for x in near[0])


def test_the_shapes_of_an_effect_that_is_there_are_its_own():
    there = Model().replace({"stribeck.rise": 0.1})
    stribeck = next(s for s in list_candidates(there, BASE_PARAMETERS) if s.name == "stribeck")
    assert list(stribeck.grid(there)) == [{}]


def test_every_parameter_has_a_step_and_limits():
    names = [*BASE_PARAMETERS, "gravity", *(f"{n}.{p.name}" for n, e in library().items() for p in e.parameters())]
    for name in names:
        low, high = parameter_limits(Model(), name)
        assert low < high
        assert 0 < difference_step(Model(), name) < high - low
