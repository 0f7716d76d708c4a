"""The extension in the real Blender, by mouse: import, the tab, the slider, playback, display modes.

One Blender for all of it; each test goes on from the one before. `make test-gui` builds what is needed and runs it.
"""

import itertools
import os
import time
from pathlib import Path

import numpy as np
import pytest

from tg4mm.core.splatfile import SplatFile, positions_at

from . import looking, sidebar
from .conftest import SPLAT, drum
from .session import ACTIVE, OBJECTS, missing

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.environ.get("TG4MM_GUI") != "1",
        reason=f"drives the real Blender on a virtual screen: make test-gui ({missing() or 'ready'})",
    ),
]
BESIDE = 0.75  # of the sidebar's width: the buttons beside the spectrum
F12 = "96"  # its number: by its name xdotool presses it with Alt
SAME = 2e-5  # scene units, of a scene 2 units wide


@pytest.fixture(scope="module")
def splat():
    return drum()


def view_of(blender, picture):
    """The middle of the 3D view, between the tools and the sidebar."""
    box = blender.region("VIEW_3D")
    sides = blender.region("VIEW_3D", "UI").width + 60
    return picture[box.top + 90 : box.top + box.height, box.left + 100 : box.left + box.width - sides]


def still_view(blender, path):
    """The same of a new screenshot, without a tooltip, once the screen is still."""
    blender.move(*blender.region("DOPESHEET_EDITOR").middle)
    time.sleep(1.0)
    return view_of(blender, blender.settled(path))


def expected(blender, splat):
    """[N, 3] by the core's formula, for the frame and the inputs that Blender has now."""
    inputs = blender.ask("inputs")
    band = inputs["Band Low"], inputs["Band High"]
    return positions_at(splat, blender.ask("frame")["current"] - 1, inputs["Magnification"], band)


def test_the_window_opens_and_the_extension_raises_nothing(blender, pictures):
    assert blender.value("bpy.app.version[:2]") == [5, 2]
    assert not looking.is_blank(blender.picture(pictures / "01_start.png"))
    assert blender.complaints() == []


def test_the_import_menu_reads_the_file(blender, splat, pictures):
    blender.ask("clear")
    assert sidebar.import_by_menu(blender, SPLAT) == Path(SPLAT).stem
    blender.ask("view", look_from=[0.3, -1.0, 0.7], at=[0, 0, 0], distance=4.5)
    frame = blender.ask("frame")
    assert (frame["first"], frame["last"], frame["fps"]) == (1, splat.n_timesteps, splat.fps)
    np.testing.assert_allclose(blender.places(), expected(blender, splat), atol=SAME)
    assert not looking.is_blank(view_of(blender, blender.picture(pictures / "02_imported.png")))


def test_the_tab_opens_in_the_sidebar(blender, pictures):
    sidebar.open_tab(blender)
    time.sleep(0.5)
    picture = blender.picture(pictures / "03_tab.png")
    assert not looking.is_blank(looking.cut(picture, blender.region("VIEW_3D", "UI")))
    assert blender.complaints() == []


def test_dragging_the_alpha_slider_moves_the_points(blender, splat, pictures):
    before = blender.places()
    alpha = sidebar.drag_value(blender, "Magnification", 150)
    assert alpha > 0.5
    now = blender.places()
    np.testing.assert_allclose(now, expected(blender, splat), atol=SAME)
    grown = (now - splat.means)[:, 2], (before - splat.means)[:, 2]
    np.testing.assert_allclose(grown[0], (1 + alpha) * grown[1], atol=SAME)
    assert np.abs(grown[1]).max() > 0.005  # there was something to grow
    blender.picture(pictures / "04_dragged.png")


def test_a_typed_alpha_shows_in_the_view(blender, splat, pictures):
    first = blender.picture(pictures / "05_before_typing.png")
    sidebar.type_value(blender, "Magnification", "25")
    np.testing.assert_allclose(blender.places(), expected(blender, splat), atol=SAME)
    second = blender.picture(pictures / "06_alpha_25.png")
    assert looking.changed(view_of(blender, first), view_of(blender, second)) > 0.01
    assert blender.complaints() == []


