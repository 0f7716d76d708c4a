"""Time of the CPU rasteriser on trained Gaussians, every kernel and whole passes, by number of threads.

    python -m benchmarks rasterize --run RUN [--repeats 9]

RUN is a folder that `tg4mm train` left, seen by a camera of its dataset. Each figure is the median, with the smallest
time of the same runs in brackets. On a shared machine processor time is the better measure, with one thread:
OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1.
"""

import argparse
import statistics
from collections.abc import Callable

import numba
import numpy as np
import torch

from benchmarks.common import Times, machine, timed
from tg4mm.capture import load_capture
from tg4mm.core.memory import Buffers
from tg4mm.fit.rasterize.kernels import binning
from tg4mm.fit.rasterize.kernels import project as projection
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.blend_backward import blend_backward
from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project_backward import project_backward
from tg4mm.fit.space.view import EPS2D, FAR, NEAR, render_view
from tg4mm.run import Run

ROUND = 5  # calls of one kernel before the next one's turn


class Kernels:
    """Every kernel as a call on its own, for one view of given Gaussians."""

    def __init__(
        self, arrays: list[np.ndarray], viewmat: np.ndarray, K: np.ndarray, size: tuple[int, int]
    ) -> None:
        width, height = size
        camera = projection.pack_camera(viewmat, K, NEAR, FAR, EPS2D)
        splats = projection.empty_splats(len(arrays[0]))
        project = (*arrays, 3, camera, width, height, splats)
        projection.project_forward(*project)
        buffers = Buffers()
        bins = binning.bin_splats(splats, width, height)
        self.lists = (splats, bins.tile_start, bins.pair_gaussian, width, height)
        rng = np.random.default_rng(0)
        image, v_image = np.empty((2, height, width, FEATURES), np.float32)
        transmittance, v_transmittance = np.empty((2, height, width), np.float32)
        v_image[:] = rng.normal(size=v_image.shape)
        v_transmittance[:] = rng.normal(size=v_transmittance.shape)
        pair_sums = np.empty((len(bins.pair_gaussian), SPLAT_WIDTH), np.float32)
        v_splats = projection.empty_splats(len(splats))
        v_splats[:] = 0
        pictures = (image, transmittance, v_image, v_transmittance, pair_sums)
        slots = (bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot)
        gather = (*slots, pair_sums, v_splats)
        back = (*arrays[:3], arrays[4], 3, camera, width, height, splats, v_splats, True)
        gradients = tuple(np.zeros_like(a) for a in arrays)
        self.n_pairs = len(bins.pair_gaussian)
        self.reached = reached = bins.reached  # written by `blend`
        self.calls: dict[str, Callable[[], object]] = {
            "project": lambda: projection.project_forward(*project),
            "bin": lambda: binning.bin_splats(splats, width, height, buffers),
            "blend": lambda: blend_forward(*self.lists, image, transmittance, reached=reached),
            "blend, picture alone": lambda: blend_forward(*self.lists, image, transmittance),
            "blend backward": lambda: blend_backward(*self.lists, *pictures, reached=reached),
            "gather": lambda: binning.gather_sums(*gather),
            "project backward": lambda: project_backward(*back, *gradients),
        }


class BenchmarkedRun:
    """The Gaussians of a run and one camera of its dataset."""

    def __init__(self, folder: str) -> None:
        run = Run.open(folder)
        self.gaussians, capture = run.load_space(), load_capture(run.dataset)
        self.size = (capture.width, capture.height)
        self.viewmats, self.Ks = (
            torch.from_numpy(np.asarray(a, np.float32)) for a in (capture.viewmats, capture.Ks)
        )
        camera = len(self.viewmats) // 2
        self.viewmat, self.K = self.viewmats[camera], self.Ks[camera]

    def times(self, repeats: int) -> dict[str, Times]:
        """Return the times of every kernel and of complete passes."""
        g = self.gaussians
        arrays = [a.numpy() for a in (g.means, g.quats, g.scales, g.opacities, g.sh)]
        kernels = Kernels(arrays, self.viewmat.numpy(), self.K.numpy(), self.size)
        passes = {"forward, all": self.frame, "forward + backward, all": self.both_passes}
        times = timed({**kernels.calls, **passes}, repeats, ROUND)
        print(f"{len(g)} Gaussians, {kernels.n_pairs} pairs")
        return times

    def frame(self) -> None:
        with torch.no_grad():
            render_view(self.gaussians, self.viewmat, self.K, self.size, self.gaussians.sh_degree)

    def both_passes(self) -> None:
        g = self.gaussians
        leaves = [a.detach().requires_grad_() for a in (g.means, g.quats, g.scales, g.opacities, g.sh)]
        view = render_view(type(g)(*leaves), self.viewmat, self.K, self.size, g.sh_degree)
        view.rgb.backward(torch.ones_like(view.rgb))


OPTIONS = {"--repeats": 9, "--run": {"required": True, "help": "a run folder with trained Gaussians"}}


def run(options: argparse.Namespace) -> None:
    """Print the times of kernels and whole passes, by number of threads."""
    print(machine())
    scene = BenchmarkedRun(options.run)
    for threads in range(1, numba.config.NUMBA_NUM_THREADS + 1):  # type: ignore[attr-defined]
        numba.set_num_threads(threads)
        torch.set_num_threads(threads)
        print(f"\n{options.run}, {scene.size[0]}×{scene.size[1]}, {threads} threads")
        times = scene.times(options.repeats)
        for name, t in times.items():
            least = f"[{min(t.clock):.2f}] ms, processor {min(t.processor):.2f} ms"
            print(f"  {name:24s} {statistics.median(t.clock):7.2f} {least}")
        whole = times["forward, all"].clock
        print(f"  {1e3 / statistics.median(whole):.0f} frames per second, at best {1e3 / min(whole):.0f}")
