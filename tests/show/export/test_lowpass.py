"""The low-pass in exported scales: as wide as the rasteriser's own seen from a training camera, right at any size."""

from dataclasses import replace

import gsply
import numpy as np
import pytest
import torch
from pxr import Usd

from tests.helpers.splat_files import parsed
from tests.helpers.synthetic import moving_run
from tg4mm.capture import load_capture
from tg4mm.cli import main
from tg4mm.core.splatfile import read_splat, write_splat
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize import rasterization
from tg4mm.show.export.linear import _View, fitted_to_linear
from tg4mm.show.export.lowpass import BAKED_PX2, lacking, smoothing_of, smoothing_variance, widened
from tg4mm.show.export.splat import export_ply, export_ply_sequence, to_splat
from tg4mm.show.render.sequence import RenderRequest

EPS = 1e-6  # square pixels: a viewer without a low-pass


@pytest.fixture
def run(tmp_path):
    return moving_run(tmp_path, n_views=4, n_timesteps=5, size=24, freqs=(3.0,))


def picture(gaussians, scales, viewmat, K, side, eps2d):
    g = gaussians
    size = side / 24
    scaled = torch.tensor(K * [[size], [size], [1]], dtype=torch.float32)
    rgb, alpha, _ = rasterization(
        g.means, g.quats, scales, g.opacities, g.sh, torch.tensor(viewmat, dtype=torch.float32)[None],
        scaled[None], side, side, eps2d=eps2d, sh_degree=g.sh_degree,
    )  # fmt: skip
    return torch.cat([rgb, alpha], -1)[0].numpy()


def one_camera_needles(capture, n=40):
    """Gaussians of a twentieth of a pixel in the middle of the first camera's picture."""
    rng = np.random.default_rng(2)
    centre, forward = -capture.viewmats[0, :3, :3].T @ capture.viewmats[0, :3, 3], capture.viewmats[0, 2, :3]
    means = centre + 4.0 * forward + rng.normal(0, 0.3, (n, 3))
    pixel = 4.0 / capture.Ks[0, 0, 0]
    quats, sh = rng.normal(size=(n, 4)), rng.normal(0, 1, (n, 1, 3))
    means, quats, sh = (torch.tensor(a, dtype=torch.float32) for a in (means, quats, sh))
    return Gaussians(means, quats, torch.full((n, 3), 0.05 * pixel), torch.full((n,), 0.8), sh)


@pytest.mark.parametrize("side", [24, 48, 96])
def test_a_viewer_without_a_low_pass_shows_what_was_trained_at_any_size(run, side):
    """The training picture enlarged: there the rasteriser's low-pass is 0.3 px² of a training pixel."""
    capture = load_capture(run.dataset).selected(np.array([0]))
    needles = one_camera_needles(capture)
    variance = smoothing_variance(needles.means.double().numpy(), capture)
    wide = torch.tensor(widened(needles.scales.numpy(), variance), dtype=torch.float32)
    view = capture.viewmats[0], capture.Ks[0], side
    trained = picture(needles, needles.scales, *view, 0.3 * (side / 24) ** 2)
    np.testing.assert_allclose(picture(needles, wide, *view, EPS), trained, atol=0.03)
    assert np.abs(picture(needles, needles.scales, *view, EPS) - trained).max() > 0.2


def test_from_close_up_a_run_and_its_exported_file_look_alike_and_training_views_stay(run):
    """The exported Gaussians without a low-pass, and what `tg4mm render` draws of the run with its own."""
    capture = load_capture(run.dataset)
    gaussians = replace(run.load_space(), scales=0.2 * run.load_space().scales)  # needles
    scales, means = gaussians.scales.double().numpy(), gaussians.means.double().numpy()
    variance = smoothing_variance(means, capture)
    file = torch.tensor(widened(scales, variance), dtype=torch.float32)
    for i in range(len(capture.viewmats)):
        viewmat, K = capture.viewmats[i], capture.Ks[i]
        assert lacking(means, variance, (viewmat, K, 24, 24)) is None
        for side in (48, 96):
            extra = lacking(means, variance, (viewmat, K * [[side / 24], [side / 24], [1]], side, side))
            wide = widened(scales, extra)
            view = viewmat, K, side
            own = picture(gaussians, torch.tensor(wide, dtype=torch.float32), *view, 0.3)
            exported = picture(gaussians, file, *view, EPS)
            assert psnr(own, exported) > 45
            assert psnr(picture(gaussians, gaussians.scales, *view, 0.3), exported) < 40


