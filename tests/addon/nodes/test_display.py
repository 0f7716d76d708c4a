"""What is drawn: shapes, colours by amplitude and phase, arrows, and colours that depend on the view."""

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.splatfile import positions_at, read_splat, write_splat
from tg4mm.core.splatfile.formula import harmonics

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import (  # noqa: E402
    add_camera,
    drawn_whole,
    evaluated,
    import_splat,
    read,
    setter,
    shown_colours,
    transforms,
)

TURNS = np.arange(0, 2 * np.pi, 2 * np.pi / 3600)


def largest_excursion(phasors):
    """[N] the longest of Re[m exp(iθ)] over a turn, by trying, and the θ where it is reached."""
    paths = (phasors[:, None] * np.exp(1j * TURNS)[None, :, None]).real
    lengths = np.linalg.norm(paths, axis=2)
    return lengths.max(axis=1), TURNS[lengths.argmax(axis=1)]


def sampled(rows, parts):
    """Linear interpolation of rows at equal steps from 0 to 1."""
    places = np.linspace(0, 1, len(rows))
    return np.stack([np.interp(parts, places, rows[:, c]) for c in range(3)], axis=1)


@pytest.fixture
def moving(extension, splat_path):
    """The imported object, every Gaussian drawn."""
    obj = import_splat(splat_path)
    drawn_whole(extension, obj)
    return obj


def test_phase_tells_when_a_point_is_out_on_the_side_of_the_axis(extension, splat_path):
    for phasors in read_splat(splat_path).displacement:
        axis = extension.nodes.points.main_axis(phasors)
        _, phase = extension.nodes.points.strength(phasors, axis)
        out = (phasors * np.exp(-2j * np.pi * phase)[:, None]).real  # Re[m exp(iωt)] at ωt = −phase
        np.testing.assert_allclose(np.linalg.norm(out, axis=1), largest_excursion(phasors)[0], rtol=1e-5)
        assert (out @ axis >= -1e-9).all()
        assert ((phase >= 0) & (phase < 1)).all()


def test_colours_show_the_amplitude_of_the_band(extension, moving, splat_path):
    put, names = setter(extension, moving), extension.names
    put(names.COLOUR_BY, names.AMPLITUDE_COLOUR)
    each = [largest_excursion(phasors)[0] for phasors in read_splat(splat_path).displacement]
    for low, high, hidden, kept in ((0, 100, (), (0, 1, 2)), (4, 8, (), (1, 2)), (0, 100, ("3 Hz",), (1, 2))):
        put(names.LOW, low)
        put(names.HIGH, high)
        for name in ("3 Hz", "5 Hz", "7.5 Hz"):
            put(name, name not in hidden)
        expected = np.sqrt(sum(each[k] ** 2 for k in kept))
        np.testing.assert_allclose(extension.panels.analysis.band_amplitude(moving), expected, rtol=1e-4)
        assert bpy.ops.tg4mm.fit_colour_range() == {"FINISHED"}
        rows = sampled(extension.nodes.colours.amplitude_map(), expected / expected.max())
        np.testing.assert_allclose(shown_colours(moving), rows, atol=2e-3)


def test_colours_show_the_phase_of_the_largest_mode(extension, moving, splat_path):
    put, names = setter(extension, moving), extension.names
    put(names.COLOUR_BY, names.PHASE_COLOUR)
    put(names.COLOUR_RANGE, 0.01)  # everything moves far enough to have a phase
    points = extension.nodes.points
    both = [points.strength(p, points.main_axis(p)) for p in read_splat(splat_path).displacement]
    amplitudes, phases = (np.stack(list(column)) for column in zip(*both, strict=True))
    phase = phases[amplitudes.argmax(axis=0), np.arange(phases.shape[1])]
    np.testing.assert_allclose(
        shown_colours(moving), sampled(extension.nodes.colours.phase_map(), phase), atol=5e-3
    )
    put(names.COLOUR_RANGE, 1e3)
    np.testing.assert_allclose(shown_colours(moving), extension.nodes.colours.still(), atol=1e-6)


