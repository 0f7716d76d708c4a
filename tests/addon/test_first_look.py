"""What an import looks like at once, without a setting; the exact look and back; legends like the object."""

from dataclasses import replace

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.colour import to_display
from tg4mm.core.splatfile import read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import evaluated, import_splat, read, setter, shown_colours  # noqa: E402  # noqa: E402

NATIVE = hasattr(bpy.types, "GeometryNodePointsSetType")


def test_splats_blend_as_trained_on_demand_and_newcomers_with_them(extension, splat_path):
    """All splats of a scene have one way to blend, and the view transform is that which it needs."""
    scene, names, compat = bpy.context.scene, extension.names, extension.compat
    first = import_splat(splat_path)
    linear = shown_colours(first)
    assert bpy.ops.tg4mm.blend_as_trained(on=True) == {"FINISHED"}
    assert scene.view_settings.view_transform == "Raw"
    np.testing.assert_allclose(shown_colours(first), to_display(linear), atol=2e-5)
    second = import_splat(splat_path)
    assert scene.view_settings.view_transform == "Raw"
    modifiers = [extension.nodes.scene.splat_modifier(obj) for obj in (first, second)]
    assert [compat.get_input(modifier, names.BLEND) for modifier in modifiers] == [True, True]
    assert bpy.ops.tg4mm.blend_as_trained(on=False) == {"FINISHED"}
    assert scene.view_settings.view_transform == "Standard"
    np.testing.assert_array_equal(shown_colours(first), linear)
    assert [compat.get_input(modifier, names.BLEND) for modifier in modifiers] == [False, False]


def test_legend_is_of_the_palette_where_splats_blend_as_trained(extension, splat_path):
    obj, scene, seen = import_splat(splat_path), bpy.context.scene, extension.panels.analysis
    setter(extension, obj)(extension.names.COLOUR_BY, extension.names.AMPLITUDE_COLOUR)
    unit = extension.preferences.unit_for(bpy.context, obj)
    before = extension.panels.analysis.legend_picture(obj, unit, scene)
    bpy.ops.tg4mm.blend_as_trained(on=True)
    assert extension.panels.analysis.legend_picture(obj, unit, scene) == before
    encoded = to_display(extension.nodes.colours.amplitude_map())
    np.testing.assert_allclose(seen.through_view(encoded, scene), encoded, atol=2e-3)
    scene.view_settings.exposure = -1.0
    seen.work_out(scene.name, True)
    assert np.array(seen.amplitude(scene, True)).mean() < 0.7 * encoded.mean()


@pytest.mark.parametrize("transform", ["Standard", "AgX"])
def test_legend_goes_through_the_scenes_view_transform(extension, transform):
    scene, seen = bpy.context.scene, extension.panels.analysis
    scene.view_settings.view_transform = transform
    linear = extension.nodes.colours.amplitude_map()
    found = seen.through_view(linear, scene)
    standard = to_display(linear)
    if transform == "Standard":
        np.testing.assert_allclose(found, standard, atol=2e-3)
    else:
        assert np.abs(found - standard).max() > 0.1
    assert not bpy.data.images
    seen.work_out(scene.name)
    np.testing.assert_allclose(seen.amplitude(scene), found, atol=2e-3)
    assert len(seen.phase(scene)) == len(extension.nodes.colours.phase_and_still())


@pytest.mark.parametrize(
    ("speed", "words"),
    [
        (1.0, "real time"),
        (0.1, "10 × slower"),
        (2.0, "2 × faster"),
        (-0.5, "backwards, 2 × slower"),
        (0.0, "stopped"),
    ],
)
def test_the_panel_says_real_seconds(extension, splat_path, speed, words):
    obj = import_splat(splat_path)
    setter(extension, obj)(extension.names.SPEED, speed)
    scene = bpy.context.scene
    scene.frame_set(13)
    said = extension.nodes.clock.lines(scene, obj, extension.nodes.scene.splat_modifier(obj))
    assert said[0] == f"{max(0.0, 0.5 * speed):.3f} s of 2.000 s, {words}"
    assert any("Before the recording" in line for line in said) == (speed < 0)


