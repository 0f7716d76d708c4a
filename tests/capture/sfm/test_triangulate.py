"""Points for known cameras lie on the surfaces, repeat, keep to the masks, and give way where there is no texture."""

import numpy as np
import pytest
from PIL import Image

from tests.capture.sfm.scenes import CENTRE, intrinsics, orbit, picture, save, surface_distance
from tests.fit.space.scenes import views_of
from tg4mm.capture import load_capture
from tg4mm.capture.cameras import optical_axes
from tg4mm.capture.sfm import engine, mapping, reconstruct, triangulate_views
from tg4mm.capture.sfm.config import SfmConfig
from tg4mm.capture.sfm.engine import most_alike
from tg4mm.capture.sfm.place import DISTANCE, Similarity, up_axis, world_of
from tg4mm.capture.sfm.triangulate import outside_masks
from tg4mm.fit.space import initial
from tg4mm.fit.space.initial import initial_points

SIZE = (180, 180)
K = intrinsics(*SIZE, 200.0)
PIXEL = 4 / 200.0  # scene units at the object


def views(n=12, plain=False, floor=True):
    viewmats = orbit(n, turn=np.pi)
    pixels = np.stack([picture(v, K, SIZE, plain=plain, floor=floor) for v in viewmats]) / 255
    alpha = pixels[..., 3]
    return views_of(viewmats, K, alpha, pixels[..., :3] * alpha[..., None] + 1 - alpha[..., None])


@pytest.fixture(scope="module")
def box():
    """The box without its floor, transparent around."""
    return views(floor=False)


@pytest.fixture(scope="module")
def found(box):
    pytest.importorskip("pycolmap")
    return triangulate_views(box)


def test_points_lie_on_the_surface(found):
    distance = surface_distance(found.xyz)
    assert len(found) > 150
    assert np.median(distance) < 0.5 * PIXEL
    assert np.quantile(distance, 0.95) < 3 * PIXEL
    # a shifted cloud would not pass
    assert np.median(surface_distance(found.xyz + [0.05, 0.05, 0.05])) > PIXEL


def test_no_point_is_where_a_picture_shows_background(box, found):
    masks = box.alpha > 0.5
    assert not outside_masks(found.xyz, box.viewmats, box.Ks, masks).any()
    assert outside_masks(found.xyz + [0, 0, 3], box.viewmats, box.Ks, masks).all()


def test_a_second_run_finds_the_same_points(box, found):
    again = triangulate_views(box)
    for name in ("xyz", "rgb", "errors_px", "n_views"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


class TestStart:
    """space.init=sfm."""

    def test_the_space_stage_starts_from_the_points(self, box):
        pytest.importorskip("pycolmap")
        first = initial_points(box, None, "sfm", 10_000, np.random.default_rng(0))
        assert first.source == f"sfm ({len(first.xyz)} points)"
        assert np.median(surface_distance(first.xyz)) < PIXEL
        few = initial_points(box, None, "sfm", 60, np.random.default_rng(0))
        assert len(few.xyz) == 60

    def test_without_texture_the_hull_takes_over_with_a_warning(self):
        pytest.importorskip("pycolmap")
        plain = views(5, plain=True, floor=False)
        said = r"structure from motion found \d+ points, fewer than 100: texture"
        with pytest.warns(UserWarning, match=said):
            first = initial_points(plain, None, "sfm", 300, np.random.default_rng(0))
        assert first.source.startswith("hull (sfm found ")
        assert len(first.xyz) == initial.FEWEST


@pytest.fixture
def photographs(tmp_path):
    """Twelve of a box, and one of something else."""
    size = (240, 180)
    for i, viewmat in enumerate(orbit(12, turn=2.4)):
        save(tmp_path / "in" / f"p_{i:02d}.png", picture(viewmat, intrinsics(*size, 250.0), size))
    noise = np.random.default_rng(0).integers(0, 256, (18, 24, 3), np.uint8)
    Image.fromarray(noise).resize(size, Image.Resampling.BICUBIC).save(tmp_path / "in" / "z.png")
    return tmp_path / "in"


def test_of_many_photographs_the_likely_pairs_place_all(photographs, tmp_path, monkeypatch):
    """The one that is like none is tried with all others, the rest with their nearest alone."""
    pytest.importorskip("pycolmap")
    monkeypatch.setattr(engine, "CHOSEN_FROM", 6)
    monkeypatch.setattr(engine, "most_alike", lambda alike: most_alike(alike, most=4))
    asked: list[list[engine.Pair]] = []

    def counting(database, some, *rest):
        asked.append(some)
        return engine.match(database, some, *rest)

    monkeypatch.setattr(mapping, "match", counting)
    said = r"1 pictures could not be placed and are left out: photographs/z\.png"
    with pytest.warns(UserWarning, match=said):
        reconstruct.reconstruct(photographs, tmp_path / "out", SfmConfig(), threads=1)
    assert len(load_capture(tmp_path / "out").paths) == 12
    tried = [frozenset(pair) for some in asked for pair in some]
    assert len(tried) == len(set(tried)) < 13 * 12 // 2
    assert sum("photographs/z.png" in pair for pair in tried) == 12


def rotation(seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.linalg.det(q)


def elsewhere(viewmats, seed=0):
    """The same cameras in a world that is turned, shifted and 7 times smaller."""
    return Similarity(rotation(seed), 1 / 7, np.array([3.0, -2.0, 5.0])).viewmats(viewmats)


@pytest.mark.parametrize("seed", range(4))
def test_an_orbit_comes_back_upright_centred_and_four_units_away(seed):
    viewmats = elsewhere(orbit(12), seed)
    world = world_of(viewmats, np.zeros((0, 3)))
    centres, axes = optical_axes(world.viewmats(viewmats))
    elevation = np.arcsin(centres[:, 2] / np.linalg.norm(centres, axis=1))
    true_centres, _ = optical_axes(orbit(12))
    true = np.arcsin((true_centres - CENTRE)[:, 2] / 4)
    np.testing.assert_allclose(elevation, true, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(centres, axis=1).mean(), DISTANCE)
    assert abs(axes[0, 0]) < 1e-9  # the first camera looks along +y
    assert axes[0, 1] > 0
    assert np.linalg.det(world.rotation) == pytest.approx(1)


def test_up_is_across_to_the_pictures_rows_though_cameras_look_down():
    """A quarter of a turn: the mean of the cameras' ups leans by tens of degrees, the rows do not."""
    viewmats = orbit(8, turn=np.pi / 2, low=0.9, high=1.1)
    mean_up = -viewmats[:, 1, :3].mean(0)
    assert mean_up[2] / np.linalg.norm(mean_up) < 0.85
    np.testing.assert_allclose(up_axis(viewmats), [0, 0, 1], atol=1e-9)


def test_parallel_axes_take_the_points_middle():
    viewmats = np.tile(np.eye(4), (3, 1, 1))
    viewmats[:, 0, 3] = range(3)
    xyz = np.array([[0, 0, 8.0], [0, 1, 8], [-1, 0, 8]])
    world = world_of(viewmats, xyz)
    np.testing.assert_allclose(world.centre, [0, 0, 8])


def test_a_camera_straight_above_has_a_direction_too():
    down = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]])
    viewmats = np.concatenate([down[None], orbit(6)])
    world = world_of(viewmats, np.zeros((0, 3)))
    assert np.isfinite(world.rotation).all()
    np.testing.assert_allclose(world.rotation @ world.rotation.T, np.eye(3), atol=1e-9)
