"""Readers of captures: the layouts of datasets, their pictures, points and ground truth."""

import json
import struct
from typing import Any

import numpy as np
from PIL import Image

from dataset_gen.report.page import find
from tests.capture.conftest import write_folder, write_tree
from tests.faults.mutate import of_bytes, of_header, of_json, of_npz, of_png, of_text
from tests.faults.reader import Reader, T
from tests.helpers.colmap import CAMERAS, IMAGES, POINTS, pictures
from tg4mm.capture import load_capture, load_images
from tg4mm.capture.truth_file import load_truth
from tg4mm.core.pictures import exr, png
from tg4mm.show.render.cameras import cameras_from_file

SCENE = {
    "fps": 30, "n_timesteps": T, "unit_scale_m": 0.01, "kind": "rig", "alphas": [5], "modes": [{"name": "a"}],
    "width": 12, "height": 8, "format_version": 1, "amplitude": 0.02,
}  # fmt: skip


def _capture(root):
    load_images(load_capture(root))


def _tree(name, sized=False):
    """A dataset's folder; `sized`: with the pictures' size beside each pose."""

    def make(root):
        write_tree(root, T, SCENE)
        for file in root.rglob("transforms_*.json") if sized else ():
            file.write_text(json.dumps(json.loads(file.read_text()) | {"w": 12, "h": 8}))
        return root / name

    return make


def _truth(root):
    _tree("", sized=True)(root)
    rng = np.random.default_rng(0)
    arrays: dict[str, Any] = {"objects": np.array(["a", "ü"]), "frequencies_hz": np.array([0.0, 5.0])}
    arrays |= {"gains": rng.normal(size=(2, T)) + 0j, "magnified": np.array([True, False])}
    for i in range(2):
        arrays[f"rest_{i}"] = rng.normal(size=(4, 3)).astype(np.float32)
        arrays[f"faces_{i}"] = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        arrays[f"mode_{i}"] = rng.normal(size=(2, 4, 3)).astype(np.complex64)
    (root / "truth").mkdir()
    np.savez_compressed(root / "truth" / "motion.npz", **arrays)
    return root / "truth" / "motion.npz"


def _nerfstudio(root):
    write_folder(root)
    values = json.loads((root / "transforms_train.json").read_text())
    (root / "transforms_train.json").unlink()
    values |= {"camera_model": "OPENCV", "k1": 0.0, "fl_x": 20.0, "fl_y": 20.0, "cx": 6, "cy": 4}
    values |= {"w": 12, "h": 8}
    values |= {"train_filenames": [f["file_path"] for f in values["frames"]], "ply_file_path": "p.ply"}
    (root / "transforms.json").write_text(json.dumps(values))
    _ply(root, "p.ply")
    return root / "transforms.json"


def _ply(root, name="points3d.ply"):
    if name == "points3d.ply":
        write_folder(root)
    fields = {"float": "xyz", "uchar": ("red", "green", "blue")}
    lines = [f"property {kind} {axis}" for kind, axes in fields.items() for axis in axes]
    head = "\n".join(["ply", "format binary_little_endian 1.0", "element vertex 4", *lines, "end_header\n"])
    rows = np.zeros(4, [("x", "<f4", 3), ("c", "u1", 3)])
    rows["x"] = np.arange(12).reshape(4, 3)
    (root / name).write_bytes(head.encode() + rows.tobytes())
    return root / name


def _colmap(name):
    def make(root):
        pictures(root)
        model = root / "sparse" / "0"
        model.mkdir(parents=True)
        if name.endswith(".bin"):
            _colmap_binary(model)
        for stem, text in (("cameras", CAMERAS), ("images", IMAGES), ("points3D", POINTS)):
            if name.endswith(".txt"):
                (model / f"{stem}.txt").write_text(text)
        return model / name

    return make


def _colmap_binary(model):
    """By hand: COLMAP's own library in the process makes some mutations hang under the memory limit."""
    (model / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 1, 1, 12, 8, 20, 21, 6, 4.5))
    images, points = struct.pack("<Q", 2), struct.pack("<Q", 2)
    for i, name in enumerate((b"a/r_2.png", b"b.png")):
        images += struct.pack("<i7di", i + 1, 1, 0, 0, 0, 0, 0, 4 + i, 1) + name + b"\0"
        images += struct.pack("<Q2dq", 1, 3.5, 4.5, 7)
        points += struct.pack("<Q3d3BdQ2i", i, 1.5, 2.5, i, 10, 20, 30, 0.25, 1, 1, 0)
    (model / "images.bin").write_bytes(images)
    (model / "points3D.bin").write_bytes(points)


def _picture(suffix, deep=False):
    def make(root):
        write_folder(root)
        pixels = np.random.default_rng(0).integers(0, 256, (8, 12, 4), np.uint8)
        (root / "train" / "r_000.png").unlink()
        path = root / "train" / f"r_000{suffix}"
        if suffix == ".exr":
            path.write_bytes(exr.encode(pixels.astype(np.float32) / 255))
        elif deep:
            path.write_bytes(png.encode(pixels.astype(np.uint16) * 257))
        elif suffix == ".png":
            path.write_bytes(png.encode(pixels))
        else:
            Image.fromarray(pixels[..., :3]).save(path)
        return path

    return make


CAPTURES: dict[str, Reader] = {
    "scene.json": Reader(_tree("scene.json"), _capture, of_json),
    "transforms": Reader(_tree("001/transforms_train.json"), _capture, of_json),
    "nerfstudio": Reader(_nerfstudio, _capture, of_json),
    "points3d.ply": Reader(_ply, _capture, of_header),
    **{
        f"colmap {name}.{ending}": Reader(_colmap(f"{name}.{ending}"), _capture, mutate)
        for ending, mutate in (("bin", of_bytes), ("txt", of_text))
        for name in ("cameras", "images", "points3D")
    },
    "PNG, 8 bits": Reader(_picture(".png"), _capture, of_png),
    "PNG, 16 bits": Reader(_picture(".png", deep=True), _capture, of_png),
    "JPEG": Reader(_picture(".jpg"), _capture, of_bytes),
    "EXR": Reader(_picture(".exr"), _capture, of_bytes),
    "cameras file": Reader(
        _nerfstudio, lambda root: cameras_from_file(root / "transforms.json", (12, 8)), of_json
    ),
    "truth motion.npz": Reader(_truth, lambda root: load_truth(root, 30.0, T), of_npz),
    "dataset report: scene.json": Reader(_tree("scene.json", sized=True), find, of_json),
    "dataset report: transforms": Reader(_tree("001/transforms_train.json", sized=True), find, of_json),
    "dataset report: motion.npz": Reader(_truth, find, of_npz),
}
