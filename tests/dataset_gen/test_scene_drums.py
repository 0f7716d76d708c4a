"""The built-in drums: its parts, its place in the picture, and that only what should move does."""

import numpy as np
import pytest

from dataset_gen.scenes import drums as module
from dataset_gen.settings import motion_file
from dataset_gen.shapes import solids
from dataset_gen.vibration import read_motion
from tests.dataset_gen.builtin import size

SCENE = "drums"


CYMBALS = ("crash_left", "crash_right", "ride", "hihat_top")


def test_what_makes_it_a_drum_kit_is_there(parts):
    assert {*CYMBALS, "hihat_bottom", "bass_front", "bass_shell", "snare_head", "tom_heads"} <= set(parts)
    assert {"stands", "pedal", "seat", "sticks", "rug"} <= set(parts)


def test_closed_parts_face_outwards(parts):
    for name in (
        *CYMBALS,
        "hihat_bottom",
        "felts",
        "seat",
        "rug",
        "beater",
        "sticks",
        "bass_hoops",
        "stand_feet",
    ):
        assert solids.volume(parts[name].mesh) > 0, name


def test_the_front_head_looks_at_the_audience(parts):
    mesh = parts["bass_front"].mesh
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a).sum(0)
    front = module.PLACE[:3, 1] / np.linalg.norm(module.PLACE[:3, 1])
    assert normal @ front > 0.99 * np.linalg.norm(normal)


def test_everything_stands_on_the_rug(parts):
    rug = parts["rug"].mesh.vertices[:, 2].max()
    for name in ("stand_feet", "throne_feet", "tom_feet", "bass_feet", "snare_rubber", "pedal"):
        assert parts[name].mesh.vertices[:, 2].min() == pytest.approx(rug, abs=0.006), name
    assert parts["bass_hoops"].mesh.vertices[:, 2].min() > rug


def test_each_cymbal_rocks_about_its_own_hole_and_the_rest_stands(scene, moves):
    for k, name in enumerate(CYMBALS):
        for other, shape in moves.items():
            assert (size(shape[k]) > 0) == (other == name), other
        assert size(moves[name][k]) == pytest.approx(0.003 if name == "hihat_top" else 0.005)
    pivots = {c.name: c.pivot for c in (*module.hw.CYMBALS, module.hw.HIHAT)}
    for name, mode in zip(CYMBALS, read_motion(motion_file("drums")).modes, strict=False):
        np.testing.assert_allclose(mode.field.pivot, (module.PLACE @ [*pivots[name], 1.0])[:3], atol=1e-3)


def test_cymbals_have_phases_of_their_own():
    phases = [mode.phase for mode in read_motion(motion_file("drums")).modes[:4]]
    assert len(set(phases)) == 4


def test_the_front_head_swells_in_its_middle_and_is_held_at_its_rim(parts, moves):
    shape, mesh = moves["bass_front"][4], parts["bass_front"].mesh
    at = np.linalg.inv(module.PLACE) @ np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))]).T
    r = np.linalg.norm(at[:3].T - module.BASS_FRONT, axis=1)
    travel = np.linalg.norm(np.abs(shape), axis=1)
    assert travel[r < 0.02].min() > 0.0039
    assert travel[r > 0.3595].max() < 2e-5
    assert size(moves["bass_hoops"][4]) == 0.0
