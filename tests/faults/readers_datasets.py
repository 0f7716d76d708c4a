"""Readers of the generator and of sfm: reports of datasets, what a killed job leaves, meshes, COLMAP's model."""

import gzip
import json

import numpy as np

from dataset_gen import run
from dataset_gen.errors import GenerateError
from dataset_gen.points import merge, read_view
from dataset_gen.processes import RunFailed
from dataset_gen.report.page import read_picture
from dataset_gen.sources.bodies_file import check
from dataset_gen.sources.mesh_file import count_not_finite
from tests.faults.mutate import of_bytes, of_header, of_json, of_npz, of_sealed
from tests.faults.reader import Reader, reading, record, sample
from tg4mm.capture.sfm.engine import colmap
from tg4mm.capture.sfm.mapping import registered, save_model, saved_model
from tg4mm.core.pictures import exr

TIMING = {"pictures": 12, "seconds": 34.5, "processes": 2}
BLEND = b"BLENDER-v405" + bytes(range(256)) * 8 + b"ENDB" + bytes(20)


def _read_former_timing(root):
    try:
        found = run._timing(root / "report" / "timing.json")
    except RunFailed as error:
        raise GenerateError(str(error)) from None
    json.dumps({key: found[key] + 1 for key in found}, allow_nan=False)


def _read_view_of_points(root):
    try:
        view = read_view(root / "r_000.npz", 8)
    except ValueError as error:
        raise GenerateError(str(error)) from None
    merge([view, view], 8)


def _mesh(kind):
    head = f"ply\nformat {kind} 1.0\ncomment a mesh\nelement vertex 4\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.arange(12, dtype="<f4").reshape(4, 3)
    body = rows.tobytes() + b"\x03" + np.arange(3, dtype="<i4").tobytes()
    if kind == "ascii":
        body = "\n".join([*(" ".join(map(str, row)) for row in rows.tolist()), "3 0 1 2\n"]).encode()
    return sample("a.ply", head.encode() + body)


def _points(file):
    rng = np.random.default_rng(0)
    np.savez(file, index=np.arange(0, 20, 3), colour=rng.random((7, 3)), weight=rng.random(7))


def _picture(file):
    file.write_bytes(exr.encode(np.random.default_rng(0).random((8, 12, 4)).astype(np.float32)))


def colmap_model():
    """A model of two images that see two points."""
    c = colmap("a test")
    model = c.Reconstruction()
    camera = c.Camera(model="SIMPLE_RADIAL", width=12, height=8, params=[20, 6, 4, 0.01], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    for i, name in enumerate(("a/r_2.png", "b.png"), 1):
        keypoints = np.array([[3.0, 4.0], [5.0, 6.0]])
        image = c.Image(name=name, keypoints=keypoints, camera_id=1, image_id=i)
        pose = c.Rigid3d(np.concatenate([np.eye(3), [[0.1 * i], [0], [4]]], 1))
        model.add_image_with_trivial_frame(image, pose)
    for k in range(2):
        track = c.Track([c.TrackElement(i, k) for i in (1, 2)])
        model.add_point3D(np.array([0.1, 0.2, 0.3 + k]), track, np.array([1, 2, 3], np.uint8))
    return model


def _sparse(name):
    """A model that COLMAP itself has written."""
    return sample(f"sparse/0/{name}", lambda file: save_model(colmap_model(), file.parent))


def _read_sparse(root):
    model = saved_model(root / "sparse" / "0")
    for image in registered(model).values():
        image.cam_from_world().matrix()
        model.cameras[image.camera_id].calibration_matrix()
    for point in model.points3D.values():
        [element.image_id for element in point.track.elements]


_read_blend = reading("a.blend", lambda file: check(file, (4, 5)))

DATASETS: dict[str, Reader] = {
    "dataset report: picture, EXR": Reader(
        sample("a.exr", _picture), reading("a.exr", read_picture), of_bytes
    ),
    "generate: timing.json": Reader(record("report/timing.json", TIMING), _read_former_timing, of_json),
    "generate: a view's points": Reader(sample("r_000.npz", _points), _read_view_of_points, of_npz),
    "generate: mesh PLY": Reader(
        _mesh("binary_little_endian"), reading("a.ply", count_not_finite), of_header
    ),
    "generate: mesh PLY, ASCII": Reader(_mesh("ascii"), reading("a.ply", count_not_finite), of_header),
    "generate: .blend header": Reader(sample("a.blend", BLEND), _read_blend, of_bytes),
    "generate: .blend header, packed": Reader(
        sample("a.blend", gzip.compress(BLEND, mtime=0)), _read_blend, of_bytes
    ),
    **{
        f"sfm sparse/0/{name}": Reader(_sparse(name), _read_sparse, of_bytes)
        for name in ("cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin")
    },
    "sfm sparse/0/digests.json": Reader(_sparse("digests.json"), _read_sparse, of_sealed),
}
