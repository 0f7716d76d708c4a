"""The built-in ship: parts, size, contacts between parts, pictures, and what moves and what does not."""

import numpy as np
import pytest

from dataset_gen.cameras import test_cameras as the_test_cameras
from dataset_gen.cameras import train_cameras
from dataset_gen.scenes.ship_plan import HULL, WATER
from dataset_gen.shapes import hull as lines
from dataset_gen.shapes import joinery, ocean, rig
from dataset_gen.shapes.patch import box, mirrored, slab
from tests.dataset_gen.builtin import volume

SEA = ("water", "sea_body")


SCENE = "ship"


def test_what_makes_a_ship_is_there(parts):
    assert {
        "hull",
        "keel",
        "wales",
        "decks",
        "masts",
        "yards",
        "sails",
        "shrouds",
        "ratlines",
        "water",
    } <= set(parts)
    assert {"rudder", "anchors", "lanterns", "guns", "ensign", "figurehead"} <= set(parts)
    assert 60_000 <= sum(len(part.mesh.triangles) for part in parts.values()) <= 300_000


def test_every_camera_sees_all_of_it(scene):
    points = np.concatenate([part.mesh.vertices for part in scene.parts])
    assert np.linalg.norm(points, axis=1).max() > 1.2
    for camera in train_cameras(30) + the_test_cameras(10):
        local = (points - camera.camera_to_world[:3, 3]) @ camera.camera_to_world[:3, :3]
        assert np.abs(local[:, :2] / local[:, 2:]).max() < np.tan(0.3455556)  # half of the field of view


def test_she_floats(parts):
    level = parts["water"].mesh.vertices[:, 2].mean()
    assert parts["keel"].mesh.vertices[:, 2].min() < level - 0.1
    assert parts["decks"].mesh.vertices[:, 2].min() > level + 0.05  # no water on deck
    sea = parts["sea_body"].mesh.vertices
    under = sea[np.linalg.norm(sea[:, :2], axis=1) < 0.7, 2]
    assert under.max() < parts["keel"].mesh.vertices[:, 2].min()  # nothing sticks out below the sea


def test_aloft_everything_touches_something(parts):
    spatial = pytest.importorskip("scipy.spatial")
    for name, holder in (("sails", "yards"), ("gaskets", "sails"), ("ensign", "staffs")):
        tree = spatial.cKDTree(parts[holder].mesh.vertices)
        near, _ = tree.query(parts[name].mesh.vertices)
        assert np.quantile(near, 0.05) < 0.03, name


def test_only_the_sea_body_stands_still(parts, moves):
    moving = {name for name, shapes in moves.items() if np.abs(shapes).max() > 0}
    assert set(parts) - moving == {"sea_body"}
    for name in set(parts) - set(SEA):
        assert np.abs(moves[name][0]).max() > 0  # the roll takes all of the ship along


def test_the_water_is_still_at_its_rim_and_moves_only_up_and_down(parts, moves):
    far = np.linalg.norm(parts["water"].mesh.vertices[:, :2], axis=1) > 1.16
    assert far.sum() > 200
    np.testing.assert_array_equal(moves["water"][:, far], 0.0)
    np.testing.assert_array_equal(moves["water"][..., :2], 0.0)
    assert np.abs(moves["water"]).max() == pytest.approx(0.002, rel=0.02)


def test_the_roll_is_rigid_about_the_keel_and_largest_at_the_main_truck(parts, moves):
    size = {name: np.linalg.norm(np.abs(shapes[0]), axis=1).max() for name, shapes in moves.items()}
    assert max(size.values()) == pytest.approx(0.005)
    assert size["masts"] > 0.0045 > size["decks"] > size["keel"]
    mesh, shape = parts["hull"].mesh, moves["hull"][0].imag
    i, j = np.random.default_rng(0).integers(0, len(mesh.vertices), (2, 500))
    gap, change = mesh.vertices[i] - mesh.vertices[j], shape[i] - shape[j]
    np.testing.assert_allclose((gap * change).sum(1), 0.0, atol=1e-12)  # distances stay


def test_the_skin_faces_outwards_on_both_sides():
    mesh = lines.planking(HULL)
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    normal, middle = np.cross(b - a, c - a), (a + b + c) / 3.0
    amidships = (np.abs(middle[:, 0]) < 0.3) & (middle[:, 2] > WATER)
    assert amidships.sum() > 500
    assert (normal[amidships, 1] * middle[amidships, 1] > 0).all()
    stern = lines.transom(HULL, 1.2)
    a, b, c = (stern.vertices[stern.triangles[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 0] < 0).all()


def test_a_point_asked_for_lies_on_the_side():
    point = HULL.at(0.1, -0.2)
    u = HULL.station(0.1, -0.2)
    np.testing.assert_allclose(point, HULL.side(np.array(u), HULL.level(np.array(u), -0.2)), atol=1e-12)
    np.testing.assert_allclose(point[[0, 2]], (0.1, -0.2), atol=1e-4)
    assert HULL.at(0.1, -0.2, out=0.03)[1] == pytest.approx(point[1] - 0.03)


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box((0.2, 0.3, 0.4)), 0.024),
        (mirrored(slab((0, 1, 2), (1, 3, 5))), 6.0),
        (joinery.barrel(np.eye(4), 1.0), None),
        (rig.spar((0, 0, 0), (1, 0, 0), (0.1, 0.1), 200), np.pi * 0.01),
    ],
)
def test_solids_face_outwards(mesh, expected):
    assert volume(mesh) > 0
    if expected:
        assert volume(mesh) == pytest.approx(expected, rel=2e-3)


def test_a_furled_sail_is_pinched_by_its_gaskets():
    canvas, ties = rig.furled((0, -1, 0), (0, 1, 0), 0.1, 5, np.random.default_rng(3))
    assert volume(canvas) > 0
    radius = np.hypot(canvas.vertices[:, 0], canvas.vertices[:, 2])
    middle = np.abs(canvas.vertices[:, 1]) < 1e-6
    beside = np.abs(np.abs(canvas.vertices[:, 1]) - 0.2) < 0.05
    assert radius[middle].mean() < 0.9 * radius[beside].mean()
    assert len(ties.vertices) > 0


def test_distance_to_the_waterline():
    outline = np.array([[-1.0, 0.0], [0.0, -0.5], [1.0, 0.0]])
    distance = ocean.distance_to(outline, np.array([0.0, 0.0, 2.0]), np.array([0.3, 0.9, 0.0]))
    np.testing.assert_allclose(distance, [0.0, 0.4, 1.0])


def test_ratlines_run_from_shroud_to_shroud():
    feet = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.4, 0.0, 0.0]])
    heads = np.array([[0.19, 0.0, 1.0], [0.2, 0.0, 1.0], [0.21, 0.0, 1.0]])
    _, rungs = rig.shrouds(feet, heads, 0.003, 0.1)
    x, z = rungs.vertices[:, 0], rungs.vertices[:, 2]
    left, right = feet[0, 0] + 0.19 * z, feet[2, 0] - 0.19 * z  # the outer shrouds at the rungs' heights
    assert (x > left - 0.004).all()
    assert (x < right + 0.004).all()
    assert (x - left).min() < 0.003
    assert np.ptp(z) > 0.6
