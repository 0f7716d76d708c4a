"""The built-in scenes: sound and closed meshes, textures that show motion, size, and what moves."""

import numpy as np
import pytest

from dataset_gen.cameras import test_cameras as the_test_cameras
from dataset_gen.cameras import train_cameras
from dataset_gen.meshes import triangle_areas
from dataset_gen.scenes import NAMES, SCENES, drums, ficus, lego, materials
from dataset_gen.settings import motion_file
from dataset_gen.vibration import read_motion
from tests.dataset_gen.builtin import built, open_edges, size, solved, volume

# A plain colour would hide the motion: the least spread of every part's strongest channel.
TEXTURE = dict.fromkeys(NAMES, 0.02) | {"ship": 0.01}
PARTS = {
    "chair": "back_frame back_pad back_nails arm_wood arm_pads legs feet seat_rail seat_cushion seat_fringe",
    "drums": "crash_left crash_right ride hihat_top hihat_bottom bass_front snare_head tom_heads pedal seat sticks rug",
    "ficus": "pot saucer soil pebbles fallen trunk leaves_00 leaves_19",
    "hotdog": "plate bun_left sausage_left seeds_left bun_right mustard_left ketchup_right crumbs drops",
    "lego": "base base_studs tracks wheels engine cab seat chrome claws blade stripes teeth arms pistons rods",
    "materials": "board rim rim_bead feet rings ball_gold ball_glass",
    "mic": "body collar grille core switch rod swivel hub legs feet plug cable",
    "ship": "hull keel wales decks masts yards sails shrouds ratlines water rudder anchors guns ensign figurehead",
}
# Closed in the sense of every edge walked once each way.
CLOSED = {
    "chair": "legs seat_rail seat_cushion seat_cord back_frame back_pad arm_wood arm_pads knees",
    "hotdog": "plate bun_left bun_right sausage_left mustard_left ketchup_right",
    "materials": "board rim rim_bead feet rings ball_gold ball_glass",
}
OUTWARDS = CLOSED | {
    "drums": "crash_left hihat_top hihat_bottom felts seat rug beater sticks bass_hoops stand_feet",
    "lego": "base tracks wheels blade teeth seat claws axles pistons engine",
}
# What the first mode moves: beginnings of names. Its amplitude is 0.005 everywhere.
MOVING = {
    "chair": ("back_", "arm_"),
    "drums": ("crash_left",),
    "ficus": ("trunk", "leaves_"),
    "hotdog": ("bun_", "sausage_", "mustard_", "ketchup_", "seeds_"),
    "lego": ("blade", "stripes", "teeth", "arms", "pistons", "rods"),
    "materials": ("ball_",),
    "mic": ("body", "collar", "grille", "core", "switch", "rod", "swivel", "thumb_screw", "plug", "cable"),
}


def parts(name):
    return {part.name: part for part in built(name).parts}


def first(name):
    """The first mode's shape [V, 3] by part."""
    return {part: shapes[0] for part, shapes in solved(name).items()}


@pytest.fixture(scope="module", params=NAMES)
def name(request):
    return request.param


def test_meshes_and_textures_are_sound(name):
    for part in built(name).parts:
        mesh, surface = part.mesh, part.surface
        assert np.isfinite(mesh.vertices).all()
        assert mesh.triangles.min() >= 0
        assert mesh.triangles.max() < len(mesh.vertices)
        assert mesh.uv.shape == (*mesh.triangles.shape, 2)
        assert np.isfinite(mesh.uv).all()
        assert triangle_areas(mesh.vertices, mesh.triangles).min() > 0
        for image in (surface.colour, surface.relief, surface.roughness):
            if image is not None:
                assert np.min(image) >= 0
                assert np.max(image) <= 1
        assert surface.colour.std(axis=(0, 1)).max() > TEXTURE[name], part.name
        assert name not in ("drums", "lego") or surface.colour.mean(2).std() > 0.008, part.name  # in grey too


def test_it_has_its_parts_the_scale_of_the_published_scenes_and_fits_the_budget(name):
    every = built(name).parts
    assert set(PARTS[name].split()) <= {part.name for part in every}
    assert len({part.name for part in every}) == len(every)
    points = np.concatenate([part.mesh.vertices for part in every])
    assert 1.0 < np.linalg.norm(points, axis=1).max() < 1.45
    fewest = 40_000 if name == "mic" else 60_000
    assert fewest <= sum(len(part.mesh.triangles) for part in every) <= 300_000
    if name in ("ficus", "ship"):  # every camera sees all of it
        for camera in train_cameras(30) + the_test_cameras(10):
            local = (points - camera.camera_to_world[:3, 3]) @ camera.camera_to_world[:3, :3]
            assert np.abs(local[:, :2] / local[:, 2:]).max() < np.tan(0.3455556)  # half of the field of view


