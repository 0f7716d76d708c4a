"""nerfstudio's transforms.json: what is read, and what is refused."""

import json
import logging

import numpy as np
import pytest
from plyfile import PlyData, PlyElement
from scipy.interpolate import LinearNDInterpolator

from tests.capture.conftest import SIZE, edit, pose, refused, write_folder
from tests.capture.test_real_captures import save, seen
from tg4mm.capture import load_capture, load_images


@pytest.fixture
def studio(tmp_path):
    """Three pictures in images/, intrinsics of the file, as ns-process-data writes them."""
    folder = write_folder(tmp_path / "studio", "images", views=3)
    (folder / "transforms_images.json").unlink()
    width, height = SIZE
    lens = {"k1": 0.0, "k2": 0, "p1": 0.0, "p2": 0.0, "camera_model": "OPENCV"}
    values = {"fl_x": 20.0, "fl_y": 21.0, "cx": 6.0, "cy": 4.5, "w": width, "h": height, **lens}
    values["frames"] = [
        {"file_path": f"images/r_{i:03d}.png", "transform_matrix": pose(0.3 + i), "colmap_im_id": i}
        for i in range(3)
    ]
    (folder / "transforms.json").write_text(json.dumps(values))
    return folder


def test_cameras_are_those_of_the_same_poses_in_nerf_synthetics_layout(studio, tmp_path):
    capture = load_capture(studio)
    twin = load_capture(write_folder(tmp_path / "twin", "train", views=3))
    np.testing.assert_array_equal(capture.viewmats, twin.viewmats)
    assert capture.Ks[0].tolist() == [[20, 0, 6], [0, 21, 4.5], [0, 0, 1]]
    assert (capture.n_timesteps, capture.fps, capture.split, capture.points) == (1, 0.0, "train", None)
    assert load_images(capture).data[:, 0, 0, 0].tolist() == [100, 101, 102]


def test_splits_are_the_files_own_lists(studio):
    train, test = ["images/r_002.png", "images/r_000.png"], ["images/r_001.png"]
    edit(studio / "transforms.json", lambda v: v.update(train_filenames=train, test_filenames=test))
    assert [p.name for p in load_capture(studio).paths] == ["r_000.png", "r_002.png"]
    assert [p.name for p in load_capture(studio, "test").paths] == ["r_001.png"]
    refused(studio, "has no val_filenames", "no 'val' split", split="val")


