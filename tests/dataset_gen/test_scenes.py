"""The built-in scenes: sound and closed meshes, textures that show motion, size, and what moves."""

import numpy as np
import pytest

from dataset_gen.cameras import test_cameras as the_test_cameras
from dataset_gen.cameras import train_cameras
from dataset_gen.meshes import triangle_areas
from dataset_gen.scenes import NAMES
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
    apart = ("_right", "crumbs", "drops")
    group = [part for part in built(name).parts if not part.name.endswith(apart)]
    owner = np.repeat(np.arange(len(group)), [len(part.mesh.vertices) for part in group])
    points = np.concatenate([part.mesh.vertices for part in group])
    moves = np.concatenate([first(name)[part.name] for part in group])
    pairs = spatial.cKDTree(points).query_pairs(reach, output_type="ndarray")
    pairs = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]]
    assert len(pairs) > 100  # parts do touch
    assert np.linalg.norm(np.abs(moves[pairs[:, 0]] - moves[pairs[:, 1]]), axis=1).max() < share * 0.005


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
