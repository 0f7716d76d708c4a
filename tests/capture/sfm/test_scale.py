"""A known length on the thing itself gives metres: where its ends are, and how well that is known."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from tests.capture.sfm.scenes import orbit
from tg4mm.capture.sfm.config import SfmConfig, checked
from tg4mm.capture.sfm.place import Similarity
from tg4mm.capture.sfm.scale import CLICK_PX, KnownLength, measured_length, read_length, triangulated
from tg4mm.capture.sfm.staging import StagedPicture
from tg4mm.core.errors import Tg4mmError

pycolmap = pytest.importorskip("pycolmap")
SIZE, FOCAL, BEND = (640, 480), 700.0, 0.05
N = 6
# The thing: a plate on the floor, 1.2 units long.
ENDS = np.array([[-0.6, 0.1, 0.0], [0.6, 0.1, 0.0]])
HALF = 2.0  # units in metres of the world that the similarity leads to


class Scene:
    """Cameras around the floor z = 0, with known points on it."""

    def __init__(self, noise=0.0, points=600, spread=1.0):
        rng = np.random.default_rng(0)
        self.model = pycolmap.Reconstruction()
        lens = {"model": "SIMPLE_RADIAL", "params": [FOCAL, 320, 240, BEND]}
        camera = pycolmap.Camera(width=SIZE[0], height=SIZE[1], camera_id=1, **lens)
        self.model.add_camera_with_trivial_rig(camera)
        xyz = np.concatenate([rng.uniform(-spread, spread, (points, 2)), np.zeros((points, 1))], axis=1)
        ids = [self.model.add_point3D(p + [0, 0, noise * rng.normal()], pycolmap.Track()) for p in xyz]
        self.taken, self.placed = [], {}
        for i, viewmat in enumerate(orbit(N, turn=1.5), 1):
            pixels, inside = self.seen(viewmat, xyz)
            name = f"sweep/{i:03d}.jpg"
            image = pycolmap.Image(name=name, keypoints=pixels[inside], camera_id=1, image_id=i)
            self.model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(viewmat[:3]))
            for k, point in enumerate(np.array(ids)[inside]):
                self.model.add_observation(int(point), pycolmap.TrackElement(i, k))
            self.taken.append(StagedPicture(name, Path(name), "shared", "sweep"))
            self.placed[name] = self.model.images[i]
        self.taken.append(StagedPicture("sweep/lost.jpg", Path("sweep/lost.jpg"), "shared", "sweep"))

    def seen(self, viewmat, xyz):
        cam = xyz @ viewmat[:3, :3].T + viewmat[:3, 3]
        pixels = np.asarray(self.model.cameras[1].img_from_cam(cam))
        inside = (pixels > 0).all(1) & (pixels < SIZE).all(1)
        return pixels, inside

    def at(self, name, xyz):
        """The pixel of a point in a picture."""
        pose = np.eye(4)
        pose[:3] = self.placed[f"sweep/{name}.jpg"].cam_from_world().matrix()
        x, y = self.seen(pose, xyz[None])[0][0]
        return name, float(x), float(y)

    def measure(self, *ends, metres=0.6):
        world = Similarity(np.eye(3)[[1, 2, 0]], HALF, np.array([0.3, 0.2, 0.1]))
        return measured_length(KnownLength(ends, metres), self.taken, self.placed, self.model, world)


@pytest.fixture(scope="module")
def scene():
    return Scene()


def test_two_pictures_of_each_end_give_its_place(scene):
    found = scene.measure(*(tuple(scene.at(name, end) for name in ("001", "004", "006")) for end in ENDS))
    assert found.units == pytest.approx(1.2 * HALF, rel=1e-6)
    assert found.unit_scale_m == pytest.approx(0.6 / (1.2 * HALF), rel=1e-6)
    expected = HALF * (ENDS - [0.3, 0.2, 0.1]) @ np.eye(3)[[1, 2, 0]].T
    np.testing.assert_allclose(found.points, expected, atol=1e-6)


def test_a_point_behind_the_pictures_is_refused():
    """Two clicks swapped between two pictures side by side meet behind them."""
    poses = [np.hstack([np.eye(3), [[-x], [0], [0]]]) for x in (-0.5, 0.5)]
    rays = [np.array([x, 0, 1.0]) for x in (-0.2, 0.2)]
    sights = [
        SimpleNamespace(name=f"{k}.jpg", pose=p, ray=r, angle=1 / 500)
        for k, (p, r) in enumerate(zip(poses, rays, strict=True))
    ]
    with pytest.raises(Tg4mmError, match=r"0\.jpg, 1\.jpg meet behind 0\.jpg"):
        triangulated(sights)
    for sight, ray in zip(sights, reversed(rays), strict=True):
        sight.ray = ray
    np.testing.assert_allclose(triangulated(sights).xyz, [0, 0, 2.5], atol=1e-9)


def test_one_picture_takes_the_depth_from_the_points_around(scene):
    found = scene.measure(*((scene.at("002", end),) for end in ENDS))
    assert found.units == pytest.approx(1.2 * HALF, rel=1e-3)
    assert found.uncertainty_percent < 2


def test_the_uncertainty_is_that_of_clicks_a_pixel_off(scene):
    """The spread of many measurements with misplaced clicks is what a single one says of itself."""
    rng = np.random.default_rng(2)

    def clicked():
        ends = []
        for end in ENDS:
            pixels = [scene.at(name, end) for name in ("001", "003", "005")]
            off = lambda: rng.normal(0, CLICK_PX)  # noqa: E731
            ends.append(tuple((name, x + off(), y + off()) for name, x, y in pixels))
        return scene.measure(*ends)

    found = [clicked() for _ in range(60)]
    lengths = np.array([one.units for one in found])
    spread = 100 * lengths.std() / lengths.mean()
    said = float(np.median([one.uncertainty_percent for one in found]))
    assert 0.6 * spread < said < 1.8 * spread


def test_places_are_those_of_the_picture_set_upright(scene):
    """A photograph that is stored sideways is looked at, and pointed into, upright."""
    import dataclasses

    sideways = Scene()
    sideways.taken = [dataclasses.replace(shot, turns=3) for shot in sideways.taken]

    def upright(pixel):
        name, x, y = pixel
        return name, SIZE[1] - y, x  # np.rot90(…, 3): clockwise

    ends = [tuple(scene.at(name, end) for name in ("001", "004")) for end in ENDS]
    found = sideways.measure(*(tuple(upright(pixel) for pixel in end) for end in ends))
    np.testing.assert_allclose(found.points, scene.measure(*ends).points)


@pytest.mark.parametrize(
    ("first", "match"),
    [
        (lambda s: (("042", 1.0, 1.0),), r"--length names 042, which is not a picture; there are 001\.jpg"),
        (lambda s: (("lost.jpg", 1.0, 1.0),), r"--length: lost\.jpg could not be placed"),
        (lambda s: (("001", 700.0, 20.0),), "001 is 640×480 pixels, 700, 20 lies outside"),
        (
            lambda s: (s.at("001", ENDS[0]), s.at("004", ENDS[0] + [0, 0, 0.4])),
            "001, 004 do not show the same",
        ),
        (lambda s: (s.at("001", ENDS[0]),) * 2, r"001, 001 see the point in directions 0\.00° apart"),
        (lambda s: (s.at("001", ENDS[1]), s.at("004", ENDS[1])), "both ends are the same point"),
    ],
)
def test_ends_that_are_refused(scene, first, match):
    with pytest.raises(Tg4mmError, match=match):
        scene.measure(first(scene), (scene.at("001", ENDS[1]), scene.at("004", ENDS[1])))


def test_no_points_around():
    few = Scene(points=3)
    with pytest.raises(Tg4mmError, match=r"points are known within 51 pixels of .* at least 6 are needed"):
        few.measure(*((few.at("002", end),) for end in ENDS))


def test_a_length_of_nothing_and_two_lengths():
    end = (("a", 1.0, 1.0),)
    with pytest.raises(Tg4mmError, match=r"--length is 0\.0 m, expected a length above 0 m"):
        checked(SfmConfig(length=KnownLength((end, end), 0.0)))
    with pytest.raises(Tg4mmError, match=r"--length: a has the position nan, 1\.0, expected pixels"):
        checked(SfmConfig(length=KnownLength(((("a", float("nan"), 1.0),), end), 1.0)))
    with pytest.raises(Tg4mmError, match="--unit-scale-m and --length cannot be used together"):
        checked(SfmConfig(length=KnownLength((end, end), 1.0), unit_scale_m=2.0))


class TestFile:
    values: ClassVar = {
        "metres": 0.35,
        "points": [{"000.jpg": [210, 345.5], "008.jpg": [180, 350]}, {"000.jpg": [410, 350]}],
    }
    expected = KnownLength(
        ((("000.jpg", 210.0, 345.5), ("008.jpg", 180.0, 350.0)), (("000.jpg", 410.0, 350.0),)), 0.35
    )

    def test_json_and_yaml(self, tmp_path):
        (tmp_path / "a.json").write_text(json.dumps(self.values))
        assert read_length(tmp_path / "a.json") == self.expected
        (tmp_path / "a.yaml").write_text(
            "metres: 0.35\npoints:\n  - {000.jpg: [210, 345.5], 008.jpg: [180, 350]}\n  - 000.jpg: [410, 350]\n"
        )
        assert read_length(tmp_path / "a.yaml") == self.expected
