"""What an import shows at once: true colours, the object framed, the spectrum; legends like the object."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tg4mm.core.colour import STILL, amount_colours, phase_colours, phase_share, to_display
from tg4mm.core.splatfile import read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import import_splat, setter, shown_colours  # noqa: E402


def test_splats_blend_as_trained_on_demand_and_newcomers_with_them(
    extension: ModuleType, splat_path: Path
) -> None:
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


def test_report_viewer_and_blender_have_one_palette(extension: ModuleType, splat_path: Path) -> None:
    """The colours of the points, encoded for the screen, are those of the report's maps."""
    splat = read_splat(splat_path)
    obj = import_splat(splat_path)
    put, names, colours = setter(extension, obj), extension.names, extension.nodes.colours
    put(names.MIN_OPACITY, 0.0)
    for name in ("3 Hz", "7.5 Hz"):
        put(name, False)
    phasors = splat.displacement[1]
    amplitude, turns = extension.nodes.points.strength(phasors, extension.nodes.points.main_axis(phasors))
    top = float(amplitude.max())
    put(names.COLOUR_RANGE, top)
    put(names.COLOUR_BY, names.AMPLITUDE_COLOUR)
    shown = to_display(shown_colours(obj))
    np.testing.assert_allclose(shown, amount_colours(amplitude / top), atol=0.01)
    put(names.COLOUR_BY, names.PHASE_COLOUR)
    share = phase_share(amplitude / top)[:, None]
    linear = share * colours.to_linear(phase_colours(2 * np.pi * turns)) + (1 - share) * colours.to_linear(
        np.array(STILL)
    )
    np.testing.assert_allclose(shown_colours(obj), linear, atol=0.01)


def test_legend_is_of_the_palette_where_splats_blend_as_trained(
    extension: ModuleType, splat_path: Path
) -> None:
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
def test_legend_goes_through_the_scenes_view_transform(extension: ModuleType, transform: str) -> None:
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


def test_what_is_framed_holds_the_opaque_gaussians(
    extension: ModuleType, splat_path: Path, tmp_path: Path
) -> None:
    splat = read_splat(splat_path)
    means, opacities = splat.means.copy(), np.ones(len(splat), np.float32)
    means[0], opacities[0] = 1e4, 0.01
    write_splat(tmp_path / "far.ply", replace(splat, means=means, opacities=opacities))
    obj = import_splat(tmp_path / "far.ply")
    obj.location = (5.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    low, high = extension.panels.framing.box([obj])
    middle, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
    away = np.linalg.norm(means[1:] + [5, 0, 0] - middle, axis=1)
    assert 0.8 * away.max() < radius < 2 * away.max()


def test_spectrum_is_drawn_before_the_panel_asks(extension: ModuleType, splat_path: Path) -> None:
    obj = import_splat(splat_path)
    picture = extension.panels.panel.spectrum_picture(bpy.context, obj)
    assert extension.panels.pictures.shared().pixels(*picture) is not None


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
def test_the_panel_says_real_seconds(
    extension: ModuleType, splat_path: Path, speed: float, words: str
) -> None:
    obj = import_splat(splat_path)
    setter(extension, obj)(extension.names.SPEED, speed)
    scene = bpy.context.scene
    scene.frame_set(13)
    said = extension.nodes.clock.lines(scene, obj, extension.nodes.scene.splat_modifier(obj))
    assert said[0] == f"{0.5 * speed:.3f} s of 2.000 s, {words}"


def test_too_few_frames_for_a_frequency_are_told(extension: ModuleType, splat_path: Path) -> None:
    obj, scene = import_splat(splat_path), bpy.context.scene
    put, lines = setter(extension, obj), extension.nodes.clock.lines
    modifier = extension.nodes.scene.splat_modifier(obj)
    assert lines(scene, obj, modifier)[1] == "3.2 frames a period at 7.5 Hz"
    put(extension.names.HIGH, 5.5)
    assert len(lines(scene, obj, modifier)) == 1