def test_the_time_never_passes_the_recordings_length(extension, splat_path):
    obj, scene = import_splat(splat_path), bpy.context.scene
    setter(extension, obj)(extension.names.SPEED, 1.0)
    for frame, time, outside in ((49, "2.000", False), (500, "2.000", True), (-3, "0.000", True)):
        scene.frame_set(frame)
        said = extension.nodes.clock.lines(scene, obj, extension.nodes.scene.splat_modifier(obj))
        assert said[0].startswith(f"{time} s of 2.000 s")
        assert any("the recording: motion continues" in line for line in said) == outside


needs_native = pytest.mark.skipif(not NATIVE, reason="this Blender has no splats of its own")


@pytest.fixture
def automatic(extension, monkeypatch):
    """The extension as it is for who set nothing."""
    monkeypatch.setattr(extension.preferences.TG4MM_defaults, "draw_as", extension.nodes.drawing.AUTOMATIC)
    return extension


def drawn(extension, obj, name=None):
    modifier = extension.nodes.scene.splat_modifier(obj)
    return extension.compat.get_input(modifier, name or extension.names.DRAW)


def test_an_import_is_drawn_as_suits_it(automatic, splat_path):
    assert drawn(automatic, import_splat(splat_path)) == ("Native" if NATIVE else "Splats")


def test_more_gaussians_are_drawn_more_simply(extension, monkeypatch):
    best = extension.nodes.drawing.best
    monkeypatch.setattr(extension.compat, "native_splats", lambda: False)
    ways = [best(count, 1) for count in (1_000, 50_000, 1_000_000)]
    assert ways == ["Splats", "Splats", "Points"]
    order = list(extension.nodes.shapes.DRAW_MODES)
    for count in (10_000, 30_000, 80_000):
        costs = [("Splats", "Ellipsoids", "Points").index(best(count, modes)) for modes in (0, 1, 15, 64)]
        assert costs == sorted(costs)
    monkeypatch.setattr(extension.compat, "native_splats", lambda: True)
    assert best(1_000_000, 15) == order[-1] == "Native"


def test_the_exact_look_and_back(automatic, splat_path):
    scene, names = bpy.context.scene, automatic.names
    obj = import_splat(splat_path)
    way = (names.DRAW, names.VIEW_COLOUR, names.BLEND)
    before = [drawn(automatic, obj, name) for name in way]
    assert not automatic.panels.look.is_exact(obj)
    assert bpy.ops.tg4mm.exact_look() == {"FINISHED"}
    assert [drawn(automatic, obj, name) for name in way] == ["Splats", True, True]
    assert scene.view_settings.view_transform == "Raw"
    assert automatic.panels.look.is_exact(obj)
    assert bpy.ops.tg4mm.exact_look(on=False) == {"FINISHED"}
    assert [drawn(automatic, obj, name) for name in way] == before
    assert scene.view_settings.view_transform == "Standard"


def test_what_the_scene_needs_is_set_said_and_undone(automatic, splat_path):
    scene, blending = bpy.context.scene, automatic.nodes.blending
    scene.view_settings.view_transform, scene.view_settings.exposure = "AgX", 1.5
    scene.cycles.transparent_max_bounces, scene.cycles.samples = 8, 4
    scene.eevee.taa_render_samples = 16
    import_splat(splat_path, colours=False)
    assert not blending.is_set_up(scene)
    assert blending.true_colours(scene) > 3
    assert blending.is_set_up(scene)
    listed = automatic.nodes.changes.listed(scene)
    assert {"View transform: AgX → Standard", "Exposure: 1.5 → 0", "Cycles bounces: 8 → 1024"} <= set(listed)
    assert ("Cycles samples: 4 → 64" in listed) == NATIVE
    assert (scene.cycles.samples, scene.eevee.taa_render_samples) == ((64, 64) if NATIVE else (4, 16))
    assert blending.true_colours(scene) == 0
    bpy.ops.tg4mm.exact_look()
    assert bpy.ops.tg4mm.restore_picture() == {"FINISHED"}
    assert (scene.view_settings.view_transform, scene.view_settings.exposure) == ("AgX", 1.5)
    assert (scene.cycles.transparent_max_bounces, scene.cycles.samples) == (8, 4)
    assert scene.eevee.taa_render_samples == 16
    assert not blending.blends_as_trained(scene)
    assert automatic.nodes.changes.BEFORE not in scene


