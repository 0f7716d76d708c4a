"""What moves or changes by itself, said: where, when, and how often."""

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from tg4mm.capture.look.model import Mover
from tg4mm.capture.look.scene import Scene
from tg4mm.capture.look.spectra import tones_of

_FEWEST, _LONGEST = 8, 2  # cells × pictures of something that passes, and pictures it takes at least


def movers_of(scene: Scene) -> tuple[Mover, ...]:
    """Wheels, leaves and the like, then what passes."""
    return (*_all_along(scene), *_passing(scene))


def _all_along(scene: Scene) -> Iterator[Mover]:
    labels, _ = ndimage.label(scene.grid.picture(scene.masks.core), np.ones((3, 3)))
    for k in range(1, labels.max() + 1):
        cells = (labels == k).ravel()
        changes = np.log(scene.series.misfit[:, cells].mean(1) + 1e-9)
        brightness = np.nan_to_num(scene.series.gain[:, cells].mean(1))
        found = [
            tone for y in (brightness, changes) for tone in tones_of(y, scene.times_s, scene.nuisance, most=1)
        ]
        hz, deviation, _ = min(found, key=lambda tone: tone[1], default=(None, None, 0.0))
        yield Mover("moves by itself", scene.grid.box(cells), hz, deviation, 0.0, float(scene.times_s[-1]))


def _passing(scene: Scene) -> Iterator[Mover]:
    passed, size = scene.grid.picture(scene.masks.passed), scene.grid.size
    labels, _ = ndimage.label(passed, np.ones((3, 3, 3)))
    for k, where in enumerate(ndimage.find_objects(labels), 1):
        times, rows, columns = where
        if (labels[where] == k).sum() >= _FEWEST and times.stop - times.start > _LONGEST:
            box = (columns.start * size, rows.start * size, columns.stop * size, rows.stop * size)
            first, last = scene.times_s[times.start], scene.times_s[times.stop - 1]
            yield Mover("passes", box, from_s=float(first), until_s=float(last))
