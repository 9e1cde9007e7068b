"""A dependence of the errors of positions is found with its size, and none is found where there is none."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import CAMERA, STD, exact, noise_of_pair, noisy

from discrepancy.data.notes import SearchNoteKind
from discrepancy.noise.error_trends import remove_frame_shift, rescale_errors
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.preparation import prepare_data
from synthcam.model import Model

PIXEL = CAMERA.scale
WHITE = Noise(NoiseComponent(1.0))


def paths(clip):
    """Velocities (n, 2) of a clip without noise."""
    each = [np.gradient(clip.xy[clip.ball == ball], axis=0) * clip.fps for ball in (0, 1)]
    return np.concatenate(each)


def with_errors(factor=lambda clip: 1.0, shift=lambda clip: 0.0, rho=0.0, count=10, seed=4):
    rng, clips = np.random.default_rng(seed), exact(Model(), count, seed)
    sizes = [np.broadcast_to(factor(c), len(c.frame)) for c in clips]
    noise = [s[:, None] * noise_of_pair(rng, rho) for s in sizes]
    return [dataclasses.replace(c, xy=c.xy + n + shift(c)) for c, n in zip(clips, noise, strict=True)], sizes


def odd(clip):
    return np.where(clip.frame % 2 == 1, 0.5, -0.5)[:, None]


def kinds(notes):
    return {note.kind for note in notes}


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_noise_that_is_the_same_everywhere_is_left_alone(rho):
    for seed in range(4):
        clips, _ = with_errors(rho=rho, seed=seed)
        assert remove_frame_shift(clips, clips) == (clips, [])
        assert rescale_errors(clips, clips, Noise(NoiseComponent(1.0, (rho,)))) == (clips, [])


@pytest.mark.parametrize(
    ("kind", "factor"),
    [
        (SearchNoteKind.NOISE_BY_SPEED, lambda c: 1 + 10 * np.hypot(*paths(c).T)),
        (SearchNoteKind.NOISE_BY_PLACE, lambda c: np.exp(25 * c.xy[:, 0])),
        (SearchNoteKind.NOISE_BY_BALL, lambda c: np.where(c.ball == 1, 2.0, 1.0)),
        (SearchNoteKind.NOISE_BY_PARITY, lambda c: 1.5 + odd(c)[:, 0]),
    ],
)
def test_errors_become_those_that_were_made(kind, factor):
    clips, sizes = with_errors(factor)
    scaled, notes = rescale_errors(clips, clips, Noise(NoiseComponent(float(np.mean(np.square(sizes))))))
    assert kinds(notes) == {kind}
    ratio = np.concatenate([c.claimed_std() / STD / s for c, s in zip(scaled, sizes, strict=True)])
    assert np.std(np.log(ratio)) < 0.12
    assert np.mean(np.log(np.concatenate([c.claimed_std() / STD for c in scaled]))) == pytest.approx(0, abs=0.1)


def test_a_shift_of_every_second_frame_is_measured_and_removed():
    made = np.array([0.04 * PIXEL, -0.02 * PIXEL])
    clips, _ = with_errors(shift=lambda c: odd(c) * made)
    cleaned, (note,) = remove_frame_shift(clips, clips)
    error = STD * 2 / np.sqrt(10 * 160)
    assert [note.values["x_um"], note.values["y_um"]] == pytest.approx(1e6 * made, abs=5e6 * error)
    assert note.values["late_ms"] == 0
    assert remove_frame_shift(cleaned, cleaned)[1] == []


def test_a_delay_of_every_second_frame_is_told_from_a_displacement():
    late = 1e-4
    clips, _ = with_errors(shift=lambda c: odd(c) * late * paths(c))
    cleaned, (note,) = remove_frame_shift(clips, clips)
    assert note.values["late_ms"] == pytest.approx(1e3 * late, rel=0.05)
    assert note.values["x_um"] == note.values["y_um"] == 0
    assert remove_frame_shift(cleaned, cleaned)[1] == []


def test_a_search_is_prepared_with_both():
    clips, _ = with_errors(lambda c: 1 + 10 * np.hypot(*paths(c).T), lambda c: odd(c) * [0.2 * PIXEL, 0], count=8)
    begun = [
        dataclasses.replace(guess, xy=made.xy)
        for guess, made in zip(noisy(exact(Model(), 8, 4), 4), clips, strict=True)
    ]
    data = prepare_data(begun, Model())
    assert kinds(data.error_notes) == {SearchNoteKind.FRAME_SHIFT, SearchNoteKind.NOISE_BY_SPEED}
    assert data.noise.own.partial_autocorrelations == ()
