"""What every built-in scene fulfils: sound meshes, textures that show motion, its size, and itself again each time."""

import numpy as np
import pytest

from dataset_gen.meshes import triangle_areas
from dataset_gen.scenes import NAMES, SCENES
from tests.dataset_gen.builtin import built

# A plain colour would hide the motion: the least spread of every part's strongest channel.
TEXTURE = dict.fromkeys(NAMES, 0.02) | {"ship": 0.01}


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


def test_every_surface_carries_texture(name):
    for part in built(name).parts:
        assert part.surface.colour.std(axis=(0, 1)).max() > TEXTURE[name], part.name


@pytest.mark.parametrize("name", ["drums", "lego"])
def test_textures_show_in_grey_too(name):
    for part in built(name).parts:
        assert part.surface.colour.mean(2).std() > 0.008, part.name


@pytest.mark.parametrize("name", ["drums", "lego"])
def test_no_two_triangles_coincide(name):
    triangles = [part.mesh.vertices[part.mesh.triangles] for part in built(name).parts]
    corners = np.concatenate([np.sort(t.round(5), axis=1) for t in triangles])
    centres = np.concatenate([t.mean(1) for t in triangles]).round(5)
    keys = np.concatenate([centres, corners.reshape(len(corners), -1)], axis=1)
    assert len(np.unique(keys, axis=0)) == len(keys)


def test_it_has_the_scale_of_the_published_scenes_and_fits_the_budget(name):
    parts = built(name).parts
    radius = np.linalg.norm(np.concatenate([part.mesh.vertices for part in parts]), axis=1).max()
    assert 1.0 < radius < 1.45
    fewest = 40_000 if name == "mic" else 60_000
    assert fewest <= sum(len(part.mesh.triangles) for part in parts) <= 300_000
    assert len({part.name for part in parts}) == len(parts)


def test_it_is_the_same_each_time(name):
    for one, two in zip(built(name).parts, SCENES[name]().parts, strict=True):
        assert one.name == two.name
        for what in ("vertices", "triangles", "uv"):
            np.testing.assert_array_equal(getattr(one.mesh, what), getattr(two.mesh, what))
        np.testing.assert_array_equal(one.follow, two.follow)
        np.testing.assert_array_equal(one.surface.colour, two.surface.colour)
