"""The built-in chair: parts, closed bodies, joints, and what may move."""

import numpy as np
import pytest

from dataset_gen.scenes import chair
from dataset_gen.shapes import cushion
from tests.dataset_gen.builtin import open_edges, volume

SCENE = "chair"


def test_it_has_moving_and_still_parts(parts):
    moving = {name for name in parts if name.startswith(("back_", "arm_"))}
    still = set(parts) - moving
    assert {"back_frame", "back_pad", "back_nails", "arm_wood", "arm_pads"} <= moving
    assert {"legs", "feet", "seat_rail", "seat_cushion", "seat_fringe", "seat_nails"} <= still


def test_it_has_the_scale_of_the_published_scene(scene):
    points = np.concatenate([part.mesh.vertices for part in scene.parts])
    assert np.isfinite(points).all()
    assert 1.2 < np.linalg.norm(points, axis=1).max() < 1.45
    assert 60_000 <= sum(len(part.mesh.triangles) for part in scene.parts) <= 300_000


@pytest.mark.parametrize(
    "name",
    [
        "legs",
        "seat_rail",
        "seat_cushion",
        "seat_cord",
        "back_frame",
        "back_pad",
        "arm_wood",
        "arm_pads",
        "knees",
    ],
)
def test_bodies_are_closed_and_face_outwards(parts, name):
    assert open_edges(parts[name].mesh) == 0
    assert volume(parts[name].mesh) > 1e-5


def test_an_open_body_would_be_noticed(parts):
    mesh = parts["seat_cushion"].mesh
    assert open_edges(type(mesh)(mesh.vertices, mesh.triangles[1:], mesh.uv[1:])) > 0


def test_it_stands_on_four_feet_of_equal_height(parts):
    low = parts["feet"].mesh.vertices
    low = low[low[:, 2] < chair.GROUND + 1e-9]
    assert {(x > 0, y > 0) for x, y in low[:, :2]} == {(a, b) for a in (True, False) for b in (True, False)}


def test_what_moves_starts_where_the_motion_is_still_zero(parts):
    # Stiles and posts are rooted in the rail, below the clamped end of the bending mode.
    for name in ("back_stiles", "arm_wood"):
        assert parts[name].mesh.vertices[:, 2].min() < chair.RAIL[1]
    for name in ("back_pad", "back_frame", "arm_pads"):
        assert parts[name].mesh.vertices[:, 2].min() > 0.12  # clear of the still cushion
    assert parts["seat_cushion"].mesh.vertices[:, 2].max() < 0.12


def test_it_is_symmetric(parts):
    for name in ("legs", "arm_wood", "back_stiles"):
        points = parts[name].mesh.vertices
        half = len(points) // 2
        np.testing.assert_allclose(points[:half] * [1, -1, 1], points[half:])


def test_only_what_should_move_moves(shapes):
    peak = {name: np.linalg.norm(np.abs(shape), axis=1).max() for name, shape in shapes.items()}
    assert max(peak.values()) == pytest.approx(0.005)
    for name, size in peak.items():
        assert (size > 0.0005) == name.startswith(("back_", "arm_")), name


def test_parts_that_touch_move_together(scene, shapes):
    spatial = pytest.importorskip("scipy.spatial")
    group = scene.parts
    owner = np.repeat(np.arange(len(group)), [len(part.mesh.vertices) for part in group])
    points = np.concatenate([part.mesh.vertices for part in group])
    moves = np.concatenate([shapes[part.name] for part in group])
    pairs = spatial.cKDTree(points).query_pairs(0.012, output_type="ndarray")
    pairs = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]]
    assert len(pairs) > 100  # parts do touch
    jump = np.linalg.norm(np.abs(moves[pairs[:, 0]] - moves[pairs[:, 1]]), axis=1)
    assert jump.max() < 0.1 * 0.005


def test_an_outline_is_filled_and_rimmed_evenly():
    outline = cushion.Outline(0.5, 0.3, 2.0)
    points, share = outline.disc(41)
    np.testing.assert_allclose(np.hypot(points[..., 0] / 0.5, points[..., 1] / 0.3), share, atol=1e-9)
    assert share[0].min() == pytest.approx(1.0)
    steps = np.linalg.norm(np.diff(outline.rim(100), axis=0), axis=1)
    assert np.ptp(steps) < 0.01 * steps.mean()


def test_tufts_are_deepest_at_their_buttons():
    buttons = cushion.diamonds(3, 3, (0.2, 0.2), (0.0, 0.0))
    assert len(buttons) == 8
    depth = cushion.tufts(buttons, buttons, 0.05, 0.04, 0.02)
    np.testing.assert_allclose(depth, 0.05)
    assert cushion.tufts(np.array([[5.0, 5.0]]), buttons, 0.05, 0.04, 0.02)[0] < 1e-6
