"""How much of a motion is seen: a run's change of the picture beside that of the exact motion.

Displacement of means misses motion that is shown by opacity or colour, and SSIM is high where nothing moves. So two
more figures: the closure, where SSIM lies between "nothing moves" (0) and the ceiling (1); and the slope and remainder
of a regression of the picture's change on the ceiling's change, both from the same Gaussians at rest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tg4mm.capture import Capture
from tg4mm.fit.gaussians import Gaussians
from tg4mm.research.evaluate.scores import Key, Method, camera_key, pose, render_views

_CAMERAS_AT_ONCE = 8  # images held of each method


def closure(ours: float, static: float, ceiling: float) -> float | None:
    """(ours − static) / (ceiling − static); None where the ceiling is no better than nothing moving."""
    return (ours - static) / (ceiling - static) if ceiling > static else None


def change_figures(
    gaussians: Gaussians,
    ours: Method,
    ceiling: Method,
    capture: Capture,
    alpha: float,
    update: Callable[[int], None] = lambda done: None,
) -> dict[str, float | None]:
    """`change_gain` and `change_residual` over the capture's pictures, magnified by α; None where nothing changes.

    With a and c the changes of picture that `ours` and `ceiling` make (all pixels and colours, white background):
    gain g = Σ a·c / Σ c², residual rms(a − g c) / rms(c). The exact motion has 1 and 0, nothing moving 0 and 0, a
    change that has nothing to do with the motion 0 and its own size. `update(done)` counts pictures.
    """
    products = np.zeros(3)  # a·a, a·c, c·c
    known: dict[Key, np.ndarray] = {}
    rest = Method("rest", None)
    for t in np.unique(capture.timesteps).tolist():
        rows = np.flatnonzero(capture.timesteps == t)
        states = ours.state(t, alpha), ceiling.state(t, alpha)
        keys = {int(i): (*states, camera_key(capture, int(i))) for i in rows}
        todo = [i for i, key in keys.items() if key not in known]
        for first in range(0, len(todo), _CAMERAS_AT_ONCE):
            some = todo[first : first + _CAMERAS_AT_ONCE]
            shown = [
                render_views(pose(gaussians, method, t, alpha), capture, np.array(some)).astype(np.float64)
                for method in (ours, ceiling, rest)
            ]
            a, c = shown[0] - shown[2], shown[1] - shown[2]
            for k, i in enumerate(some):
                known[keys[i]] = np.array([(a[k] ** 2).sum(), (a[k] * c[k]).sum(), (c[k] ** 2).sum()])
        products += sum(known[key] for key in keys.values())
        update(int(np.sum(capture.timesteps <= t)))
    aa, ac, cc = products
    if not cc > 0:
        return {"change_gain": None, "change_residual": None}
    gain = float(ac / cc)
    return {"change_gain": gain, "change_residual": float(np.sqrt(max(aa - gain * ac, 0) / cc))}