def test_points_come_from_the_named_file(studio):
    data = np.zeros(4, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4")])
    data["x"] = range(4)
    PlyData([PlyElement.describe(data, "vertex")]).write(str(studio / "sparse_pc.ply"))
    edit(studio / "transforms.json", lambda v: v.update(ply_file_path="sparse_pc.ply"))
    points = load_capture(studio).points
    assert points.xyz[:, 0].tolist() == [0, 1, 2, 3]
    edit(studio / "transforms.json", lambda v: v.update(ply_file_path="gone.ply"))
    refused(studio, "ply_file_path is 'gone.ply', which does not exist")
    edit(studio / "transforms.json", lambda v: v.update(ply_file_path="../x.ply"))
    refused(studio, "leads outside the dataset's folder")


@pytest.mark.parametrize("outside", ["..\\..\\x.png", "\\x.png", "C:\\x.png", "images\\..\\..\\x.png"])
def test_paths_with_backslashes_are_those_of_windows_and_stay_inside(studio, outside):
    (studio.parent.parent / "x.png").write_bytes((studio / "images/r_000.png").read_bytes())
    (studio.parent / "x.png").write_bytes((studio / "images/r_000.png").read_bytes())

    def back(v):
        for frame in v["frames"]:
            frame["file_path"] = frame["file_path"].replace("/", "\\")

    edit(studio / "transforms.json", back)
    assert [p.name for p in load_capture(studio).paths] == ["r_000.png", "r_001.png", "r_002.png"]
    edit(studio / "transforms.json", lambda v: v["frames"][0].update(file_path=outside))
    refused(studio, "frame 0")


def test_missing_pictures_are_left_out_and_counted_unless_they_are_half(studio, caplog):
    whole = load_capture(studio)
    (studio / "images/r_001.png").unlink()
    with caplog.at_level(logging.WARNING, "tg4mm"):
        capture = load_capture(studio)
        load_capture(studio)
    assert caplog.text.count("transforms.json: 1 of 3 pictures are missing and left out") == 1
    np.testing.assert_array_equal(capture.viewmats, whole.viewmats[[0, 2]])
    (studio / "images/r_002.png").unlink()
    refused(studio, "r_001.png does not exist; 2 of 3 pictures are missing")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda v: v.update(camera_model="THIN_PRISM"), ("camera_model is 'THIN_PRISM'", "undistort")),
        (lambda v: v.update(camera_model="OPENCV_FISHEYE", p1=0.1), ("p1 is 0.1; expected 0",)),
        (lambda v: v["frames"][0].update(camera_model="EQUIRECTANGULAR"), ("'EQUIRECTANGULAR'",)),
        (lambda v: v.update(frames=[]), ("frames is []; expected a list of frames",)),
        (lambda v: v["frames"].__setitem__(1, 7), ("frame 1 is 7; expected an object",)),
        (lambda v: v["frames"][0].update(file_path="../../x.png"), ("leads outside",)),
        (lambda v: v.update(train_filenames=["images/x.png"]), ("train_filenames names 'images/x.png'",)),
        (lambda v: v.update(train_filenames=[]), ("train_filenames is empty",)),
        (lambda v: v.update(train_filenames="all"), ("train_filenames is 'all'; expected a list",)),
        (lambda v: v.update(w=99), ("w is 99; expected 12",)),
    ],
)
def test_bad_files_are_refused(studio, change, parts):
    edit(studio / "transforms.json", change)
    refused(studio, *parts)


@pytest.mark.parametrize(
    ("field", "value", "is_refused"),
    [
        ("is_fisheye", True, True),
        ("is_fisheye", False, False),
        ("equirectangular", True, True),
        ("orthographic", True, True),
        ("ftheta_p1", 0.0258, True),
        ("distortion_params", [0.05, 0, 0, 0], True),
        ("distortion_params", [0, 0, 0, 0], False),
        ("rolling_shutter", [0, 0, 0.01, 0], True),
    ],
)
@pytest.mark.parametrize("where", ["file", "frame"])
def test_a_lens_that_is_no_pinholes_is_refused_by_its_field(studio, field, value, is_refused, where):
    edit(
        studio / "transforms.json",
        lambda v: (v if where == "file" else v["frames"][1]).update({field: value}),
    )
    if is_refused:
        refused(studio, f"{field} is ", "undistort")
    else:
        assert len(load_capture(studio)) == 3


@pytest.mark.parametrize(
    ("model", "bends"),
    [
        ("OPENCV", {"k1": -0.2, "k2": 0.05, "p1": 0.004, "p2": -0.003}),
        ("OPENCV", {"k1": -0.2, "k3": 0.02}),
        ("OPENCV_FISHEYE", {"k1": 0.02}),
        ("OPENCV_FISHEYE", {}),
    ],
)
def test_a_lens_that_bends_is_straightened(studio, model, bends):
    """A known scene through OpenCV's own formulas is that of the pinhole, away from the edge."""
    size, focal, middle = (64, 48), (60.0, 61.0), (31.0, 24.0)
    values = {"fl_x": focal[0], "fl_y": focal[1], "cx": middle[0], "cy": middle[1], "w": 64, "h": 48}
    edit(studio / "transforms.json", lambda v: v.update(values, camera_model=model, **bends))
    straight = np.stack(np.meshgrid(np.linspace(-0.9, 0.9, 140), np.linspace(-0.7, 0.7, 120)), -1)
    pixels = bent(straight, model, bends) * focal + middle
    rays = LinearNDInterpolator(pixels.reshape(-1, 2), straight.reshape(-1, 2))
    at = np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), -1)
    for k in range(3):
        save(studio / f"images/r_{k:03d}.png", seen(*np.moveaxis(rays(at), -1, 0)))
    capture = load_capture(studio)
    K, (width, height) = capture.Ks[0], (capture.width, capture.height)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    wanted = seen((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1])
    found = load_images(capture).data[1, ..., :3] / 255
    assert np.abs(found - wanted)[3:-3, 3:-3].max() < 3 / 255
    assert max(width - size[0], height - size[1]) <= 0.6 * size[0]


