"""Bevelled solids, bricks, tubes and drums: volumes in closed form, normals outwards, studs where they show."""

import numpy as np
import pytest

from dataset_gen import meshes as m
from dataset_gen.patterns import kit, plastic
from dataset_gen.shapes import bricks, drums, solids, tubes


def test_a_block_has_its_volume_and_a_bevel_takes_the_edges_off():
    assert solids.volume(solids.block((0, 0, 0), (1, 2, 3))) == pytest.approx(6.0)
    bevelled = solids.volume(solids.block((0, 0, 0), (1, 2, 3), 0.1))
    # Twelve prisms of ½·0.1² along edges of total length 4·(1 + 2 + 3); corners overlap a little.
    assert 6.0 - 0.005 * 24 < bevelled < 6.0 - 0.005 * (24 - 12 * 0.2)


def test_a_pierced_plate_is_a_ring():
    circle = m.circle(1.0, 400)
    ring = solids.pierced(circle, 0.5 * circle, 0.0, 2.0)
    assert solids.volume(ring) == pytest.approx(2.0 * np.pi * 0.75, rel=1e-3)


@pytest.mark.parametrize("swapped", [False, True])
def test_a_lamella_faces_outwards_whichever_line_comes_first(swapped):
    angle = np.linspace(0.5, 2.0, 200)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    lines = (2.0 * ring, 3.0 * ring) if swapped else (3.0 * ring, 2.0 * ring)
    assert solids.volume(solids.lamella(*lines, 0.0, 2.0)) == pytest.approx(0.5 * 1.5 * 5.0 * 2.0, rel=1e-3)


def test_a_mirror_image_still_faces_outwards():
    solid = bricks.tread(0.75, 2.6)
    assert solids.volume(solids.mirrored(solid, 1)) == pytest.approx(solids.volume(solid))
    assert solids.volume(solids.turned(solid)) == pytest.approx(-solids.volume(solid))


def test_a_hollow_tube_holds_only_its_wall():
    path = np.column_stack([np.zeros(5), np.zeros(5), np.linspace(0.0, 3.0, 5)])
    mesh = tubes.tube(path, 0.2, 0.15, segments=300)
    assert solids.volume(mesh) == pytest.approx(3.0 * np.pi * (0.2**2 - 0.15**2), rel=1e-3)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0.2, 0.1)])
def test_rods_and_nuts_stand_in_every_direction(direction):
    along = np.array(direction, float)
    for mesh in (tubes.rod((0, 0, 0), along, 0.1), tubes.collar((0, 0, 0), 0.1, 0.2, along),
                 tubes.wing_nut((0, 0, 0), along, 0.3)):  # fmt: skip
        assert np.isfinite(mesh.vertices).all()
        assert solids.volume(mesh) > 0


@pytest.mark.parametrize("build", [bricks.stud, bricks.bush, lambda: bricks.gear(16, 2.0, 1.0),
                                   lambda: bricks.wheel(0.6, 1.0), lambda: bricks.axle(2.0),
                                   lambda: drums.cymbal(0.3, 0.07, 0.03)])  # fmt: skip
def test_turned_pieces_face_outwards(build):
    mesh = build()
    assert solids.volume(mesh) > 0
    assert m.triangle_areas(mesh.vertices, mesh.triangles).min() > 0


def test_one_can_look_through_the_holes_of_a_beam():
    mesh = bricks.beam(4)
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.abs(normal[:, 2]) > 0.9 * np.linalg.norm(normal, axis=1)
    for x in (1, 2, 3):  # no face across the hole comes nearer to its axis than the hole's radius
        near = np.hypot(corners[facing][..., 0] - x, corners[facing][..., 1]).min()
        assert near > 0.3
    wall = np.hypot(corners[..., 0] - 2, corners[..., 1]).max(1) < 0.32
    outwards = (normal[wall][:, :2] * (corners[wall].mean(1)[:, :2] - [2.0, 0.0])).sum(1)
    assert (outwards < 0).all()


def test_a_brick_on_a_brick_hides_the_studs_below_it():
    model = bricks.BrickModel(np.random.default_rng(0))
    model.brick("red", (0, 0, 0), (4, 2, 1.2))
    model.brick("blue", (0, 0, 1.2), (2, 2, 1.2))
    parts = model.parts()
    one = len(bricks.stud().vertices)
    assert len(parts["red_studs"].vertices) == 4 * one
    assert len(parts["blue_studs"].vertices) == 4 * one
    assert parts["red_studs"].vertices[:, 0].min() > 2.0


def test_cube_mapping_keeps_the_scale():
    mesh = solids.cube_mapped(solids.block((0, 0, 0), (1, 2, 3)), 4.0)
    a, b, c = (mesh.uv[:, k] for k in range(3))
    ab, ac = b - a, c - a
    area = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    np.testing.assert_allclose(16.0 * area, m.triangle_areas(mesh.vertices, mesh.triangles))


def test_plastic_and_glitter_tile():
    for image in (plastic.moulded((0.9, 0.7, 0.1), np.random.default_rng(1), 128)[0],
                  kit.glitter(128, (0.6, 0.1, 0.1), np.random.default_rng(1), 50)):  # fmt: skip
        inner = np.abs(np.diff(image.mean(2), axis=0)).mean()
        seam = np.abs(image.mean(2)[0] - image.mean(2)[-1]).mean()
        assert seam < 2.0 * inner


def test_letters_stand_upright_on_a_head():
    mesh = drums.head(1.0, up=True)
    corners = mesh.vertices[mesh.triangles].reshape(-1, 3)
    uv = mesh.uv.reshape(-1, 2)
    top = corners[:, 0] > 0.99
    assert (uv[top, 1] > 0.97).all()  # the frame's x axis is up
    right = corners[:, 1] < -0.99  # seen against z with x up, −y is right
    assert (uv[right, 0] > 0.97).all()
