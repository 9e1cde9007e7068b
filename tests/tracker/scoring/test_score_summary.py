"""A score in a few lines: figures worked by hand, and what each kind of fault is called."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.scoring.score import DetectorScore, describe_fitness, summarise_score


def figures(n=100, rmse=1e-4, ratio=1.0, z_mean=0.0, z_std=1.0):
    return {"n": n, "rmse": rmse, "ratio": ratio, "z_mean": z_mean, "z_std": z_std}


GOOD = DetectorScore(
    suite="made",
    detector="made",
    localisation={"n": 1000, "missed": 2, "false": 1, "rmse_px": 0.00871, "ratio": 1.005},
    tracking={"swaps": 0},
    quantities={f"{name}{kind}": figures() for name in QUANTITY_NAMES for kind in ("", "_free")},
    statuses={"n": 100, "ok": 99, "misfit": 1},
    ms_per_frame=None,
    table=pd.DataFrame(),
)


def with_quantity(name, **changes):
    return dataclasses.replace(GOOD, quantities=GOOD.quantities | {name: figures(**changes)})


def test_the_lines_hold_the_figures():
    first, positions, head, *rows, last = summarise_score(
        with_quantity("tau1_free", rmse=5.6e-5, ratio=1.04, z_std=0.97)
    )
    assert first == "100 clips: 99 ok, 1 misfit"
    assert positions == "positions: 0.0087 px rmse, 1.005(16) times the bound; 2 missed, 1 false, 0 identity swaps"
    assert [row.split()[0] for row in rows] == ["r", "mu_k", "tau1", "tau2"]
    assert rows[2].split() == ["tau1", "ms", "0.1", "1.000(71)", "1", "0.056", "1.040(74)", "0.97"]
    assert len(head) == len(rows[2])
    assert last == describe_fitness(GOOD)


@pytest.mark.parametrize(
    ("score", "said"),
    [
        (GOOD, "Good enough to measure with: the standard errors agree with the truth, and are about"),
        (
            dataclasses.replace(GOOD, tracking={"swaps": 2}),
            "Not good enough to track these balls: 0.2 % missed or false, 2 identity swaps",
        ),
        (
            dataclasses.replace(GOOD, localisation=GOOD.localisation | {"missed": 250}),
            "Not good enough to track these balls: 20 % missed or false, 0 identity swaps",
        ),
        (with_quantity("tau2", z_std=3.0), "Not good enough for error bars: the errors of tau2 are 3 times its"),
        (with_quantity("r", z_mean=2.0, z_std=0.0), "Not good enough for error bars: the errors of r are 2 times its"),
        (
            with_quantity("mu_k", ratio=2.5),
            "Good enough to measure with: the standard errors agree with the truth. But the errors of mu_k are 2.5",
        ),
        (
            with_quantity("mu_k", ratio=2.5, n=6),
            "Good enough to measure with: the standard errors agree with the truth. With so few clips",
        ),
        (with_quantity("tau2_free", z_std=3.0), "Good enough to measure with"),
        (
            dataclasses.replace(
                GOOD, quantities={n: figures(n=0, rmse=np.nan, ratio=np.nan, z_std=np.nan) for n in GOOD.quantities}
            ),
            "Good enough to track these balls. No collision was measured",
        ),
    ],
)
def test_each_fault_is_called_by_its_name(score, said):
    assert describe_fitness(score).startswith(said)


def test_chance_is_no_fault_and_few_clips_are_said():
    """The spread of z over n clips has an error of 1 / sqrt(2 n)."""
    many, few = (
        dataclasses.replace(with_quantity("r", n=n, z_std=1.45), statuses={"n": n, "ok": n}) for n in (100, 19)
    )
    assert describe_fitness(many).startswith("Not good enough for error bars")
    assert describe_fitness(few).startswith("Good enough to measure with")
    assert describe_fitness(few).endswith("Fewer than 20 clips: the spread of z is uncertain.")
