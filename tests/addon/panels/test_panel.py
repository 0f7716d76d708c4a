"""The sidebar, drawn on a stand-in for Blender's layout: what it offers for each kind of file."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tg4mm.core.splatfile import SplatFile, read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import Layout, import_splat, setter  # noqa: E402


def laid_out(extension, obj, shading="MATERIAL"):
    """Everything the panels show for an object in a view with this shading, in order."""
    layout = Layout()
    context = SimpleNamespace(
        object=obj,
        scene=bpy.context.scene,
        window_manager=bpy.context.window_manager,
        preferences=bpy.context.preferences,
        space_data=SimpleNamespace(shading=SimpleNamespace(type=shading)),
    )
    for cls in (*extension.panels.panel._ui.classes, *extension.probe.picking._ui.classes):
        if not hasattr(cls, "poll") or cls.poll(context):
            cls.draw(SimpleNamespace(layout=layout), context)
    return layout


def drawn(extension, obj):
    """The same without the pictures."""
    return laid_out(extension, obj).drawn


@pytest.mark.parametrize(
    ("scale", "label", "factor"), [(0.1, "Range (mm)", 100.0), (None, "Range (units)", 1.0)]
)
def test_colour_range_is_shown_in_its_unit_with_four_digits(
    extension, tmp_path, splat_path, scale, label, factor
):
    write_splat(tmp_path / "a.ply", SplatFile(**{**vars(read_splat(splat_path)), "unit_scale_m": scale}))
    obj, names = import_splat(tmp_path / "a.ply"), extension.names
    put, module = setter(extension, obj), extension.panels.colour_range
    put(names.COLOUR_BY, names.AMPLITUDE_COLOUR)
    assert label in drawn(extension, obj)
    largest = max(obj[names.MODE_AMPLITUDES]) * factor
    field = module._field(module.decimals_for(largest))
    shown = getattr(obj, field)
    assert shown == pytest.approx(factor * extension.panels.analysis.band_amplitude(obj).max(), rel=1e-5)
    setattr(obj, field, 2 * shown)
    modifier = extension.nodes.scene.splat_modifier(obj)
    assert extension.compat.get_input(modifier, names.COLOUR_RANGE) == pytest.approx(2 * shown / factor)


def test_colours_by_motion_come_with_a_legend(extension, tmp_path, splat_path):
    known = SplatFile(**{**vars(read_splat(splat_path)), "unit_scale_m": 0.1})
    write_splat(tmp_path / "known.ply", known)
    obj, names = import_splat(tmp_path / "known.ply"), extension.names
    put, unit = setter(extension, obj), extension.units.unit_of(0.1)
    assert laid_out(extension, obj).pictures == 1  # the spectrum
    assert extension.panels.analysis.legend_picture(obj, unit, bpy.context.scene) is None
    put(names.COLOUR_BY, names.AMPLITUDE_COLOUR)
    put(names.COLOUR_RANGE, 0.5)
    view = extension.panels.overlay.of(bpy.context)
    assert laid_out(extension, obj).pictures == 1  # the legend is in the view
    view.legend = False
    assert laid_out(extension, obj).pictures == 2  # and now in the panel
    view.legend = True
    plots, picture = extension.panels.plots, extension.panels.analysis.legend_picture
    shown = picture(obj, unit, bpy.context.scene)
    assert shown == (plots.amplitude_legend, 0.5, unit, plots.STANDARD_AMPLITUDE)
    put(names.COLOUR_BY, names.PHASE_COLOUR)
    function, still, _, rows = picture(obj, unit, bpy.context.scene)
    assert (function, still, rows) == (plots.phase_legend, pytest.approx(0.05), plots.STANDARD_PHASE)


def test_probe_shows_rows_a_curve_and_exports(extension, splat_path):
    obj = import_splat(splat_path)
    assert "Nothing probed yet" in drawn(extension, obj)
    assert "tg4mm.export_probe" not in drawn(extension, obj)
    bpy.ops.tg4mm.probe(source="CURSOR")
    layout = laid_out(extension, obj)
    found = extension.probe.picking.stored(obj)
    assert layout.pictures == 2
    assert {f"{found.label}: actual motion", "as recorded, not magnified", "Export Curve (CSV)"} <= set(
        layout.drawn
    )
    for ellipse in extension.probe.probe.ellipses(found):
        assert f"{ellipse.amplitude:.4g} scene units" in layout.drawn
    extension.probe.picking.forget(obj)
    assert "Nothing probed yet" in drawn(extension, obj)


def test_what_makes_native_splats_coarse_is_shown_and_goes(extension, splat_path, tmp_path):
    if not extension.compat.native_splats():
        pytest.skip("this Blender has no splats of its own")
    splat = read_splat(splat_path)
    means = splat.means.copy()
    means[2] = 1e5
    opacities = np.where(np.arange(len(splat)) == 2, 0.1, 1.0).astype(np.float32)
    write_splat(tmp_path / "far.ply", replace(splat, means=means, opacities=opacities))
    obj, names = import_splat(tmp_path / "far.ply"), extension.names
    assert "tg4mm.crop_outliers" not in drawn(extension, obj)
    setter(extension, obj)(names.DRAW, "Native")
    assert {"tg4mm.crop_outliers", "Stray Gaussians reduce position precision"} <= set(drawn(extension, obj))
    assert not {"Min Opacity", "tg4mm.solid_colours", "View Colours"} & set(drawn(extension, obj))
    assert bpy.ops.tg4mm.crop_outliers() == {"FINISHED"}
    assert "tg4mm.crop_outliers" not in drawn(extension, obj)
