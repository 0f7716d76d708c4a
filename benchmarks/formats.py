"""What formats of other tools keep of a run: size, and PSNR of what a reader gets against the run itself.

    python -m benchmarks formats RUN [--alpha 20]

Written, read back by another's reader (glTF by its targets, SPZ by gsply, USD by OpenUSD), drawn by our rasteriser from
the first camera at every timestep of a period, against the run magnified by α. The least over timesteps counts.
"""

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gsply
import numpy as np
import torch
from pxr import Usd

from tg4mm.capture import load_capture
from tg4mm.core.magnification import Magnification
from tg4mm.core.splatfile import SplatFile, positions_at, read_splat, rotations_at
from tg4mm.core.splatfile.axes import TURN, harmonics_turn
from tg4mm.fit.gaussians import Gaussians
from tg4mm.run import Run
from tg4mm.show.export.formats import export_gltf, export_spz_sequence, export_usd, one_period
from tg4mm.show.export.splat import export_ply, frames_of, splat_of
from tg4mm.show.render.cameras import Camera, capture_cameras
from tg4mm.show.render.image import render_image
from tg4mm.show.render.sequence import RenderRequest

At = Callable[[int], SplatFile]  # timestep → Gaussians


def moment(splat: SplatFile, t: int, alpha: float, turning: bool = True) -> SplatFile:
    """A splat with motion, at a timestep; without `turning` Gaussians move but keep their directions."""
    quats = rotations_at(splat, t, alpha).astype(np.float32) if turning else splat.quats
    means = positions_at(splat, t, alpha).astype(np.float32)
    return SplatFile.static(means, quats, splat.scales, splat.opacities, splat.sh)


def of_spz(path: Path) -> SplatFile:
    """What gsply reads, turned back to Z up."""
    read = gsply.read_spz(str(path))
    w, x, y, z = read.quats.T
    quats = np.sqrt(0.5) * np.stack([w - x, x + w, y - z, z + y], axis=1)
    sh = np.concatenate([read.sh0[:, None], read.shN], axis=1)
    sh = np.einsum("jk,nkc->njc", harmonics_turn(TURN.T, sh.shape[1]), sh)
    opacities = 1 / (1 + np.exp(-read.opacities))
    arrays = (read.means @ TURN, quats, np.exp(read.scales), opacities, sh)
    return SplatFile.static(*(np.asarray(a, np.float32) for a in arrays))


def of_usd(path: Path) -> At:
    """What OpenUSD reads at a time."""
    stage = Usd.Stage.Open(str(path))

    def at(t: int) -> SplatFile:
        prim = stage.GetDefaultPrim()
        means, scales, opacities, sh = (
            np.array(prim.GetAttribute(name).Get(t))
            for name in ("positions", "scales", "opacities", "radiance:sphericalHarmonicsCoefficients")
        )
        quats = np.array([(q.real, *q.imaginary) for q in prim.GetAttribute("orientations").Get(t)])
        return SplatFile.static(
            means, quats.astype(np.float32), scales, opacities, sh.reshape(len(means), -1, 3)
        )

    return at


def drawn(splat: SplatFile, camera: Camera, **options: float) -> np.ndarray:
    """[H, W, 3] by our rasteriser."""
    arrays = (splat.means, splat.quats, splat.scales, splat.opacities, splat.sh)
    gaussians = Gaussians(*(torch.from_numpy(np.ascontiguousarray(a)) for a in arrays))
    size = (camera.width, camera.height)
    return np.asarray(render_image(gaussians, camera.viewmat, camera.K, *size, **options), np.float64)


OPTIONS = {"run": Path, "--alpha": 20.0}


def run(options: argparse.Namespace) -> None:
    """Print a row for each format."""
    trained, request = Run.open(options.run), RenderRequest(Magnification.of(options.alpha))
    times = one_period(trained)
    camera = capture_cameras(load_capture(trained.dataset))[0]
    true = frames_of(trained, request, times)
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        ply = read_splat(export_ply(trained, out / "a.ply"))
        export_gltf(trained, out / "a.glb", request.magnified)
        export_spz_sequence(trained, out / "spz", request)
        export_usd(trained, out / "a.usdc", request)
        still = replace(splat_of(trained), rotation=np.zeros_like(ply.rotation))
        rows: dict[str, tuple[str, At]] = {
            "ply": ("a.ply", lambda t: moment(ply, t, options.alpha)),
            "gltf": ("a.glb", lambda t: moment(still, t, options.alpha, turning=False)),
            "spz, a timestep": ("spz/frame_0000.spz", lambda t: of_spz(out / f"spz/frame_{t:04d}.spz")),
            "usd": ("a.usdc", of_usd(out / "a.usdc")),
        }
        print(
            f"{len(ply)} Gaussians, {ply.n_modes} modes, {ply.n_timesteps} timesteps, α = {options.alpha:g}"
        )
        print("| format | bytes | least PSNR, dB |\n|---|---|---|")
        for name, (file, at) in rows.items():
            errors = [np.mean((drawn(at(t), camera) - drawn(true.at(t), camera)) ** 2) for t in times]
            psnr = f"{-10 * np.log10(max(errors)):.1f}" if max(errors) else "equal"
            print(f"| {name} | {(out / file).stat().st_size:,} | {psnr} |")
