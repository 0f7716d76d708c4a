"""A body's answer from its equations."""

import numpy as np
import pytest

from tg4mm.show.measure.rigid import Equations
from tg4mm.show.measure.series import series_of


def test_what_the_scene_at_rest_has_wrong_is_in_the_deviation():
    """b = (A − F) u: the answer is (1 − A⁻¹ F) u."""
    rng, count = np.random.default_rng(0), 3
    normals = np.stack([np.diag(rng.uniform(1, 2, 2 * count)) for _ in range(2)])[:, None]
    false = 0.2 * normals[:, 0]
    true = np.stack([np.cos(np.arange(60) * (0.3 + 0.2 * k)) for k in range(count)], 1)
    sides = np.einsum("hij,fj->hfi", (normals[:, 0] - false)[:, :, :count], true)
    equations = Equations(normals, normals, sides, false)
    found = series_of(equations, np.arange(60) / 30, np.eye(3), ("x", "y", "z"), 1.0)
    assert found.displacement == pytest.approx(0.8 * (true - true.mean(0)), abs=1e-9)
    assert found.false_share == pytest.approx(0.2)
