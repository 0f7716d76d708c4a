"""Bad datasets: each is refused with one line that names the file and the value."""

import json
import math
import os
import re
import shutil
import struct
import zlib

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData, PlyElement

from tests.capture.conftest import edit, refused
from tg4mm.capture import load_capture, load_images

XYZ = [("x", "f4"), ("y", "f4"), ("z", "f4")]


def test_what_is_no_dataset(tmp_path):
    refused(tmp_path / "nowhere", "nowhere", "does not exist")
    refused(tmp_path, str(tmp_path), "is not a dataset", "transforms_train.json", "scene.json")
    (tmp_path / "a.txt").write_text("x")
    refused(tmp_path / "a.txt", "a.txt", "is not a folder")
    (tmp_path / "scene.json").write_text('{"fps": 30}')
    refused(tmp_path, "no timestep folders")


def test_splits_that_are_not_there(folder, tree):
    refused(folder, "split '../x'", "train, test, val", split="../x")
    refused(folder, "transforms_test.json", "no 'test' split", split="test")
    (tree / "001" / "transforms_test.json").unlink()
    refused(tree, "001/transforms_test.json", "does not exist", split="test")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ('{"frames": [', "not valid JSON"),
        ("\xff\xfe", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ("[1, 2]", "[1, 2]; expected a JSON object"),
        ('{"frames": 7}', "frames is 7"),
        ('{"camera_angle_x": 0.5, "frames": []}', "frames is empty"),
        ('{"camera_angle_x": 0.5}', "frames is missing"),
        ('{"frames": [3]}', "frame 0 is 3"),
        ('{"camera_angle_x": 0.5, "frames": [{"file_path": "train/r_000"}]}', "transform_matrix is missing"),
    ],
)
def test_bad_json(folder, text, part):
    (folder / "transforms_train.json").write_text(text, encoding="latin-1")
    refused(folder, "transforms_train.json", part)


def pose(change):
    """A change of the pose of frame 1."""
    return lambda file: change(file["frames"][1]["transform_matrix"])


def first(**values):
    """Values of frame 0."""
    return lambda file: file["frames"][0].update(values)


BAD = {
    "nan": (pose(lambda p: p[0].__setitem__(3, math.nan)), "frame 1", "holds nan"),
    "text": (pose(lambda p: p[1].__setitem__(3, "1.0")), "frame 1", "holds '1.0'"),
    "huge": (pose(lambda p: p[1].__setitem__(3, 10**400)), "holds a whole number of 401 digits"),
    "far away": (pose(lambda p: p[2].__setitem__(3, -1e300)), "frame 1", "lies 1e+300 units from the origin"),
    "three rows": (pose(lambda p: p.pop()), "frame 1", "has shape 3×4"),
    "ragged": (pose(lambda p: p[0].pop()), "frame 1", "4 rows of unequal length"),
    "scaled": (
        pose(lambda p: p[0].__setitem__(slice(0, 3), [2 * x for x in p[0][:3]])),
        "frame 1",
        "is not rigid",
    ),
    "mirrored": (pose(lambda p: [row.__setitem__(0, -row[0]) for row in p[:3]]), "frame 1", "determinant -1"),
    "projective": (pose(lambda p: p[3].__setitem__(0, 0.1)), "frame 1", "last row is [0.1, 0.0, 0.0, 1.0]"),
    "text for a pose": (first(transform_matrix="eye"), "frame 0", "has shape none (str)"),
    "angle": (
        lambda v: v.update(camera_angle_x=0),
        "camera_angle_x is 0; expected a finite number above 1e-06 and",
    ),
    "angle as text": (lambda v: v.update(camera_angle_x="0.7"), "camera_angle_x is '0.7'"),
    "focal length": (lambda v: v.update(fl_x=20, fl_y=0), "fl_y is 0"),
    "width": (lambda v: v.update(w=13), "w is 13; expected 12, as the image is 12×8"),
    "lens": (lambda v: v.update(k1=0.1), "k1 is 0.1; expected 0: undistort"),
    "time nan": (first(time=math.nan), "frame 0", "time is nan"),
    "time inf": (first(time=math.inf), "frame 0", "time is inf"),
    "time as text": (first(time="now"), "frame 0", "time is 'now'"),
    "twice": (first(file_path="train/r_001.png"), "frame ", "r_001.png is already that of another frame"),
    "outside": (first(file_path="../outside"), "frame 0", "leads outside"),
    "outside by a detour": (first(file_path="train/../../outside.png"), "frame 0", "leads outside"),
    "absolute": (first(file_path="/etc/passwd"), "frame 0", "'/etc/passwd' is absolute"),
    "drive": (first(file_path="C:\\x.png"), "frame 0", "is absolute"),
    "absent": (
        first(file_path="train/r_777"),
        "frame 0",
        "r_777 does not exist (tried .png, .jpg, .jpeg, .exr, .w",
    ),
    "absent with suffix": (first(file_path="train/r_777.png"), "frame 0", "r_777.png does not exist"),
    "null": (first(file_path="train/nul\0.png"), "frame 0", "not a usable path"),
    "empty path": (first(file_path=""), "frame 0", "file_path is ''"),
    "number for a path": (first(file_path=5), "frame 0", "file_path is 5"),
    "no path": (first(file_path=None), "frame 0", "file_path is None"),
}