def test_all_that_an_import_sets_is_listed_and_restored(extension, splat_path):
    """Frame rate and range, engines, shading and camera; the startup cube stays hidden; the message is short."""
    bpy.ops.wm.read_factory_settings()
    scene, changes, names = bpy.context.scene, extension.nodes.changes, extension.names
    camera, cube, areas = *map(bpy.data.objects.get, ("Camera", "Cube")), bpy.context.window.screen.areas
    scene.render.fps, scene.render.fps_base = 30, 1.001

    def state():
        paths = [path for path in changes._LABELS if changes.get(scene, path) is not None]
        clips = camera.data.clip_start, camera.data.clip_end
        views = [area.spaces.active.shading.type for area in areas if area.type == "VIEW_3D"]
        here = tuple(camera.location), clips, views
        return {path: changes.get(scene, path) for path in paths}, here

    before = state()
    obj = import_splat(splat_path)
    lines = changes.listed(scene)
    assert {"Frame rate: 29.97 → 24", "Last frame: 250 → 144", "Moved: Camera"} <= set(lines)
    assert {"View transform: AgX → Standard", "Viewport shading: SOLID → MATERIAL"} <= set(lines)
    assert not {line for line in lines if "First frame" in line}
    assert obj[names.NOTES] == "Hid the start-up Cube, in the way"
    assert len(extension.io.import_splat.SEE) < 60
    assert state() != before
    assert bpy.ops.tg4mm.restore_picture() == {"FINISHED"}
    assert state() == before
    assert changes.listed(scene) == []
    assert (cube.hide_get(), cube.hide_render) == (True, True)


@needs_native
def test_native_shows_amplitude_and_phase(extension, splat_path):
    """As the other ways to draw show them: 0.5 + C0·base is the colour's sRGB."""
    obj, names = import_splat(splat_path), extension.names
    put, n = setter(extension, obj), len(read_splat(splat_path))
    put(names.MIN_OPACITY, 0.0)
    for by in (names.AMPLITUDE_COLOUR, names.PHASE_COLOUR):
        put(names.COLOUR_BY, by)
        put(names.DRAW, "Ellipsoids")
        geometry = evaluated(obj, 5)
        shown = read(geometry.instances_pointcloud(), "colour", "color", 4)[:, :3]
        put(names.DRAW, "Native")
        geometry = evaluated(obj, 5)
        cloud = geometry.pointcloud
        base = read(cloud, names.NATIVE_BASE, "color", 4)[:n]
        srgb = 0.5 + 0.28209479177387814 * base[:, :3]
        np.testing.assert_allclose(srgb, to_display(shown), atol=1e-5)
        np.testing.assert_allclose(base[:, 3], read_splat(splat_path).opacities, atol=1e-7)
        assert not [a.name for a in cloud.attributes if a.name.startswith("radiance:sh")]
    put(names.COLOUR_BY, names.FILE_COLOUR)
    geometry = evaluated(obj, 5)
    assert "radiance:sh_0" in geometry.pointcloud.attributes


def test_what_is_far_out_is_counted(extension, tmp_path):
    """Where it makes 22 bits of the extent coarser than a tenth of a pixel of 2,048."""
    splat = some_splat(200)
    opacities = np.ones(200, np.float32)
    for far, count in ((100.0, 0), (1e4, 2)):
        means = splat.means.copy()
        means[3], means[7] = (far, 0, 0), (0, -far, 0)
        write_splat(tmp_path / "far.ply", replace(splat, means=means, opacities=opacities))
        obj = import_splat(tmp_path / "far.ply")
        found, span = extension.nodes.drawing.far_out(obj.data)
        low, high = np.percentile(means, (1, 99), axis=0)
        assert found == count
        assert span == pytest.approx(np.ptp(means, axis=0).max() / (high - low).max(), rel=1e-5)
    assert span / 2**22 > 0.1 / 2048
