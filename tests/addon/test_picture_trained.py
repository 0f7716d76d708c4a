"""A trained scene in Cycles beside the core's rasteriser: what an exported file shows is what was trained.

mic_64.ply is the microphone of [3DMM]'s data, trained at 64×64 (2,500 Gaussians, degree 1), scales as trained;
mic_64.png is what the core draws of it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tg4mm.core.splatfile import read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")
import mathutils  # noqa: E402

from tests.addon.playing import add_camera, import_splat, render_cycles, setter  # noqa: E402

HERE = Path(__file__).parent
TRAINED, SIZE = 64, 160  # pixels
FOCAL = 88.8889  # pixels of a training picture
DISTANCE = 4.0311  # of every training camera
PLACE = (-1.135, -2.957, 2.494)  # of a test camera
AGREEMENT = 33.0  # dB


def psnr(a, b):
    return float(-10 * np.log10(np.square(a - b).mean()))


def smoothing(splat):
    """[N] variances of the exporter's filter, for a ring of the training cameras."""
    from tg4mm.capture import Capture
    from tg4mm.show.export.lowpass import smoothing_variance

    K = np.array([[FOCAL, 0, TRAINED / 2], [0, FOCAL, TRAINED / 2], [0, 0, 1]])
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    places = DISTANCE * np.stack([0.8 * np.cos(turns), 0.8 * np.sin(turns), 0.6 + 0 * turns], axis=1)
    viewmats = np.stack([viewmat(place) for place in places])
    ids = np.arange(len(turns))
    Ks = np.tile(K, (len(turns), 1, 1))
    capture = Capture(HERE, "train", TRAINED, TRAINED, 0.0, 1, viewmats, Ks, 0 * ids, ids, (HERE,) * 12)
    variance = smoothing_variance(splat.means.astype(np.float64), capture)
    nearest = (splat.means @ viewmats[:, 2, :3].T + viewmats[:, 2, 3]).min(axis=1)  # of the cameras, by depth
    assert np.median(variance) == pytest.approx(0.3 * np.median(nearest / FOCAL) ** 2, rel=0.05)
    return variance


def exported(splat):
    """The trained Gaussians as `tg4mm export` writes them: as wide as training drew them."""
    from tg4mm.show.export.lowpass import widened

    scales = widened(splat.scales, smoothing(splat)).astype(np.float32)
    return replace(splat, scales=scales, low_pass_px2=0.3)


def viewmat(place):
    """[4, 4] world-to-camera, OpenCV axes, of a camera that looks at the origin."""
    turn = (-mathutils.Vector(place)).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    pose = np.array(mathutils.Matrix.Translation(place) @ turn)
    return np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(pose)


def trained(splat):
    """[SIZE, SIZE, 3] the core's picture as `tg4mm render` draws it from close up, over white."""
    torch = pytest.importorskip("torch", reason="compares with the core's rasteriser: pip install '.[core]'")
    pytest.importorskip("numba", reason="compares with the core's rasteriser: pip install '.[core]'")
    from tg4mm.fit.rasterize import rasterization
    from tg4mm.show.export.lowpass import lacking, widened

    focal, view = FOCAL * SIZE / TRAINED, viewmat(np.array(PLACE))
    K = np.array([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1.0]])
    extra = lacking(splat.means.astype(np.float64), smoothing(splat), (view, K, SIZE, SIZE))
    assert extra is not None
    arrays = (splat.means, splat.quats, widened(splat.scales, extra), splat.opacities, splat.sh)
    tensors = [torch.as_tensor(a, dtype=torch.float32) for a in (*arrays, view[None], K[None])]
    rgb, _, _ = rasterization(
        *tensors, SIZE, SIZE, eps2d=0.3, sh_degree=splat.sh_degree, backgrounds=torch.ones(1, 3)
    )
    return rgb[0].clamp(0, 1).numpy()


def stored():
    """The same from a file, for environments without torch."""
    return np.asarray(Image.open(HERE / "mic_64.png").convert("RGB"), dtype=float) / 255


def in_blender(extension, path, splat, as_trained=False):
    """[SIZE, SIZE, 3] Cycles' picture of the file's splats, over white."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    write_splat(path, splat)
    obj = import_splat(path)
    put, names = setter(extension, obj), extension.names
    put(names.DRAW, "Splats")
    put(names.VIEW_COLOUR, True)
    bpy.ops.tg4mm.blend_as_trained(on=as_trained)
    camera = add_camera(PLACE, (SIZE, SIZE))
    camera.data.angle = 2 * np.arctan(TRAINED / 2 / FOCAL)
    render_cycles(path.with_suffix(".png"), samples=4, clear=True)
    rgba = np.asarray(Image.open(path.with_suffix(".png")), dtype=float) / 255
    return rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]


def test_the_stored_picture_is_the_cores(extension):
    assert psnr(trained(read_splat(HERE / "mic_64.ply")), stored()) > 50


@pytest.mark.slow
def test_an_exported_file_shows_in_blender_what_was_trained(extension, tmp_path):
    """And without the low-pass in its scales it does not."""
    splat = read_splat(HERE / "mic_64.ply")
    wanted = stored()
    found = psnr(in_blender(extension, tmp_path / "exported.ply", exported(splat)), wanted)
    thin = psnr(in_blender(extension, tmp_path / "thin.ply", splat), wanted)
    mixed = psnr(in_blender(extension, tmp_path / "mixed.ply", exported(splat), as_trained=True), wanted)
    print(f"exported {found:.1f} dB, blended as trained {mixed:.1f} dB, scales as trained {thin:.1f} dB")
    assert found >= AGREEMENT
    assert mixed >= AGREEMENT + 2
    assert thin < AGREEMENT - 6