def test_arrows_run_from_rest_along_the_magnified_displacement(extension, moving, splat_path):
    put, names = setter(extension, moving), extension.names
    for name, value in ((names.DRAW, "Arrows"), (names.ALPHA, 4.0), (names.ARROW_LENGTH, 2.0)):
        put(name, value)
    splat = read_splat(splat_path)
    drawn = transforms(moving, 6)
    shift = positions_at(splat, 5, 4.0) - splat.means
    np.testing.assert_allclose(drawn[:, :3, 3], splat.means, atol=1e-5)
    np.testing.assert_allclose(drawn[:, :3, 2], 2 * shift, atol=2e-3)  # the arrow's own z
    put(names.ARROW_EVERY, 5)
    np.testing.assert_allclose(transforms(moving, 6)[:, :3, 3], splat.means[::5], atol=1e-5)
    put(names.ALPHA, -1.0)
    geometry = evaluated(moving, 6)
    still = geometry.instances_pointcloud()
    assert still is None or len(still.points) == 0


def test_solid_view_has_a_mesh_with_an_active_colour(extension, moving, splat_path):
    assert bpy.ops.tg4mm.solid_colours() == {"FINISHED"}
    geometry = evaluated(moving, 1)
    mesh = geometry.mesh
    assert len(mesh.polygons) == 80 * len(read_splat(splat_path))
    assert mesh.color_attributes.active_color.name == "colour"
    colours = read(mesh, "colour", "color", 4)[:, :3]
    expected = extension.nodes.colours.rest_colours(read_splat(splat_path).sh)[:, :3]
    assert np.abs(colours[:, None] - expected[None]).sum(axis=2).min(axis=1).max() < 1e-4


def test_points_are_coloured_balls_in_solid_view(extension, moving, splat_path):
    put, names = setter(extension, moving), extension.names
    put(names.DRAW, "Points")
    assert bpy.ops.tg4mm.solid_colours() == {"FINISHED"}
    for by, palette in (
        (names.FILE_COLOUR, extension.nodes.colours.rest_colours(read_splat(splat_path).sh)[:, :3]),
        (names.AMPLITUDE_COLOUR, None),
    ):
        put(names.COLOUR_BY, by)
        geometry = evaluated(moving, 4)
        mesh, n = geometry.mesh, len(read_splat(splat_path))
        assert (len(mesh.polygons), mesh.color_attributes.active_color.name) == (20 * n, "colour")
        colours = read(mesh, "colour", "color", 4)[n:, :3]  # after the points themselves
        if palette is None:
            parts = extension.panels.analysis.band_amplitude(moving)
            palette = sampled(extension.nodes.colours.amplitude_map(), parts / parts.max())
        off = np.abs(colours.reshape(n, 12, 3) - palette[:, None]).max(axis=(1, 2))
        assert off.max() < 3e-3
    centres = read(mesh, "position", "vector", 3)[n:].reshape(n, 12, 3).mean(axis=1)
    np.testing.assert_allclose(centres, positions_at(read_splat(splat_path), 3), atol=1e-3)
    assert bpy.ops.tg4mm.solid_colours(on=False) == {"FINISHED"}
    geometry = evaluated(moving, 4)
    assert len(geometry.pointcloud.points) == n


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_colours_seen_by_the_camera_are_those_of_the_harmonics(extension, tmp_path, degree):
    splat = some_splat(60, degree=degree)
    write_splat(tmp_path / "seen.ply", splat)
    obj = import_splat(tmp_path / "seen.ply")
    drawn_whole(extension, obj)
    put, names = setter(extension, obj), extension.names
    put(names.VIEW_COLOUR, True)
    put(names.ALPHA, 10.0)
    obj.location, obj.rotation_euler = (1.0, -2.0, 0.5), (0.3, 0.5, -1.0)
    camera = add_camera((3.0, -4.0, 2.0), (8, 8))
    for place, frame in (((3.0, -4.0, 2.0), 5), ((-2.0, 0.5, 6.0), 8)):
        camera.location = place
        bpy.context.view_layer.update()
        local = np.array(obj.matrix_world.inverted() @ camera.matrix_world.translation)
        toward = positions_at(splat, frame - 1, 10.0) - local
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        srgb = np.clip(
            0.5 + np.einsum("nk,nkc->nc", harmonics(toward)[:, : (degree + 1) ** 2], splat.sh), 0, 1
        )
        np.testing.assert_allclose(
            shown_colours(obj, frame), extension.nodes.colours.to_linear(srgb), atol=3e-3
        )
    put(names.VIEW_COLOUR, False)
    rest = extension.nodes.colours.rest_colours(splat.sh)[:, :3]
    assert np.abs(shown_colours(obj, 8) - rest).max() < 1e-5
    assert np.abs(extension.nodes.colours.to_linear(srgb) - rest).max() > 0.1
