"""A measurement beside the painter: pictures go on being drawn whatever numba's threads allow."""

from __future__ import annotations

import threading

import numba
import numpy as np
import pytest

from tg4mm.show.view.painter import Look, Painter
from tg4mm.show.view.scene import Scene


def test_pictures_are_drawn_at_the_moments_that_a_measurement_gives(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    painter, drawn = Painter(scene), threading.Event()
    monkeypatch.setattr(numba, "threading_layer", lambda: "workqueue")
    camera = scene.cameras[0]

    def draw() -> None:
        assert painter.paint(Look(), 0.0, camera).dtype == np.uint8
        drawn.set()

    with painter.beside() as let_paint:
        thread = threading.Thread(target=draw)
        thread.start()
        assert not drawn.wait(0.5)  # the kernels are the measurement's
        for _ in range(200):
            let_paint()
            if drawn.is_set():
                break
        assert drawn.is_set()
    thread.join()
