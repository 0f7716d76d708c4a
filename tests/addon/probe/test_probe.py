"""The probe: what it reads is what numpy computes from the file, in every way to choose, and as CSV."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.splatfile import positions_at, read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import import_splat, setter  # noqa: E402

TURNS = np.arange(3600) * 2 * np.pi / 3600


@pytest.fixture
def moving(extension, splat_path):
    return import_splat(splat_path)


def mean_of(path, chosen):
    """[M, 3] the mean phasor by opacity."""
    splat = read_splat(path)
    w = splat.opacities[chosen].astype(float)
    return (splat.displacement[:, chosen] * w[None, :, None]).sum(axis=1) / w.sum()


def select(obj, chosen):
    flags = np.zeros(len(obj.data.vertices), bool)
    flags[chosen] = True
    obj.data.vertices.foreach_set("select", flags)


def reading(extension, obj, source):
    assert bpy.ops.tg4mm.probe(source=source) == {"FINISHED"}
    return extension.probe.picking.stored(obj)


def test_a_selected_point_is_read(extension, moving, splat_path):
    select(moving, [7])
    found = reading(extension, moving, "SELECTION")
    np.testing.assert_allclose(found.phasors, read_splat(splat_path).displacement[:, 7], rtol=1e-6)
    assert (found.label, list(found.freqs_hz)) == ("Point 7", [3.0, 5.0, 7.5])
    assert found.deviations is None  # the file does not say them


def test_in_edit_mode_too(extension, moving, splat_path):
    import bmesh

    meshes = len(bpy.data.meshes)
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        with pytest.raises(RuntimeError, match="No point is selected: enter Edit Mode"):
            bpy.ops.tg4mm.probe(source="SELECTION")
        bm = bmesh.from_edit_mesh(moving.data)
        bm.verts.ensure_lookup_table()
        for i in (4, 9):
            bm.verts[i].select_set(True)
        found = reading(extension, moving, "SELECTION")
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    np.testing.assert_allclose(found.phasors, mean_of(splat_path, [4, 9]), rtol=1e-5)
    assert len(bpy.data.meshes) == meshes
    again = reading(extension, moving, "SELECTION")  # still selected after Edit Mode
    np.testing.assert_array_equal(again.phasors, found.phasors)


def test_the_nearest_drawn_gaussian_to_the_cursor(extension, moving, splat_path):
    splat = read_splat(splat_path)
    moving.location, moving.rotation_euler, moving.scale = (1.0, -2.0, 0.5), (0.3, 0.5, -1.0), (2.0, 1.0, 0.5)
    bpy.context.view_layer.update()
    matrix, put = np.array(moving.matrix_world), setter(extension, moving)
    for name, value in ((extension.names.SPEED, 1.0), (extension.names.ALPHA, 30.0)):
        put(name, value)
    bpy.context.scene.frame_set(10)  # far from rest: what is seen there counts
    world = positions_at(splat, 9, 30.0) @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.linalg.norm(world - splat.means @ matrix[:3, :3].T - matrix[:3, 3], axis=1).max() > 0.5
    faint = splat.opacities < 0.1
    assert faint.any()
    for i in np.flatnonzero(~faint):
        bpy.context.scene.cursor.location = world[i] + 0.001
        found = reading(extension, moving, "CURSOR")
        away = np.linalg.norm(world - world[i] - 0.001, axis=1)
        away[faint] = np.inf
        assert found.label == f"Point {away.argmin()}" == f"Point {i}"
        np.testing.assert_allclose(found.place, splat.means[i], atol=1e-6)


def test_a_place_far_from_any_gaussian_is_not_answered(extension, moving, splat_path):
    splat = read_splat(splat_path)
    bpy.context.scene.cursor.location = splat.means.max(axis=0) + 3.0
    with pytest.raises(RuntimeError, match="No Gaussian at the 3D cursor: the nearest is"):
        bpy.ops.tg4mm.probe(source="CURSOR")
    assert extension.probe.picking.stored(moving) is None


def test_the_mark_is_where_the_point_is_drawn(extension, moving, splat_path):
    names, splat = extension.names, read_splat(splat_path)
    assert extension.probe.mark.place(bpy.context.scene, moving) is None
    select(moving, [7])
    reading(extension, moving, "SELECTION")
    put = setter(extension, moving)
    for name, value in ((names.SPEED, 1.0), (names.ALPHA, 20.0), (names.LOW, 4.0), (names.HIGH, 6.0)):
        put(name, value)
    moving.location, moving.scale = (1.0, -2.0, 0.5), (2.0, 1.0, 0.5)
    for _ in range(2):  # before and after Apply Transform
        bpy.context.view_layer.update()
        bpy.context.scene.frame_set(10)
        wanted = positions_at(splat, 9, 20.0, (4.0, 6.0))[7] * (2.0, 1.0, 0.5) + (1.0, -2.0, 0.5)
        np.testing.assert_allclose(extension.probe.mark.place(bpy.context.scene, moving), wanted, atol=1e-4)
        moving.select_set(True)
        bpy.ops.object.transform_apply()


def test_all_gaussians_in_a_sphere(extension, moving, splat_path):
    splat = read_splat(splat_path)
    moving.location = (0.5, 0.0, 0.0)
    bpy.context.scene.cursor.location = (0.7, 0.2, 0.1)
    bpy.context.view_layer.update()
    assert bpy.ops.tg4mm.add_probe_sphere() == {"FINISHED"}
    sphere = bpy.context.object
    assert (sphere.type, sphere.empty_display_type) == ("EMPTY", "SPHERE")
    sphere.empty_display_size, sphere.scale = 0.5, (2.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    off = (splat.means + [0.5, 0, 0] - [0.7, 0.2, 0.1]) / [1.0, 1.0, 1.5]
    inside = np.flatnonzero(np.linalg.norm(off, axis=1) <= 1.0)
    assert 1 < len(inside) < len(splat)
    # The sphere is active; the panel and the operators still mean its splats.
    assert extension.nodes.scene.splat_object(bpy.context) == moving
    found = reading(extension, moving, "SPHERE")
    np.testing.assert_allclose(found.phasors, mean_of(splat_path, list(inside)), rtol=1e-5)
    assert found.label == f"{len(inside)} points"
    sphere.location = (50.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="No Gaussian's rest position is inside bell probe"):
        bpy.ops.tg4mm.probe(source="SPHERE")
    np.testing.assert_array_equal(extension.probe.picking.stored(moving).phasors, found.phasors)  # as it was


def test_ellipse_is_the_path(extension, moving, splat_path):
    select(moving, [3])
    found = reading(extension, moving, "SELECTION")
    for k, e in enumerate(extension.probe.probe.ellipses(found)):
        path = (found.phasors[k][None] * np.exp(1j * TURNS)[:, None]).real
        lengths = np.linalg.norm(path, axis=1)
        assert e.amplitude == pytest.approx(lengths.max(), rel=1e-5)
        assert e.second == pytest.approx(lengths.min(), rel=1e-3)
        long, short = np.array(e.direction), np.array(e.second_direction)
        assert np.linalg.norm(long) == pytest.approx(1) == pytest.approx(np.linalg.norm(short))
        assert long @ short == pytest.approx(0, abs=1e-9)
        assert long @ found.axes[k] >= 0
        turned = TURNS + np.radians(e.phase_deg)
        along = e.amplitude * np.cos(turned)[:, None] * long + e.second * np.sin(turned)[:, None] * short
        np.testing.assert_allclose(along, path, atol=1e-12)


def test_direction_and_phase_of_a_line(extension):
    m = 0.3 * np.array([0.6, 0.0, -0.8]) * np.exp(0.5j)
    e = extension.probe.probe.ellipse(4.0, m, np.array([1.0, 0.0, 0.0]))
    assert (e.amplitude, e.phase_deg) == (pytest.approx(0.3), pytest.approx(np.degrees(0.5)))
    assert e.direction == pytest.approx((0.6, 0.0, -0.8))
    assert (e.second, e.second_direction) == (0.0, (0.0, 0.0, 0.0))
    other = extension.probe.probe.ellipse(4.0, m, np.array([0.0, 0.0, 1.0]))
    assert other.direction == pytest.approx((-0.6, 0.0, 0.8))
    assert other.phase_deg == pytest.approx(np.degrees(0.5) + 180)
    still = extension.probe.probe.ellipse(4.0, 0 * m, np.array([1.0, 0.0, 0.0]))
    assert (still.amplitude, still.phase_deg, still.direction) == (0.0, 0.0, (0.0, 0.0, 0.0))


def test_series_is_the_motion_that_was_measured(extension, moving, splat_path):
    setter(extension, moving)(extension.names.ALPHA, 30.0)
    bpy.ops.tg4mm.band(frequency=5.0)
    select(moving, [6])
    splat, found = read_splat(splat_path), reading(extension, moving, "SELECTION")
    seconds, moved = extension.probe.probe.series(found)
    assert len(seconds) == splat.n_timesteps
    for t in (0, 1, 20, 47):
        assert seconds[t] == pytest.approx(t / splat.fps)
        np.testing.assert_allclose(moved[t], (positions_at(splat, t) - splat.means)[6], atol=1e-6)
    fine, between = extension.probe.probe.series(found, 4)
    np.testing.assert_allclose(between[::4], moved, atol=1e-12)
    assert fine[-1] == seconds[-1]
    np.testing.assert_allclose(between[5], (positions_at(splat, 1.25) - splat.means)[6], atol=1e-6)


def table(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    head = [line for line in lines if line.startswith("#")]
    rows = list(csv.DictReader(lines[len(head) :]))
    return head, [{key: float(value) for key, value in row.items()} for row in rows]


@pytest.mark.parametrize(("scale", "unit", "factor"), [(None, "scene_units", 1.0), (0.25, "mm", 250.0)])
def test_csv_holds_the_series_and_the_phasors(extension, tmp_path, splat_path, scale, unit, factor):
    splat = replace(read_splat(splat_path), unit_scale_m=scale)
    write_splat(tmp_path / "scaled.ply", splat)
    obj = import_splat(tmp_path / "scaled.ply")
    select(obj, [8])
    reading(extension, obj, "SELECTION")
    out = tmp_path / "out.csv"
    assert bpy.ops.tg4mm.export_probe(filepath=str(out), content="SERIES") == {"FINISHED"}
    head, rows = table(out)
    assert unit.replace("_", " ") in head[-1]
    assert len(rows) == splat.n_timesteps
    assert list(rows[0]) == ["time_s", f"x_{unit}", f"y_{unit}", f"z_{unit}"]
    for t in (0, 13, 47):
        moved = [rows[t][f"{axis}_{unit}"] for axis in "xyz"]
        np.testing.assert_allclose(
            moved, factor * (positions_at(splat, t) - splat.means)[8], rtol=1e-3, atol=1e-5
        )
        assert rows[t]["time_s"] == pytest.approx(t / 24)
    done = bpy.ops.tg4mm.export_probe(filepath=str(out), content="SERIES", per_timestep=3)
    assert done == {"FINISHED"}
    assert len(table(out)[1]) == 3 * 47 + 1  # over what was there
    assert bpy.ops.tg4mm.export_probe(filepath=str(out), content="PHASORS") == {"FINISHED"}
    head, rows = table(out)
    for k, row in enumerate(rows):
        m = [complex(row[f"re_{axis}_{unit}"], row[f"im_{axis}_{unit}"]) for axis in "xyz"]
        np.testing.assert_allclose(m, factor * splat.displacement[k, 8], rtol=1e-5)
        assert row["frequency_hz"] == splat.freqs_hz[k]
        path = np.linalg.norm((np.array(m)[None] * np.exp(1j * TURNS)[:, None]).real, axis=1)
        assert row[f"amplitude_{unit}"] == pytest.approx(path.max(), rel=1e-5)
        assert row[f"second_axis_{unit}"] == pytest.approx(path.min(), rel=1e-3)
    assert [path.name for path in tmp_path.iterdir() if "partial" in path.name] == []


def test_export_without_a_reading_or_a_folder(extension, moving, tmp_path):
    with pytest.raises(RuntimeError, match="Nothing probed yet"):
        bpy.ops.tg4mm.export_probe(filepath=str(tmp_path / "a.csv"))
    select(moving, [1])
    reading(extension, moving, "SELECTION")
    with pytest.raises(RuntimeError, match=r"none/a\.csv: cannot be written: No such file"):
        bpy.ops.tg4mm.export_probe(filepath=str(tmp_path / "none" / "a.csv"))
    assert not (tmp_path / "none").exists()


def test_a_lost_attribute_is_said(extension, moving):
    select(moving, [1])
    moving.data.attributes.remove(moving.data.attributes["mode_1_im"])
    with pytest.raises(RuntimeError, match="Attribute 'mode_1_im' of the points is gone"):
        bpy.ops.tg4mm.probe(source="SELECTION")


def test_a_reading_is_saved_with_the_file(extension, sure, tmp_path):
    select(sure[0], [2, 3])
    found = reading(extension, sure[0], "SELECTION")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "probe.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "probe.blend"))
    obj = bpy.data.objects["sure"]
    again = extension.probe.picking.stored(obj)
    np.testing.assert_array_equal(again.phasors, found.phasors)
    np.testing.assert_array_equal(again.deviations, found.deviations)
    np.testing.assert_array_equal(again.axes, found.axes)
    assert (again.label, again.fps, again.n_timesteps) == (found.label, 24.0, 48)
    extension.probe.picking.forget(obj)
    assert extension.names.PROBE_DEVIATIONS not in obj


@pytest.fixture
def sure(extension, tmp_path):
    """A file that says how sure its amplitudes are."""
    splat = some_splat()
    deviation = np.random.default_rng(1).uniform(0.001, 0.01, (3, len(splat))).astype(np.float32)
    write_splat(tmp_path / "sure.ply", replace(splat, deviation=deviation))
    return import_splat(tmp_path / "sure.ply"), splat, deviation


def test_the_deviation_of_a_point_and_of_a_region(extension, sure):
    """The region's is the mean by opacity, since neighbours err alike; it is not divided by √n."""
    obj, splat, deviation = sure
    select(obj, [7])
    found = reading(extension, obj, "SELECTION")
    np.testing.assert_allclose(found.deviations, deviation[:, 7], rtol=1e-6)
    select(obj, [2, 5, 11])
    found = reading(extension, obj, "SELECTION")
    w = splat.opacities[[2, 5, 11]].astype(float)
    np.testing.assert_allclose(found.deviations, deviation[:, [2, 5, 11]] @ w / w.sum(), rtol=1e-6)
    assert [e.deviation for e in extension.probe.probe.ellipses(found)] == found.deviations.tolist()


def test_the_panel_and_the_table_show_it(extension, sure, tmp_path):
    obj, _, deviation = sure
    select(obj, [7])
    found = reading(extension, obj, "SELECTION")
    e = extension.probe.probe.ellipses(found)[1]
    unit = extension.units.unit_of(0.001)  # a scene unit is a millimetre
    shown = extension.probe.picking.row_texts(e, unit)[1]
    assert shown == f"{e.amplitude:.4g} ± {deviation[1, 7]:.2g} mm"
    assert bpy.ops.tg4mm.export_probe(filepath=str(tmp_path / "a.csv"), content="PHASORS") == {"FINISHED"}
    rows = table(tmp_path / "a.csv")[1]
    stated = [row["amplitude_standard_deviation_scene_units"] for row in rows]
    np.testing.assert_allclose(stated, deviation[:, 7], rtol=1e-6)
