"""The fit: parameters recovered, errors that are the scatter, and the arrow-shaped solution the dense one."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from discrepancy_clips import absorbable, collisions, exact, noisy, unabsorbed
from scipy.stats import chi2 as chi2_law

from discrepancy.fitting.gauss_newton import fit_model, minimise_chi2, solve_step
from discrepancy.fitting.jacobian import differentiate_launches, differentiate_tracks, linearise
from discrepancy.fitting.model_fit import Linearisation, ModelFit, WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS, parameter_limits
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.time_left import in_stage, showing_stages
from synthcam.model import Model

WHITE = Noise(NoiseComponent(1.0))
TRUTH = Model().replace(
    {
        "restitution": 0.88,
        "sliding_friction": 0.25,
        "spin_transfer": 0.3,
        "rolling_drag": 0.16,
        "rolling_decel": 0.013,
    }
)


def far(fit, truth):
    """The shared parameters' distance to the truth, chi^2 with as many degrees of freedom."""
    off = np.array([fit.model.value(n) - truth.value(n) for n in fit.names])
    return float(off @ np.linalg.solve(fit.covariance, off))


@pytest.fixture(scope="module")
def fitted():
    return fit_model(collisions(TRUTH, 6, 11), Model(), BASE_PARAMETERS, WHITE)


def test_known_parameters_are_recovered_within_their_errors(fitted):
    off = [fitted.model.value(n) - TRUTH.value(n) for n in BASE_PARAMETERS]
    assert np.all(np.abs(off) < 3.5 * np.sqrt(np.diag(fitted.covariance)))
    assert fitted.covariance[0, 0] < 1e-3**2  # the errors are no excuse


def test_chi2_is_what_noise_leaves(fitted):
    dof = fitted.points - fitted.parameters
    assert fitted.parameters == 5 + 6 * 6
    assert abs(fitted.chi2 / dof - 1) < 4 * np.sqrt(2 / dof)


def test_errors_are_the_scatter_over_repeats():
    clips, repeats = exact(Model(), 4, 12), 12
    distances = [
        far(fit_model(noisy(clips, seed), Model(), BASE_PARAMETERS, WHITE), Model()) for seed in range(repeats)
    ]
    low, high = chi2_law.ppf([1e-3, 1 - 1e-3], repeats * len(BASE_PARAMETERS))
    assert low < sum(distances) < high


def test_eliminating_the_launches_equals_dense_least_squares():
    fit = fit_model(collisions(Model(), 3, 13), Model(), BASE_PARAMETERS, WHITE)
    moved = dataclasses.replace(fit, residuals=tuple(np.cos(np.arange(len(r))) for r in fit.residuals))
    unit = absorbable(fit)
    own_sizes = [np.linalg.norm(slopes, axis=0) for slopes in fit.launch_slopes]
    scale = np.concatenate([np.linalg.norm(np.concatenate(fit.slopes), axis=0), *own_sizes])
    best = np.linalg.lstsq(unit, np.concatenate(moved.residuals), rcond=None)[0] / scale
    shared, own = solve_step(moved, 0.0, np.full(5, -np.inf), np.full(5, np.inf))
    error = np.sqrt(np.diag(fit.covariance))
    assert np.allclose(shared / error, best[:5] / error, atol=1e-5)
    assert np.allclose(own, best[5:].reshape(3, 6), rtol=1e-4, atol=1e-9)
    inverse = np.linalg.inv(unit.T @ unit) / np.outer(scale, scale)
    assert np.allclose(fit.covariance / np.outer(error, error), inverse[:5, :5] / np.outer(error, error), atol=1e-5)


def test_information_is_that_of_dense_least_squares(fitted):
    columns = [np.sin(np.outer(np.arange(len(r)), [0.1, 0.2])) for r in fitted.residuals]
    left = unabsorbed(fitted, np.concatenate(columns))
    gram, pull = fitted.information(columns)
    assert np.allclose(gram, left.T @ left, rtol=1e-9, atol=1e-9 * np.trace(gram))
    assert np.allclose(pull, left.T @ np.concatenate(fitted.residuals), atol=1e-9 * np.trace(gram))


def slope(model, clip, name):
    return differentiate_tracks(model, clip.launch[None], [clip], name)[0]