def test_the_timeline_plays(blender, splat, pictures):
    box = blender.region("VIEW_3D")
    blender.move(box.left + 300, box.top + 500)
    blender.key("space")
    blender.wait(lambda: blender.ask("frame")["playing"], "playback")
    shots, frames = [], []
    for i in range(4):
        frames.append(blender.ask("frame")["current"])
        shots.append(view_of(blender, blender.picture(pictures / f"07_playing_{i}.png")))
        blender.wait(lambda: blender.ask("frame")["current"] != frames[-1], "the next frame")
        time.sleep(0.37)  # no multiple of either period
    blender.key("space")
    blender.wait(lambda: not blender.ask("frame")["playing"], "the end of playback")
    assert len(set(frames)) > 1
    assert all(looking.changed(a, b) > 0.005 for a, b in itertools.pairwise(shots))
    np.testing.assert_allclose(blender.places(), expected(blender, splat), atol=SAME)


def test_a_band_that_is_typed_magnifies_what_is_in_it(blender, splat, pictures):
    sidebar.type_value(blender, "Band High", "3")
    alone = SplatFile(**{**vars(splat), "displacement": splat.displacement * [[[26]], [[1]]]})
    at = positions_at(alone, blender.ask("frame")["current"] - 1)
    assert blender.ask("inputs")["Magnification"] == 25.0
    np.testing.assert_allclose(blender.places(), at, atol=SAME)
    blender.picture(pictures / "08_band.png")
    sidebar.press(blender, "bpy.ops.tg4mm.band(frequency=5)", at=BESIDE)
    blender.wait(lambda: blender.ask("inputs")["Band Low"] == 4.5, "the band round the second peak")
    sidebar.press(blender, "bpy.ops.tg4mm.band(frequency=0)", at=BESIDE)  # All
    blender.wait(lambda: blender.ask("inputs")["Band High"] > 5, "the whole band")


def test_solid_view_takes_colours(blender, pictures):
    blender.ask("shading", kind="SOLID")  # an import leaves it, and the button with it
    grey = still_view(blender, pictures / "09_grey.png")
    sidebar.press(blender, "bpy.ops.tg4mm.solid_colours(on=True)")
    blender.wait(lambda: blender.ask("inputs")["Solid View Colours"], "colours in Solid view")
    colours = still_view(blender, pictures / "10_solid_colours.png")
    assert looking.coloured(colours) > looking.coloured(grey) + 0.05


def test_display_modes_look_different(blender, pictures):
    shots = {}
    for mode in ("Points", "Arrows", "Splats", "Ellipsoids"):
        sidebar.choose(blender, "Draw As", mode)
        shots[mode] = still_view(blender, pictures / f"11_{mode.lower()}.png")
        assert not looking.is_blank(shots[mode])
    for mode in shots:  # Solid view has no transparency: splats are ellipsoids there
        assert looking.coloured(shots[mode]) > 0.02, mode
    for mode in ("Points", "Arrows"):
        assert looking.changed(shots[mode], shots["Ellipsoids"]) > 0.01, mode
    assert blender.complaints() == []


def test_colours_show_amplitude_and_phase(blender, pictures):
    shots = []
    for by in ("File", "Amplitude", "Phase"):
        sidebar.choose(blender, "Colour By", by)
        shots.append(still_view(blender, pictures / f"12_{by.lower()}.png"))
    assert looking.changed(shots[0], shots[1]) > 0.02
    assert looking.changed(shots[1], shots[2]) > 0.02
    sidebar.choose(blender, "Colour By", "File")