@pytest.mark.filterwarnings("error")  # a warning would be a second line on the terminal
@pytest.mark.parametrize("name", BAD)
def test_bad_values(folder, name):
    shutil.copy(folder / "train/r_000.png", folder.parent / "outside.png")
    change, *parts = BAD[name]
    edit(folder / "transforms_train.json", change)
    refused(folder, "transforms_train.json", *parts)


def test_a_link_that_leaves_the_folder(folder):
    outside = folder.parent / "outside.png"
    os.replace(folder / "train/r_001.png", outside)
    (folder / "train/r_001.png").symlink_to(outside)
    refused(folder, "frame 1", "r_001.png leads outside", str(folder))


@pytest.mark.parametrize("name", ["scene.json", "points3d.ply", "000", "000/transforms_train.json"])
def test_no_part_of_a_tree_may_be_a_link_to_elsewhere(tree, name):
    outside = tree.parent / "outside"
    if (tree / name).exists():
        os.replace(tree / name, outside)
    else:
        outside.write_text("x")
    (tree / name).symlink_to(outside)
    refused(tree, "leads outside", name)


def test_sizes_that_differ(tree):
    Image.new("RGBA", (12, 9)).save(tree / "002/train/r_001.png")
    refused(tree, "002/train/r_001.png: is 12×9 pixels", "000/train/r_000.png is 12×8")


@pytest.mark.parametrize(
    ("scene", "part"),
    [
        ({}, "fps is missing"),
        ({"fps": 0}, "fps is 0; expected a finite number above 0"),
        ({"fps": 1e300}, "fps is 1e+300; expected a finite number above 0 and below 1e+09"),
        ({"fps": 30, "n_timesteps": 4}, "n_timesteps is 4, but"),
        ({"fps": 30, "unit_scale_m": 0}, "unit_scale_m is 0"),
        ({"fps": 30, "readout_s": 0.05}, "readout_s is 0.05; expected 0 to 0.0333333: seconds from"),
        ({"fps": 30, "alphas": 5}, "alphas is 5"),
        ({"fps": 30, "alphas": ["x"]}, "alphas[0] is 'x'"),
        ({"fps": 30, "modes": {}}, "modes is {}"),
        ({"fps": 30, "modes": [1]}, "modes[0] is 1"),
        ({"fps": 30, "engine": "cycles"}, "engine is 'cycles'"),
        (
            {"fps": 30, "kind": "drone"},
            "kind is 'drone'; expected one of photos, flat, tripod, handheld, rig",
        ),
        ({"fps": 30, "clocks": "mine"}, "clocks is 'mine'; expected one of synchronous, independent"),
        ({"fps": 30, "pixels_per_unit": "x"}, "pixels_per_unit is 'x'"),
        ({"fps": 30, "format_version": 2}, "format_version is 2; expected 1"),
        ([30], "[30]; expected a JSON object"),
    ],
)
def test_bad_scene_json(tree, scene, part):
    (tree / "scene.json").write_text(json.dumps(scene))
    refused(tree, "scene.json", part)


def test_missing_scene_json_says_what_to_write(tree):
    (tree / "scene.json").unlink()
    refused(tree, "scene.json", "does not exist", '{"fps": <frames per second>}')


def test_one_timestep_twice(tree):
    shutil.copytree(tree / "001", tree / "1")
    refused(tree, "is the same timestep 1 as 001")


def test_ground_truth_that_is_not_there(tree, folder):
    refused(tree, "x010: does not exist", "α = 10", "magnified/x005", magnification=10)
    shutil.rmtree(tree / "magnified")
    refused(tree, "x005", "no magnified/x… folder", magnification=5)
    refused(folder, "a single timestep", "α = 5 is not available", magnification=5)


@pytest.mark.parametrize("alpha", [2.5, -1, math.nan, math.inf])
def test_magnification_without_a_folder_name(tree, alpha):
    refused(tree, f"magnification {alpha}", magnification=alpha)


def test_a_truncated_png_is_named(folder):
    path = folder / "train/r_001.png"
    Image.effect_noise((12, 8), 50).convert("RGBA").save(path)
    path.write_bytes(path.read_bytes()[:-40])
    capture = load_capture(folder)
    refused(lambda: load_images(capture), "r_001.png: cannot be decoded")