def test_a_derivative_keeps_to_the_limits():
    clip = exact(Model(), 1, 14)[0]
    inside = slope(Model().replace({"restitution": 1 - 1e-4}), clip, "restitution")
    assert parameter_limits(Model(), "restitution") == (0.0, 1.0)
    assert np.allclose(slope(Model().replace({"restitution": 1.0}), clip, "restitution"), inside, atol=1e-4)


def test_a_derivative_where_the_motion_ends_to_exist():
    clip = exact(Model(), 1, 15)[0]
    frictionless = Model().replace({"rolling_decel": 0.0})  # there no tilt lets the target rest
    assert np.all(slope(frictionless, clip, "plate_tilt.x") == 0)
    steepest = 7 / 5 * 0.0103 / 9.81  # one side only
    tilted = Model().replace({"plate_tilt.x": steepest * (1 - 1e-6)})
    assert np.abs(slope(tilted, clip, "plate_tilt.x")).max() > 1e-3


def test_a_forward_difference_is_the_derivative():
    clip = exact(Model(), 1, 16)[0]
    for name in ("sliding_friction", "stribeck.rise", "plate_tilt.x", "magnetic_attraction.pull"):
        central = slope(Model(), clip, name)
        forward = differentiate_tracks(Model(), clip.launch[None], [clip], name, [clip.xy])[0]
        assert np.abs(forward - central).max() < 2e-3 * np.abs(central).max()


def test_launch_derivatives_of_many_clips_are_those_of_each():
    clips = exact(Model(), 3, 18)
    launches = np.array([c.launch for c in clips])
    here, slopes = differentiate_launches(Model(), launches, clips)
    again, parts = differentiate_launches(Model(), launches, clips, batch=2)
    for clip, a, b, s, p in zip(clips, here, again, slopes, parts, strict=True):
        assert np.allclose(a, b, atol=1e-13)
        assert np.allclose(s, p, atol=1e-7)
        before = clip.phases() == 0
        assert np.allclose(s[before & (clip.ball == 0), :, :2], np.eye(2), atol=1e-6)  # a target at rest is displaced


def test_launch_derivatives_at_the_edge_of_where_a_ball_can_rest():
    """On a waving plate: just inside the edge, some nudges of the place take the target to where it rolls off."""
    clip = exact(Model(), 1, 18)[0]
    inside, edge = 0.0, 1e-3
    for _ in range(40):
        middle = (inside + edge) / 2
        try:
            predict_tracks(waving(middle), clip.launch[None], [clip])
            inside = middle
        except ValueError:
            edge = middle
    here, (slopes,) = differentiate_launches(waving(inside), clip.launch[None], [clip])
    _, (safe,) = differentiate_launches(waving(inside * (1 - 1e-3)), clip.launch[None], [clip])
    assert np.all(np.isfinite(here))
    assert np.allclose(slopes, safe, atol=1e-2 * np.abs(safe).max())


def waving(height):
    return Model().replace({"plate_waviness.a": height, "plate_waviness.wavelength": 0.02})


def test_a_parameter_stops_at_its_limit_and_the_rest_are_fitted_as_without_it():
    """A friction that falls with speed, where only a rising one, or none, is allowed: none."""
    clips = collisions(Model().replace({"velocity_restitution.e": -0.01}), 4, 19)
    without = fit_model(clips, Model(), BASE_PARAMETERS, WHITE)
    hop = fit_model(clips, Model(), (*BASE_PARAMETERS, "hop.share"), WHITE)
    air = fit_model(clips, Model(), (*BASE_PARAMETERS, "air_drag.share"), WHITE)
    stopped = [f for f, name in ((hop, "hop.share"), (air, "air_drag.share")) if f.model.value(name) == 0]
    assert stopped
    assert all(f.chi2 == pytest.approx(without.chi2, abs=0.05) for f in stopped)
    assert all(f.model.value(n) >= 0 for f, n in ((hop, "hop.share"), (air, "air_drag.share")))


