"""What an import looks like in this Blender without a setting, and the way to the exact look and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.splatfile import read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import evaluated, import_splat, read, setter  # noqa: E402
from tg4mm.core.colour import to_display  # noqa: E402

NATIVE = hasattr(bpy.types, "GeometryNodePointsSetType")
needs_native = pytest.mark.skipif(not NATIVE, reason="this Blender has no splats of its own")


@pytest.fixture
def automatic(extension: ModuleType, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The extension as it is for who set nothing."""
    monkeypatch.setattr(extension.preferences.TG4MM_defaults, "draw_as", extension.nodes.drawing.AUTOMATIC)
    return extension


def drawn(extension: ModuleType, obj: Any, name: str | None = None) -> Any:
    modifier = extension.nodes.scene.splat_modifier(obj)
    return extension.compat.get_input(modifier, name or extension.names.DRAW)


def test_an_import_is_drawn_as_suits_it(automatic: ModuleType, splat_path: Path) -> None:
    assert drawn(automatic, import_splat(splat_path)) == ("Native" if NATIVE else "Splats")


def test_more_gaussians_are_drawn_more_simply(extension: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    best = extension.nodes.drawing.best
    monkeypatch.setattr(extension.compat, "native_splats", lambda: False)
    ways = [best(count, 1) for count in (1_000, 50_000, 1_000_000)]
    assert ways == ["Splats", "Ellipsoids", "Points"]
    order = list(extension.nodes.shapes.DRAW_MODES)
    for count in (10_000, 30_000, 80_000):
        costs = [("Splats", "Ellipsoids", "Points").index(best(count, modes)) for modes in (0, 1, 15, 64)]
        assert costs == sorted(costs)
    monkeypatch.setattr(extension.compat, "native_splats", lambda: True)
    assert best(1_000_000, 15) == order[-1] == "Native"


def test_the_exact_look_and_back(automatic: ModuleType, splat_path: Path) -> None:
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


def test_what_the_scene_needs_is_set_said_and_undone(automatic: ModuleType, splat_path: Path) -> None:
    scene, blending = bpy.context.scene, automatic.nodes.blending
    scene.view_settings.view_transform, scene.view_settings.exposure = "AgX", 1.5
    scene.cycles.transparent_max_bounces, scene.cycles.samples = 8, 4
    scene.eevee.taa_render_samples = 16
    import_splat(splat_path, colours=False)
    assert not blending.is_set_up(scene)
    told = blending.true_colours(scene)
    assert blending.is_set_up(scene)
    assert "view transform set from AgX to Standard, exposure set from 1.5 to 0" in told
    assert "Cycles' transparent bounces set from 8 to 1024" in told
    assert ("Cycles' samples set from 4 to 64" in told) == NATIVE
    assert (scene.cycles.samples, scene.eevee.taa_render_samples) == ((64, 64) if NATIVE else (4, 16))
    assert blending.true_colours(scene) == ""
    bpy.ops.tg4mm.exact_look()
    assert bpy.ops.tg4mm.restore_picture() == {"FINISHED"}
    assert (scene.view_settings.view_transform, scene.view_settings.exposure) == ("AgX", 1.5)
    assert (scene.cycles.transparent_max_bounces, scene.cycles.samples) == (8, 4)
    assert scene.eevee.taa_render_samples == 16
    assert not blending.blends_as_trained(scene)
    assert blending.BEFORE not in scene


def test_samples_are_never_made_fewer(automatic: ModuleType, splat_path: Path) -> None:
    bpy.context.scene.cycles.samples = 500
    import_splat(splat_path)
    assert bpy.context.scene.cycles.samples == 500


@needs_native
def test_native_shows_amplitude_and_phase(extension: ModuleType, splat_path: Path) -> None:
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


@needs_native
def test_size_is_of_native_splats_too(extension: ModuleType, splat_path: Path) -> None:
    obj, names = import_splat(splat_path), extension.names
    put, splat = setter(extension, obj), read_splat(splat_path)
    put(names.DRAW, "Native")
    put(names.SIZE, 2.0)
    geometry = evaluated(obj, 5)
    found = read(geometry.pointcloud, "scale", "vector", 3)[: len(splat)]
    np.testing.assert_allclose(found, 2 * splat.scales, rtol=1e-6)


def test_what_is_far_out_is_counted(extension: ModuleType, tmp_path: Path) -> None:
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
