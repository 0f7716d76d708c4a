"""Bevelled solids, bricks, tubes and drums: volumes in closed form, normals outwards, studs where they show."""

import numpy as np
import pytest

from dataset_gen import meshes as m
from dataset_gen.shapes import bricks, solids, tubes


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


def test_a_hollow_tube_holds_only_its_wall():
    path = np.column_stack([np.zeros(5), np.zeros(5), np.linspace(0.0, 3.0, 5)])
    mesh = tubes.tube(path, 0.2, 0.15, segments=300)
    assert solids.volume(mesh) == pytest.approx(3.0 * np.pi * (0.2**2 - 0.15**2), rel=1e-3)


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
