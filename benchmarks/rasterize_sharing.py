"""What timesteps of one view would gain by sharing depth order and tile lists, and how often they could.

    python -m benchmarks.rasterize_sharing RUN [--camera 15] [--alpha 0] [--rounds 15]

The Gaussians of RUN (a folder that `tg4mm train` left) sway as in `gpu_scene.py`. Lists of the scene at rest, their
ellipses enlarged by the largest displacement, against each timestep's own; processor time of one thread, ways in turn.
Beside it the two checks without which such lists must not be used, and what else a rendered frame takes.
"""

from __future__ import annotations

import tg4mm  # noqa: F401, before torch and numba: how their threads wait

# isort: split

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import numpy as np
import torch
from numba import float32, njit

from benchmarks.common import machine
from benchmarks.gpu_scene import sway
from benchmarks.training import in_turn
from tg4mm.capture import load_capture
from tg4mm.core.metrics import flip, ssim
from tg4mm.core.pictures.frames import write_png
from tg4mm.fit.motion.animate import animator
from tg4mm.fit.rasterize.buffers import Buffers
from tg4mm.fit.rasterize.kernels.binning import Bins, bin_splats, gather_sums
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.blend_backward import blend_backward
from tg4mm.fit.rasterize.kernels.layout import DEPTH, EX, EY, FEATURES, MX, MY, POWER
from tg4mm.fit.rasterize.kernels.project import empty_splats, pack_camera, project_forward
from tg4mm.fit.space.view import EPS2D, FAR, NEAR
from tg4mm.run import Run
from tg4mm.show.render.image import render_image

TIMESTEPS = (1, 2, 4, 5, 7, 8)  # at which the sway is not at rest


@njit(cache=True)
def unsorted_tiles(splats, tile_start, pair_gaussian):
    """Tiles whose list is not by increasing depth."""
    bad = 0
    for tile in range(len(tile_start) - 1):
        last = float32(0.0)
        for pair in range(tile_start[tile], tile_start[tile + 1]):
            depth = splats[pair_gaussian[pair], DEPTH]
            if depth < last:
                bad += 1
                break
            last = depth
    return bad


@njit(cache=True)
def outside(rest, splats, margin):
    """Gaussians that may reach beyond their ellipse at rest enlarged by `margin` pixels."""
    n = 0
    for i in range(len(rest)):
        x = abs(rest[i, MX] - splats[i, MX]) + max(splats[i, EX] - rest[i, EX], float32(0.0))
        y = abs(rest[i, MY] - splats[i, MY]) + max(splats[i, EY] - rest[i, EY], float32(0.0))
        n += (rest[i, POWER] > 0) != (splats[i, POWER] > 0) or max(x, y) > margin
    return n


def enlarged(splats: np.ndarray, margin: float) -> np.ndarray:
    """The same with ellipses that reach at least `margin` pixels further."""
    out = empty_splats(len(splats))
    out[:] = splats
    seen = splats[:, POWER] > 0
    factor = 1 + margin / np.minimum(splats[seen, EX], splats[seen, EY])
    out[seen, POWER] *= factor**2
    out[seen, EX] *= factor
    out[seen, EY] *= factor
    return out


def passes(splats: np.ndarray, bins: Bins, size: tuple[int, int]) -> dict[str, object]:
    """Blending, its gradient and gathering with the given lists."""
    width, height = size
    image, transmittance = (
        np.empty((height, width, FEATURES), np.float32),
        np.empty((height, width), np.float32),
    )
    pair_sums = np.empty((len(bins.pair_gaussian), splats.shape[1]), np.float32)
    v_splats, lists = empty_splats(len(splats)), (splats, bins.tile_start, bins.pair_gaussian, width, height)
    slots = (bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot)
    pictures = (image, transmittance, image, transmittance)
    return {
        "blend": lambda: blend_forward(*lists, image, transmittance, reached=bins.reached),
        "blend backward": lambda: blend_backward(*lists, *pictures, pair_sums, reached=bins.reached),
        "gather": lambda: gather_sums(*slots, pair_sums, v_splats),
    }


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run")
    parser.add_argument("--camera", type=int, default=15)
    parser.add_argument("--alpha", type=float, default=0.0)
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    print(machine())
    run = Run.open(options.run)
    gaussians, capture = run.load_space(), load_capture(run.dataset)
    viewmat, K = (np.asarray(a[options.camera], np.float32) for a in (capture.viewmats, capture.Ks))
    size = (capture.width, capture.height)
    camera, at = pack_camera(viewmat, K, NEAR, FAR, EPS2D), animator(gaussians, sway(gaussians, 30))

    def projected(g) -> np.ndarray:
        splats = empty_splats(len(g))
        arrays = [a.numpy() for a in (g.means, g.quats, g.scales, g.opacities, g.sh)]
        project_forward(*arrays, g.sh_degree, False, camera, *size, splats)
        return splats

    rest = projected(gaussians)
    order = bin_splats(rest, *size)
    margin, disorder = 0.0, []
    for t in TIMESTEPS:
        splats = projected(at(t, options.alpha))
        both = (splats[:, POWER] > 0) & (rest[:, POWER] > 0)
        moved = splats[both, MX : MY + 1] - rest[both, MX : MY + 1]
        margin = max(margin, float(np.linalg.norm(moved, axis=1).max()))
        disorder.append(unsorted_tiles(splats, order.tile_start, order.pair_gaussian))
    tiles = np.count_nonzero(np.diff(order.tile_start))
    print(f"camera {options.camera}, α = {options.alpha:g}: displaced by {margin:.2f} pixels at the most")
    print(f"tiles out of order, of {tiles}, at timesteps {TIMESTEPS}: {disorder}")
    own, shared = bin_splats(splats, *size), bin_splats(enlarged(rest, margin), *size)
    print(f"{len(own.pair_gaussian)} pairs of its own, {len(shared.pair_gaussian)} shared")
    buffers, pose = Buffers(), at(1, options.alpha)
    picture = render_image(pose, viewmat, K, *size)
    with TemporaryDirectory() as folder:
        calls = {"bin": lambda: bin_splats(splats, *size, buffers)}
        calls |= {f"{name}, own": call for name, call in passes(splats, own, size).items()}
        calls |= {f"{name}, shared": call for name, call in passes(splats, shared, size).items()}
        calls |= {
            "in order?": lambda: unsorted_tiles(splats, shared.tile_start, shared.pair_gaussian),
            "within?": lambda: outside(rest, splats, margin),
            "pose": lambda: at(1, options.alpha),
            "picture": lambda: render_image(pose, viewmat, K, *size),
            "PNG": lambda: write_png(Path(folder) / "x.png", picture),
            "SSIM": lambda: ssim(picture, 0.99 * picture),
            "FLIP": lambda: flip(picture, 0.99 * picture),
        }
        for name, (_, _, processor) in in_turn(calls, options.rounds).items():
            print(f"  {name:22s} {processor:7.2f} ms of processor time")


if __name__ == "__main__":
    main()