@pytest.mark.parametrize(
    "content", [b"", b"GIF89a" + bytes(40), b"\x89PNG\r\n\x1a\n", b"not an image at all"]
)
def test_a_file_that_is_no_image(folder, content):
    (folder / "train/r_000.png").write_bytes(content)
    refused(folder, "r_000.png")


def test_a_cmyk_jpeg(folder):
    Image.new("CMYK", (12, 8)).save(folder / "train/r_000.png", format="JPEG")
    refused(folder, "r_000.png: has colour mode CMYK")


def test_an_image_that_claims_to_be_enormous(folder):
    path = folder / "train/r_000.png"
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", 60_000, 60_000)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    path.write_bytes(bytes(data))
    refused(folder, "r_000.png: cannot be decoded", "3600000000 pixels")


def test_an_image_that_vanishes_or_changes_size_before_it_is_decoded(folder):
    capture = load_capture(folder)
    Image.new("RGBA", (5, 5)).save(folder / "train/r_000.png")
    refused(lambda: load_images(capture), "r_000.png: is 5×5 pixels, expected 12×8")
    (folder / "train/r_000.png").unlink()
    refused(lambda: load_images(capture), "r_000.png: cannot be decoded: ", "No such file")


def ply(path, data, element="vertex"):
    PlyData([PlyElement.describe(data, element)]).write(str(path))


def test_bad_points(folder):
    path = folder / "points3d.ply"
    path.write_bytes(b"nonsense")
    refused(folder, "points3d.ply: is not a readable PLY")
    ply(path, np.zeros(3, XYZ))
    path.write_bytes(path.read_bytes()[:-5])
    refused(folder, "points3d.ply: is not a readable PLY")
    path.write_bytes(re.sub(rb"vertex \d+", b"vertex 99999999999999", path.read_bytes()))
    refused(folder, "points3d.ply: is not a readable PLY")
    ply(path, np.zeros(0, XYZ))
    refused(folder, "points3d.ply: holds 0 points")
    ply(path, np.zeros(3, XYZ), element="face")
    refused(folder, "points3d.ply: has no vertex element")
    ply(path, np.zeros(3, XYZ[:2]))
    refused(folder, "points3d.ply: property z is missing; there is x, y")
    nan = np.zeros(3, XYZ)
    nan["y"][1] = np.nan
    ply(path, nan)
    refused(folder, "points3d.ply: point 1 is [0.0, nan, 0.0]")
    ply(path, np.zeros(3, [*XYZ, ("red", "f4"), ("green", "f4"), ("blue", "f4")]))
    refused(folder, "points3d.ply: property red is float32; expected uchar")
    ply(path, np.zeros(3, [*XYZ, ("red", "u1")]))
    refused(folder, "points3d.ply: property green is missing")


@pytest.mark.parametrize("value", [[], {}, [["a"]], 3, None, "a" * 5000, "a\0b", "../../../etc/passwd"])
def test_a_nerfstudio_file_path_of_any_kind_is_one_line(folder, value):
    values = json.loads((folder / "transforms_train.json").read_text())
    (folder / "transforms_train.json").unlink()
    values |= {"train_filenames": [frame["file_path"] for frame in values["frames"]]}
    values["frames"].append(dict(values["frames"][0], file_path=value))
    (folder / "transforms.json").write_text(json.dumps(values))
    if isinstance(value, str):  # text that the split does not list is none of its frames
        assert len(load_capture(folder)) == 2
    else:
        refused(folder, "transforms.json: frame 2", "file_path")


def tiny_png(width, height, bits, colour_type):
    """A PNG of some 65 bytes whose header promises whatever it likes."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, 0))]
    chunks += [(b"IDAT", zlib.compress(b"\0" * 40)), (b"IEND", b"")]
    sealed = (struct.pack(">I", len(b)) + k + b + struct.pack(">I", zlib.crc32(k + b)) for k, b in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(sealed)


@pytest.mark.parametrize(("bits", "colour_type"), [(8, 6), (16, 6), (1, 0), (8, 2)])
def test_a_picture_that_promises_more_than_it_can_hold_is_refused_unopened(folder, bits, colour_type):
    """Before the memory of all pictures together is asked for: 13,000² pixels are 700 MB each."""
    for path in (folder / "train").glob("*.png"):
        path.write_bytes(tiny_png(13_000, 13_000, bits, colour_type))
    refused(folder, "13000×13000 pixels do not fit in its", "bytes")


def test_pictures_that_no_memory_holds_are_one_line(folder, monkeypatch):
    def empty(shape, kind):
        raise MemoryError

    capture = load_capture(folder)
    monkeypatch.setattr(np, "empty", empty)
    refused(lambda: load_images(capture), "2 pictures of 12×8 pixels need 0.0 GiB of memory")
