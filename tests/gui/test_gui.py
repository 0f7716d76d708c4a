"""The extension in the real Blender, by mouse: import, the tab, the slider, playback.

One Blender for all of it; each test goes on from the one before. `make test-gui` builds what is needed and runs it.
"""

import itertools
import os
import time
from pathlib import Path

import numpy as np
import pytest

from tg4mm.core.splatfile import positions_at

from . import sidebar
from .conftest import SPLAT, drum
from .session import missing

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.environ.get("TG4MM_GUI") != "1",
        reason=f"drives the real Blender on a virtual screen: make test-gui ({missing() or 'ready'})",
    ),
]
SAME = 2e-5  # scene units, of a scene 2 units wide


@pytest.fixture(scope="module")
def splat():
    return drum()


def cut(picture, box):
    """The part of a picture [H, W, 3] inside a box."""
    return picture[box.top : box.top + box.height, box.left : box.left + box.width]


def is_blank(picture):
    """True where nearly all pixels are alike, black or otherwise: software OpenGL that failed, a dead screen."""
    if picture.size == 0:
        return True
    _, counts = np.unique(picture.reshape(-1, 3) // 8, axis=0, return_counts=True)
    return bool(counts.max() > 0.97 * counts.sum())


def changed(a, b, by=12):
    """Share of the pixels of which some channel differs by more than `by` of 255."""
    return float((np.abs(a.astype(int) - b.astype(int)).max(axis=2) > by).mean())


def view_of(blender, picture):
    """The middle of the 3D view, between the tools and the sidebar."""
    box = blender.region("VIEW_3D")
    sides = blender.region("VIEW_3D", "UI").width + 60
    return picture[box.top + 90 : box.top + box.height, box.left + 100 : box.left + box.width - sides]


def expected(blender, splat):
    """[N, 3] by the core's formula, for the frame and the inputs that Blender has now."""
    inputs = blender.ask("inputs")
    band = inputs["Band Low"], inputs["Band High"]
    return positions_at(splat, blender.ask("frame")["current"] - 1, inputs["Magnification"], band)


def test_the_window_opens_and_the_extension_raises_nothing(blender, pictures):
    assert blender.value("bpy.app.version[:2]") == [5, 2]
    assert not is_blank(blender.picture(pictures / "01_start.png"))
    assert blender.complaints() == []


def test_the_import_menu_reads_the_file(blender, splat, pictures):
    blender.ask("clear")
    assert sidebar.import_by_menu(blender, SPLAT) == Path(SPLAT).stem
    blender.ask("view", look_from=[0.3, -1.0, 0.7], at=[0, 0, 0], distance=4.5)
    frame = blender.ask("frame")
    assert (frame["first"], frame["last"], frame["fps"]) == (1, splat.n_timesteps, splat.fps)
    np.testing.assert_allclose(blender.places(), expected(blender, splat), atol=SAME)
    assert not is_blank(view_of(blender, blender.picture(pictures / "02_imported.png")))


def test_the_tab_opens_in_the_sidebar(blender, pictures):
    sidebar.open_tab(blender)
    time.sleep(0.5)
    picture = blender.picture(pictures / "03_tab.png")
    assert not is_blank(cut(picture, blender.region("VIEW_3D", "UI")))
    assert blender.complaints() == []


def test_dragging_the_alpha_slider_moves_the_points(blender, splat, pictures):
    before, first = blender.places(), blender.picture(pictures / "04_before.png")
    alpha = sidebar.drag_value(blender, "Magnification", 150)
    assert alpha > 0.5
    now = blender.places()
    np.testing.assert_allclose(now, expected(blender, splat), atol=SAME)
    grown = (now - splat.means)[:, 2], (before - splat.means)[:, 2]
    np.testing.assert_allclose(grown[0], (1 + alpha) * grown[1], atol=SAME)
    assert np.abs(grown[1]).max() > 0.005  # there was something to grow
    second = blender.picture(pictures / "05_dragged.png")
    assert changed(view_of(blender, first), view_of(blender, second)) > 0.01
    assert blender.complaints() == []


def test_the_timeline_plays(blender, splat, pictures):
    box = blender.region("VIEW_3D")
    blender.move(box.left + 300, box.top + 500)
    blender.key("space")
    blender.wait(lambda: blender.ask("frame")["playing"], "playback")
    shots, sides, frames = [], [], []
    for i in range(4):
        frames.append(blender.ask("frame")["current"])
        picture = blender.picture(pictures / f"07_playing_{i}.png")
        shots.append(view_of(blender, picture))
        sides.append(cut(picture, blender.region("VIEW_3D", "UI")))
        blender.wait(lambda: blender.ask("frame")["current"] != frames[-1], "the next frame")
        time.sleep(0.37)  # no multiple of either period
    blender.key("space")
    blender.wait(lambda: not blender.ask("frame")["playing"], "the end of playback")
    assert len(set(frames)) > 1
    assert all(changed(a, b) > 0.005 for a, b in itertools.pairwise(shots))
    assert (sides[0] != sides[-1]).any()  # the time in the panel Motion
    np.testing.assert_allclose(blender.places(), expected(blender, splat), atol=SAME)
    assert blender.complaints() == [], blender.log()