def test_bodies_are_closed_and_face_outwards(name):
    for part in CLOSED.get(name, "").split():
        assert open_edges(parts(name)[part].mesh) == 0, part
    for part in OUTWARDS.get(name, "").split():
        assert volume(parts(name)[part].mesh) > 1e-5, part


def test_only_what_should_move_moves(name):
    peak = {part: size(shape) for part, shape in first(name).items()}
    assert max(peak.values()) == pytest.approx(0.005)
    for part, most in peak.items() if name in MOVING else ():
        assert (most > 0.0004) == part.startswith(MOVING[name]), part


@pytest.mark.parametrize(
    ("name", "reach", "share"), [("chair", 0.012, 0.1), ("hotdog", 0.012, 0.1), ("mic", 0.02, 0.02)]
)
def test_parts_that_touch_move_together(name, reach, share):
    spatial = pytest.importorskip("scipy.spatial")
    group = [
        part
        for part in built(name).parts
        if not part.name.endswith("_right") and part.name not in ("crumbs", "drops")
    ]
    owner = np.repeat(np.arange(len(group)), [len(part.mesh.vertices) for part in group])
    points = np.concatenate([part.mesh.vertices for part in group])
    moves = np.concatenate([first(name)[part.name] for part in group])
    pairs = spatial.cKDTree(points).query_pairs(reach, output_type="ndarray")
    pairs = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]]
    assert len(pairs) > 100  # parts do touch
    assert np.linalg.norm(np.abs(moves[pairs[:, 0]] - moves[pairs[:, 1]]), axis=1).max() < share * 0.005


@pytest.mark.parametrize("name", ["drums", "lego"])
def test_no_two_triangles_coincide(name):
    triangles = [part.mesh.vertices[part.mesh.triangles] for part in built(name).parts]
    corners = np.concatenate([np.sort(t.round(5), axis=1) for t in triangles])
    centres = np.concatenate([t.mean(1) for t in triangles]).round(5)
    keys = np.concatenate([centres, corners.reshape(len(corners), -1)], axis=1)
    assert len(np.unique(keys, axis=0)) == len(keys)


def test_it_is_the_same_each_time(name):
    for one, two in zip(built(name).parts, SCENES[name]().parts, strict=True):
        assert one.name == two.name
        for what in ("vertices", "triangles", "uv"):
            np.testing.assert_array_equal(getattr(one.mesh, what), getattr(two.mesh, what))
        np.testing.assert_array_equal(one.follow, two.follow)
        np.testing.assert_array_equal(one.surface.colour, two.surface.colour)


def test_each_cymbal_rocks_about_its_own_hole_with_a_phase_of_its_own():
    cymbals, modes = (*drums.hw.CYMBALS, drums.hw.HIHAT), read_motion(motion_file("drums")).modes
    for k, (cymbal, mode) in enumerate(zip(cymbals, modes, strict=False)):
        for other, shape in solved("drums").items():
            assert (size(shape[k]) > 0) == (other == cymbal.name), other
        np.testing.assert_allclose(mode.field.pivot, (drums.PLACE @ [*cymbal.pivot, 1.0])[:3], atol=1e-3)
    assert len({mode.phase for mode in modes[:4]}) == 4


def test_the_front_head_swells_in_its_middle_and_is_held_at_its_rim():
    shape, mesh = solved("drums")["bass_front"][4], parts("drums")["bass_front"].mesh
    at = np.linalg.inv(drums.PLACE) @ np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))]).T
    r = np.linalg.norm(at[:3].T - drums.BASS_FRONT, axis=1)
    travel = np.linalg.norm(np.abs(shape), axis=1)
    assert travel[r < 0.02].min() > 0.0039
    assert travel[r > 0.3595].max() < 2e-5


