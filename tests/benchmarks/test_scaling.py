"""An exponent is that of a power law, with its standard error."""

import numpy as np
import pytest

from benchmarks.scaling import fitted


def test_an_exponent_lies_within_its_error():
    x = np.array([1.0, 2, 4, 8, 16])
    assert fitted(x, 3 * x**1.5) == pytest.approx((1.5, 0), abs=1e-9)
    rng = np.random.default_rng(0)
    found = np.array([fitted(x, x**0.7 * np.exp(0.1 * rng.normal(size=5))) for _ in range(400)])
    assert found[:, 0].mean() == pytest.approx(0.7, abs=0.01)
    assert np.sqrt((found[:, 1] ** 2).mean()) == pytest.approx(found[:, 0].std(), rel=0.1)
    with pytest.raises(ValueError, match="2 points, expected 3 or more"):
        fitted([1, 2], [1, 2])