def test_the_probe_reads_what_is_in_a_sphere(blender, splat, pictures):
    sidebar.press(blender, "bpy.ops.tg4mm.add_probe_sphere()", at=0.83)
    blender.wait(lambda: "drum probe" in blender.value(OBJECTS), "a sphere")
    sidebar.press(blender, "bpy.ops.tg4mm.probe(source='SPHERE')")
    blender.wait(lambda: blender.ask("probed")["label"] is not None, "a reading")
    found = blender.ask("probed")
    radius = 0.05 * np.linalg.norm(np.ptp(splat.means, axis=0))
    inside = np.linalg.norm(splat.means, axis=1) <= radius
    assert found["label"] == f"{inside.sum()} points"
    mean = splat.displacement[:, inside].mean(axis=1)  # all alike opaque
    read = np.array(found["phasors"]).reshape(2, 3, 2)
    np.testing.assert_allclose(read[..., 0] + 1j * read[..., 1], mean, atol=1e-6)
    assert mean[0, 2].real > 0.015
    blender.move(*blender.region("DOPESHEET_EDITOR").middle)
    time.sleep(1.0)
    blender.picture(pictures / "14_probe.png")
    blender.run(f"{ACTIVE} = bpy.data.objects['drum']")


@pytest.mark.parametrize("engine", ["CYCLES", "BLENDER_EEVEE"])
def test_f12_renders_the_splats(blender, pictures, engine):
    blender.ask("prepare_render", engine=engine, size=[160, 120], frames=[3, 5], to="frame_")
    blender.move(*blender.region("VIEW_3D").middle)
    blender.key(F12)
    name = f"15_f12_{engine.lower()}.png"
    wait_for_render(blender, lambda: blender.ask("save_rendered", file=name))
    picture = blender.take(name, pictures / name)
    assert picture.shape[:2] == (120, 160)
    assert looking.coloured(picture) > 0.1


def test_an_animation_renders_frames_that_differ(blender, pictures):
    blender.ask("prepare_render", engine="CYCLES", size=[160, 120], frames=[3, 5], to="frame_")
    blender.move(*blender.region("VIEW_3D").middle)
    blender.key(f"ctrl+{F12}")
    names = [f"frame_{frame:04d}.png" for frame in (3, 4, 5)]
    wait_for_render(blender, lambda: all((blender.folder / name).exists() for name in names))
    shots = [blender.take(name, pictures / f"16_{name}") for name in names]
    assert all(looking.changed(a, b) > 0.02 for a, b in itertools.pairwise(shots))
    assert blender.complaints() == []


def wait_for_render(blender, done):
    """Wait until a render that was begun by a key has ended and left what it should."""
    blender.wait(
        lambda: not blender.value("bpy.app.is_job_running('RENDER')") and done(), "the render", 300.0, 0.5
    )


def test_a_file_is_dropped_into_the_view(blender, splat, pictures):
    before = blender.value(OBJECTS)
    blender.drop(SPLAT, *blender.region("VIEW_3D").middle)
    time.sleep(1.0)
    blender.picture(pictures / "17_drop_menu.png")
    blender.key("t")  # "Import TG4MM Splats"; Blender has an importer of PLY meshes too, and asks
    blender.wait(lambda: len(blender.value(OBJECTS)) == len(before) + 1, "the dropped file's object", 60.0)
    assert blender.value(f"{ACTIVE}.name") == "drum.001"
    np.testing.assert_allclose(blender.places(), expected(blender, splat), atol=SAME)
    blender.picture(pictures / "18_dropped.png")
    blender.move(*blender.region("VIEW_3D").middle)
    blender.key("ctrl+z")
    blender.wait(lambda: blender.value(OBJECTS) == before, "the import to be undone")
    blender.run(f"{ACTIVE} = bpy.data.objects['drum']")


def test_undo_takes_the_last_change_back(blender):
    sidebar.type_value(blender, "Magnification", "3")
    blender.move(*blender.region("VIEW_3D").middle)
    blender.key("ctrl+z")
    blender.wait(lambda: blender.ask("inputs")["Magnification"] == 25.0, "the magnification before")


def test_nothing_was_complained_about(blender):
    assert blender.complaints() == [], blender.log()