def test_the_ficus_limbs_leave_the_trunk_above_the_soil_and_rustle_each_in_its_own_time():
    spatial = pytest.importorskip("scipy.spatial")
    each, moves, turns = parts("ficus"), solved("ficus"), []
    tree = spatial.cKDTree(each["trunk"].mesh.vertices)
    for part, shapes in moves.items():
        if part.startswith("leaves_"):
            points = each[part].mesh.vertices
            near, _ = tree.query(points)
            assert near.min() < 0.02, part
            assert np.abs(shapes[1, near.argmin()]).max() < 0.001, part
            over = np.hypot(points[:, 0], points[:, 1]) < 0.31
            assert (points[over, 2] > ficus.ground(points[over, 0], points[over, 1])).all(), part
            turns.append(np.angle(shapes[1].ravel()[np.abs(shapes[1]).argmax()]) % np.pi)
    assert np.std(turns) > 0.5
    trunk = each["trunk"].mesh.vertices[:, 2]
    np.testing.assert_array_equal(moves["trunk"][:, trunk <= -0.6], 0.0)


def test_the_bulldozers_arms_turn_about_their_hinge_and_its_cab_trembles_alone():
    each, moves = parts("lego"), solved("lego")
    hinge, across = (lego.place() @ [*lego.gear.HINGE, 1.0])[:3], lego.place()[:3, 1] / lego.PITCH
    offset = each["arms"].mesh.vertices - hinge
    lever = np.linalg.norm(offset - (offset @ across)[:, None] * across, axis=1)
    travel = np.linalg.norm(np.abs(moves["arms"][0]), axis=1)
    np.testing.assert_allclose(travel / lever, np.median(travel / lever), rtol=0.02)
    np.testing.assert_array_equal(moves["cab"][1][each["cab"].mesh.vertices[:, 2] < -0.0201], 0.0)
    for part, shape in moves.items():
        assert (size(shape[1]) > 0) == (part.startswith("cab") or part == "beacon"), part
    follow = np.concatenate([each["pistons"].follow, each["rods"].follow])
    assert (follow.min(), follow.max()) == (0.0, 1.0)
    tops = each["base_studs"].mesh.vertices[:, 2].max()
    assert each["tracks"].mesh.vertices[:, 2].min() == pytest.approx(tops, abs=0.03 * lego.PITCH)


def test_every_ball_touches_its_ring_and_moves_its_own_way_without_sliding():
    each, shapes, tops = parts("materials"), first("materials"), []
    for part, centre in materials.places().items():
        vertices, shape = each[f"ball_{part}"].mesh.vertices, shapes[f"ball_{part}"]
        np.testing.assert_allclose(np.linalg.norm(vertices - centre, axis=1), materials.RADIUS)
        gap = np.linalg.norm(each["rings"].mesh.vertices - centre, axis=1).min() - materials.RADIUS
        assert -1e-9 < gap < 0.002
        assert np.abs(shape[vertices[:, 2] < materials.BALL_Z - 0.9 * materials.RADIUS]).max() < 0.03 * 0.005
        tops.append(shape[np.argmax(np.abs(shape).sum(1))])
    assert min(np.abs(a - b).max() for i, a in enumerate(tops) for b in tops[:i]) > 1e-4


def test_the_mics_tripod_and_lying_cable_are_exactly_still_and_its_mode_is_a_sine():
    shapes = first("mic")
    for part in ("hub", "legs", "feet"):
        np.testing.assert_array_equal(shapes[part], 0.0)
    lying = parts("mic")["cable"].mesh.vertices[:, 2] < -0.82
    assert lying.sum() > 500
    np.testing.assert_array_equal(shapes["cable"][lying], 0.0)
    assert not any(shape.real.any() for shape in shapes.values())


def test_the_ship_floats_rolls_rigidly_and_leaves_the_waters_rim_alone():
    each, moves = parts("ship"), solved("ship")
    level = each["water"].mesh.vertices[:, 2].mean()
    assert each["keel"].mesh.vertices[:, 2].min() < level - 0.1
    assert each["decks"].mesh.vertices[:, 2].min() > level + 0.05  # no water on deck
    assert {part for part, shapes in moves.items() if not np.abs(shapes).any()} == {"sea_body"}
    far = np.linalg.norm(each["water"].mesh.vertices[:, :2], axis=1) > 1.16
    np.testing.assert_array_equal(moves["water"][:, far], 0.0)
    np.testing.assert_array_equal(moves["water"][..., :2], 0.0)
    mesh, shape = each["hull"].mesh, moves["hull"][0].imag
    i, j = np.random.default_rng(0).integers(0, len(mesh.vertices), (2, 500))
    gap, change = mesh.vertices[i] - mesh.vertices[j], shape[i] - shape[j]
    np.testing.assert_allclose((gap * change).sum(1), 0.0, atol=1e-12)  # distances stay
