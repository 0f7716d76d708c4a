"""How far a mean over scenes and seeds is sure: 95 % intervals by bootstrap.

Scenes are drawn with replacement, then of each drawn scene its sets (seeds, motions) with replacement: sets of one
scene are alike, so that many seeds of few scenes do not count as many scenes. Half the interval is the standard
deviation of the resampled means times √(n / (n − 1)) t, with t Student's quantile for the n scenes: with the bare
quantiles of so few it would be too short (Hesterberg, The American Statistician 69, 2015).
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

_RESAMPLES = 4000
_LEVEL = 0.95


def half_width(values: Sequence[float], scenes: Sequence[str]) -> float | None:
    """Half of the 95 % interval of the mean of `values` [N], each of the scene named beside it.

    Of one scene its sets are drawn: the interval then says nothing of other scenes. None for a single value.
    """
    if len(values) < 2:
        return None
    names = {name: i for i, name in enumerate(dict.fromkeys(scenes))}
    weights, factor = _drawn(tuple(names[scene] for scene in scenes))
    return float(factor * np.std(weights @ np.asarray(values, np.float64)))


@lru_cache(maxsize=64)
def _drawn(scene_of: tuple[int, ...]) -> tuple[np.ndarray, float]:
    """(weights [resamples, N] of the values in each resampled mean, factor from its standard deviation to half)."""
    from scipy.stats import t

    rng = np.random.default_rng(0)
    found = np.asarray(scene_of if max(scene_of) else range(len(scene_of)))
    n = int(found.max()) + 1
    members = [np.flatnonzero(found == i) for i in range(n)]
    counts = np.zeros((_RESAMPLES, len(found)))
    rows = np.arange(_RESAMPLES)
    for chosen in rng.integers(n, size=(n, _RESAMPLES)):
        for i, mine in enumerate(members):
            drawn = rows[chosen == i]
            picks = mine[rng.integers(len(mine), size=(len(drawn), len(mine)))]
            np.add.at(counts, (drawn[:, None], picks), 1)
    factor = math.sqrt(n / (n - 1)) * float(t.ppf(0.5 + _LEVEL / 2, n - 1))
    return counts / counts.sum(1, keepdims=True), factor