def test_a_fit_that_starts_from_another_ends_where_a_fresh_one_does():
    truth = Model().replace({"velocity_restitution.e": 0.05, "rolling_quadratic.K": 0.2})
    clips = collisions(truth, 4, 20)
    names = (*BASE_PARAMETERS, "velocity_restitution.e", "rolling_quadratic.K")
    fresh = fit_model(clips, Model(), names, WHITE)
    evidence = WhitenedClips.of(clips, WHITE)
    base = fit_model(clips, Model(), BASE_PARAMETERS, WHITE)
    slopes = [differentiate_tracks(base.model, base.launches, clips, n) for n in names[5:]]
    columns = evidence.whiten([np.stack([s[k] for s in slopes], axis=-1) for k in range(4)])
    stale = minimise_chi2(evidence, base.extend(base.model, names[5:], columns))
    assert stale.chi2 == pytest.approx(fresh.chi2, abs=0.01)
    error = np.sqrt(np.diag(fresh.covariance))
    assert np.allclose(stale.covariance / np.outer(error, error), fresh.covariance / np.outer(error, error), atol=1e-3)
    rough = minimise_chi2(evidence, base.extend(base.model, names[5:], columns), rough=True)
    assert rough.chi2 == pytest.approx(fresh.chi2, abs=1.0)


def test_with_nothing_shared_only_the_launches_are_fitted():
    clips = collisions(Model(), 2, 17)
    fit = fit_model(clips, Model(), (), WHITE)
    assert isinstance(fit, ModelFit)
    assert fit.model == Model()
    assert fit.covariance.shape == (0, 0)
    assert abs(fit.chi2 / (fit.points - 12) - 1) < 4 * np.sqrt(2 / fit.points)


def test_a_lost_frame_is_fitted_where_it_was_found():
    """The instant within the gap between two frames has no effect: no step of the fit may move it far away."""
    truth = TRUTH.replace({"dropped_frame.lost": 0.5, "dropped_frame.frame": 40.0})
    clips = collisions(truth, 6, 11)
    start = truth.replace({"dropped_frame.lost": 0.3, "dropped_frame.frame": 40.3})
    evidence, launches = WhitenedClips.of(clips, WHITE), np.array([c.launch for c in clips])
    names = (*BASE_PARAMETERS, "dropped_frame.lost", "dropped_frame.frame")
    fit = minimise_chi2(evidence, linearise(evidence, start, names, launches))
    assert fit.model.value("dropped_frame.frame") == 40.3
    assert fit.model.value("dropped_frame.lost") == pytest.approx(0.5, abs=4 * fit.std["dropped_frame.lost"])


IN_VALLEY = {"stribeck.rise": 0.0825, "stribeck.slip": 0.0613, "air_drag.share": 0.59}


@pytest.fixture(scope="module")
def fit_from():
    """The fit to collisions with the law IN_VALLEY, from where one starts."""
    clips = collisions(Model().replace(IN_VALLEY), 12, 3)
    evidence, launches = WhitenedClips.of(clips, WHITE), np.array([c.launch for c in clips])
    names = (*BASE_PARAMETERS, *IN_VALLEY)
    return cache(
        lambda *start: minimise_chi2(evidence, linearise(evidence, Model().replace(dict(start)), names, launches))
    )


@pytest.mark.parametrize(
    ("rise", "slip"),
    [
        pytest.param(1.9, 0.0116, marks=pytest.mark.gate),
        pytest.param(5, 0.004, marks=pytest.mark.gate),
        (0.02, 0.004),
        pytest.param(0.3, 0.5, marks=pytest.mark.gate),
    ],
)
def test_a_valley_that_bends_is_followed_to_its_end(fit_from, rise, slip):
    """Friction that rises steeply in the slowest slip looks like one that rises gently."""
    end = fit_from(*(IN_VALLEY | {"stribeck.rise": rise, "stribeck.slip": slip}).items())
    assert end.chi2 == pytest.approx(fit_from(*IN_VALLEY.items()).chi2, abs=0.01)
    for name, value in IN_VALLEY.items():
        assert end.model.value(name) == pytest.approx(value, abs=3.5 * end.std[name])


@dataclasses.dataclass(frozen=True)
class Banana:
    """Rosenbrock's valley in the place of a motion: residuals 1 - x and steep (y - x^2)."""

    x: float
    y: float
    steep: float

    def value(self, name):
        return getattr(self, name)

    def replace(self, values):
        return dataclasses.replace(self, **values)

    def fit(self):
        residuals = np.array([1 - self.x, -self.steep * (self.y - self.x**2)])
        slopes = np.array([[1.0, 0.0], [-2 * self.steep * self.x, self.steep]])
        names, launches = ("x", "y"), np.zeros((0, 6))
        linearisation = Linearisation(self, names, launches, (slopes,), (np.zeros((2, 6)),))
        return ModelFit(self, names, launches, (residuals,), linearisation)


