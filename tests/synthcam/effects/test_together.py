"""Effects side by side: one that is too faint to matter changes nothing, whatever way of solving it calls for."""

import numpy as np
import pytest

from synthcam.dynamics.batch import solve_collisions
from synthcam.library import library
from synthcam.model import Model

ROWS = np.array([[0.0, 0.01, 0.1, 0.45, 2.0, 0.4], [0.01, 0.0, 0.1, 0.2, 5.0, -0.3]])
FAINT, SAME = 1e-7, 3e-9  # realistic sizes; m


def sized(name, size):
    """An effect's parameters, strengths at so many realistic sizes."""
    kind = library()[name]
    shapes = {p.name: p.typical for p in kind.parameters() if p.fixed and p.typical}
    return {f"{name}.{k}": v for k, v in (shapes | {p.name: size * p.typical for p in kind.strengths()}).items()}


def positions(values):
    return solve_collisions(Model().replace(values), ROWS, 0.0, 0.4, [False, True]).at(np.linspace(0.02, 0.4, 40))[
        ..., :3
    ]


@pytest.mark.parametrize("part", [0, *(pytest.param(k, marks=pytest.mark.gate) for k in (1, 2, 3))])
@pytest.mark.parametrize("name", library())
def test_a_faint_effect_beside_another_changes_nothing(name, part):
    """Beside a quarter of the others at a time; four effects in turn begin with the same quarter."""
    alone, names = positions(sized(name, 1.0)), list(library())
    for other in names[(names.index(name) // 4 + part) % 4 :: 4]:
        if other == name:
            continue
        beside = positions(sized(name, 1.0) | sized(other, FAINT))
        np.testing.assert_allclose(beside, alone, rtol=0, atol=SAME, err_msg=other)
