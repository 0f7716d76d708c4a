"""A body's answer from its equations."""

import numpy as np
import pytest

from tg4mm.show.measure.rigid import Equations
from tg4mm.show.measure.series import series_of


@pytest.mark.parametrize("count", [2, 3])
def test_of_a_flat_capture_what_the_scene_at_rest_has_wrong_is_taken_out(count):
    """b = (A − F) u: the answer is u, where there is no depth; else the F that is left out is in the ±."""
    rng = np.random.default_rng(0)
    turns = {2: 1, 3: 3}[count]
    normals = np.stack([np.diag(rng.uniform(1, 2, count + turns)) for _ in range(2)])[:, None]
    false = 0.2 * normals[:, 0]
    true = np.stack([np.cos(np.arange(60) * (0.3 + 0.2 * k)) for k in range(count)], 1)
    sides = np.einsum("hij,fj->hfi", (normals[:, 0] - false)[:, :, :count], true)
    equations = Equations(normals, normals, sides, false)
    found = series_of(equations, np.arange(60) / 30, np.eye(3)[:count], ("x", "y", "z")[:count], 1.0)
    expected = true if count == 2 else 0.8 * true
    assert found.displacement == pytest.approx(expected - expected.mean(0), abs=1e-9)
    assert found.false_share == pytest.approx(0.2**2 if count == 2 else 0.2)