def test_a_part_of_a_step_that_gains_nearly_nothing_is_not_the_end(monkeypatch):
    def step(fit, damping, held):
        (j,), (r,) = fit.slopes, fit.residuals
        matrix = j.T @ j
        far = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), j.T @ r)
        return {"x": fit.model.x + far[0], "y": fit.model.y + far[1]}, 0.0

    def moved(evidence, fit, values, own):
        return dataclasses.replace(fit, model=(there := fit.model.replace(values)), residuals=there.fit().residuals)

    def foretold(fit, values, own):
        far = np.array([values["x"] - fit.model.x, values["y"] - fit.model.y])
        return float(((fit.residuals[0] - fit.slopes[0] @ far) ** 2).sum())

    monkeypatch.setattr("discrepancy.fitting.gauss_newton._step", step)
    here = "discrepancy.fitting.gauss_newton"
    monkeypatch.setattr(f"{here}._apply_step", moved)
    monkeypatch.setattr(f"{here}._predict_chi2", foretold)
    monkeypatch.setattr(f"{here}.linearise", lambda evidence, model, names, launches: model.fit())
    assert minimise_chi2(None, Banana(-3.66, 3.66**2, 9.7).fit()).chi2 < 1e-6


def test_one_launch_that_leads_astray_is_damped_and_no_other():
    """A clip whose launch starts far off makes whole steps fail: the shared parameters are found all the same."""
    clips = collisions(Model(), 8, 13)
    starts = np.array([c.launch for c in clips])
    starts[2, 5] = np.sign(starts[2, 5]) * 0.97
    fit = fit_model(clips, Model(), BASE_PARAMETERS, WHITE, starts)
    near = fit_model([c for k, c in enumerate(clips) if k != 2], Model(), BASE_PARAMETERS, WHITE)
    assert np.allclose(fit.values(), near.values(), atol=3 * np.sqrt(np.diag(near.covariance)))
    free, _ = solve_step(fit, 0.0, *fit.step_bounds())
    held, own = solve_step(fit, 0.0, *fit.step_bounds(), np.eye(8)[2] * 1e9)
    assert np.abs(own[2]).max() < 1e-9
    assert np.allclose(held, free, atol=np.sqrt(np.diag(fit.covariance)))


@pytest.mark.parametrize(("smooth", "shown"), [({"sliding_friction": 0.0, "spin_transfer": 0.0}, 0), ({}, 3)])
def test_a_spin_that_no_track_shows_stays_where_it_is(smooth, shown):
    """As of pucks on air: rounding would pass for a derivative, and make steps of 10^7 m/s."""
    model = TRUTH.replace(smooth)
    clips = noisy(exact(model, 6, 12, spins=[[0.1, 0.03, 0.05]]), 12)
    evidence, starts = WhitenedClips.of(clips, WHITE), np.array([c.launch for c in clips])
    here = linearise(evidence, model, ("restitution",), starts)
    assert [int(np.any(s[:, 6:] != 0, axis=0).sum()) for s in here.launch_slopes] == 6 * [shown]
    spins = minimise_chi2(evidence, here).launches[:, 6:]
    assert np.abs(spins - [0.1, 0.03, 0.05]).max() < 0.05
    assert np.array_equal(spins, starts[:, 6:]) == (not shown)


def test_a_fit_that_cannot_become_useful_is_given_up():
    """It stops early if no step leads near the chi^2 asked for; a fit that reaches that ends as without the demand."""
    clips = collisions(TRUTH, 4, 11)
    evidence, steps = WhitenedClips.of(clips, WHITE), []
    start = linearise(evidence, Model(), BASE_PARAMETERS, np.array([c.launch for c in clips]))
    with showing_stages(steps.append), in_stage("fit"):  # each prediction reports
        whole = minimise_chi2(evidence, start)
        full, chi2 = len(steps), []
        for demand in (whole.chi2 + 1, whole.chi2 - 1e6):
            steps.clear()
            chi2.append(minimise_chi2(evidence, start, useful_chi2=demand).chi2)
            assert (len(steps) < full - 1) is (demand < 0)  # less the report of the stage itself
    assert chi2[0] == pytest.approx(whole.chi2, abs=1e-2)
    assert chi2[1] > whole.chi2 + 1