def test_fitted_to_linear_light_a_file_shows_there_what_was_trained(run, tmp_path, capsys):
    capture, trained = load_capture(run.dataset), run.load_space()
    wide = torch.tensor(widened(trained.scales.numpy(), smoothing_of(run)), dtype=torch.float32)

    def apart(gaussians):  # in linear light, over all training cameras
        views = [
            _View.of(capture, row, trained) for row in np.unique(capture.camera_ids, return_index=True)[1]
        ]
        pairs = [(v.linear(gaussians, 0.5).numpy(), v.trained(trained, 0.5).numpy()) for v in views]
        return np.mean([psnr(*pair) for pair in pairs])

    fitted = fitted_to_linear(trained, capture, 100)
    assert apart(fitted) > apart(replace(trained, scales=wide)) + 6
    assert (fitted.means == trained.means).all()
    write_splat(tmp_path / "a.ply", replace(to_splat(fitted, None), linear=True))
    assert "linear light" in read_splat(tmp_path / "a.ply").notes[0]
    words = f"export {run.path} --low-pass linear --format gltf --out {tmp_path / 'b.glb'}"
    assert main(words.split()) == 2
    assert "--low-pass linear: for --format ply, or spz at rest, not for gltf" in capsys.readouterr().err


def psnr(a, b):
    return -10 * np.log10(np.square(a - b).mean())


def test_exports_are_widened_and_say_so(run, tmp_path):
    gaussians = run.load_space()
    splat = read_splat(export_ply(run, tmp_path / "a.ply"))
    expected = widened(gaussians.scales.numpy(), smoothing_of(run))
    np.testing.assert_allclose(splat.scales, expected, rtol=1e-5)
    np.testing.assert_allclose(splat.opacities, gaussians.opacities, atol=1e-6)
    assert splat.low_pass_px2 == BAKED_PX2 == 0.3
    frames = export_ply_sequence(run, tmp_path / "s", RenderRequest(), timesteps=[2])
    frame = read_splat(frames / "frame_0002.ply")
    np.testing.assert_allclose(frame.scales, expected, rtol=1e-5)
    assert frame.low_pass_px2 == 0.3


def test_scales_as_trained_can_be_asked_for_in_every_format(run, tmp_path):
    trained = run.load_space().scales.numpy()
    as_trained = ["--low-pass", "none"]
    single = {"ply": "a.ply", "gltf": "a.glb", "usd": "a.usdc", "spz": "a.spz"}
    for format, name in single.items():
        command = ["export", str(run.path), "--format", format, "--out", str(tmp_path / name)]
        assert main(command) == 0
        baked = (tmp_path / name).read_bytes()
        assert main([*command, *as_trained]) == 0
        assert baked != (tmp_path / name).read_bytes(), format
    splat = read_splat(tmp_path / "a.ply")
    np.testing.assert_allclose(splat.scales, trained, rtol=1e-5)
    assert splat.low_pass_px2 is None
    document, array = parsed(tmp_path / "a.glb")
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    np.testing.assert_allclose(array(attributes["KHR_gaussian_splatting:SCALE"]), trained, rtol=1e-5)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))  # kept: a prim of a stage that is gone is none
    scales = stage.GetDefaultPrim().GetAttribute("scales").Get(0)
    np.testing.assert_allclose(np.array(scales), trained, rtol=1e-5)
    np.testing.assert_allclose(np.exp(gsply.read_spz(str(tmp_path / "a.spz")).scales), trained, rtol=0.04)
    for format in ("ply-sequence", "spz"):
        frames = tmp_path / format
        command = ["export", str(run.path), "--format", format, "--timesteps", "2", "--out", str(frames)]
        assert main([*command, *as_trained]) == 0
    frame = read_splat(tmp_path / "ply-sequence/frame_0002.ply")
    np.testing.assert_allclose(frame.scales, trained, rtol=1e-5)
    frame = gsply.read_spz(str(tmp_path / "spz" / "frame_0002.spz"))
    np.testing.assert_allclose(np.exp(frame.scales), trained, rtol=0.04)


def test_without_the_dataset_scales_stay_as_trained_and_the_program_says_so(run, tmp_path, caplog):
    (tmp_path / "data").rename(tmp_path / "elsewhere")
    splat = read_splat(export_ply(run, tmp_path / "a.ply"))
    assert f"{tmp_path / 'data'}, the dataset, is missing: scales are written as trained" in caplog.text
    np.testing.assert_allclose(splat.scales, run.load_space().scales, rtol=1e-5)
    assert splat.low_pass_px2 is None