def bent(rays, model, bends):
    """Where OpenCV's lens puts rays [..., 2]: docs.opencv.org, calib3d, "Detailed Description" and fisheye."""
    k = [bends.get(f"k{i}", 0.0) for i in range(1, 7)]
    x, y = np.moveaxis(rays, -1, 0)
    r = np.hypot(x, y)
    if model == "OPENCV_FISHEYE":
        a = np.arctan(r)
        factor = a * (1 + k[0] * a**2 + k[1] * a**4 + k[2] * a**6 + k[3] * a**8) / np.maximum(r, 1e-12)
        return rays * factor[..., None]
    p1, p2 = bends.get("p1", 0.0), bends.get("p2", 0.0)
    radial = 1 + k[0] * r**2 + k[1] * r**4 + k[2] * r**6
    x2 = x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
    y2 = y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([x2, y2], -1)


def test_two_fields_of_view_are_two_focal_lengths(studio):
    width, height = SIZE
    angles = {"camera_angle_x": 2 * np.arctan(width / 40), "camera_angle_y": 2 * np.arctan(height / 42)}

    edit(studio / "transforms.json", lambda v: (v.pop("fl_x"), v.pop("fl_y"), v.update(angles)))
    np.testing.assert_allclose(load_capture(studio).Ks[0].diagonal(), [20, 21, 1])
    edit(studio / "transforms.json", lambda v: v.pop("camera_angle_x"))
    np.testing.assert_allclose(load_capture(studio).Ks[0].diagonal(), [21, 21, 1])


class TestTimes:
    """Frames of one file that have times are of timesteps."""

    def timed(self, studio, times, **values):
        def change(file):
            file.update(values)
            for frame, time in zip(file["frames"], times, strict=True):
                frame["time"] = time

        edit(studio / "transforms.json", change)

    @pytest.mark.parametrize(
        ("times", "timesteps", "ticks"),
        [
            ([0.0, 0.5, 1.0], [0, 1, 2], [0, 1, 2]),
            ([4.0, 4.1, 4.2], [0, 1, 2], [0, 1, 2]),
            ([0.0, 0.25, 1.0], [0, 1, 4], [0, 1, 4]),  # a gap is timesteps without pictures
            ([0.0, 0.1, 0.1], [0, 1, 1], [0, 1, 1]),
            ([0.0, 0.25, 0.6], [0, 1, 2], [0, 0.25 / 0.3, 2]),  # uneven: the median step is the rate's
        ],
    )
    def test_the_rate_makes_them_timesteps(self, studio, times, timesteps, ticks):
        self.timed(studio, times, fps=10.0)
        capture = load_capture(studio)
        assert (capture.n_timesteps, capture.fps) == (timesteps[-1] + 1, 10.0)
        assert capture.timesteps.tolist() == timesteps
        np.testing.assert_allclose(capture.times_s, np.array(ticks) / 10)

    def test_without_a_rate_they_are_refused(self, studio):
        self.timed(studio, [0.0, 0.5, 1.0])
        refused(studio, "its frames have 3 different times, but no rate is known", '"fps": <frames per se')
        (studio / "scene.json").write_text('{"fps": 12}')
        assert load_capture(studio).fps == 12
