"""Time of the CPU rasteriser, forward and backward, beside its peers.

    python -m benchmarks rasterize [--run RUN] [--repeats 9] [--only synthetic | run]

Synthetic: Gaussians of about two pixels (standard deviation) fill a ball seen from outside, 256² to 1024², 5,000 to
500,000. With --run (a folder that `tg4mm train` left) also every kernel on the
trained Gaussians, seen by a camera of the run's dataset, in turn and by number of threads, and batches of cameras.
Peers: the dense twin at a size it can bear; of gsplat's torch reference what is pure torch, projection and spherical
harmonics (its compositing needs CUDA and nerfacc).

Each figure is the median, the smallest time of the same runs stands in brackets: on a shared machine they lie apart.
There the processor time says more, with one thread: OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial

import numba
import numpy as np
import torch
from torch import Tensor

from benchmarks.common import Times, machine, timed, times_of
from benchmarks.kernels import Kernels, scene
from tg4mm.capture import load_capture
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.memory import peak_memory_mib
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.rasterize.reference import rasterize_dense
from tg4mm.fit.space.fused import FusedAdam, Iteration
from tg4mm.fit.space.view import render_view
from tg4mm.run import Run

SIZES = (256, 512, 1024)  # pixels
COUNTS = (5_000, 50_000, 200_000, 500_000)  # Gaussians
DENSE_SIZE, DENSE_COUNT = 64, 500
CAMERAS = 8  # of a batch
ROUND = 5  # calls of one kernel before the next one's turn


def ours(parameters: list[Tensor], viewmat: Tensor, K: Tensor, size: int) -> tuple[Tensor, int]:
    """The image [H, W, 3] and the number of tile pairs."""
    means, quats, scales, opacities, sh = parameters
    image, _, meta = rasterization(
        means, quats, scales, opacities, sh, viewmat[None], K[None], size, size, sh_degree=3
    )
    return image[0], len(meta["projected"][0].bins.pair_gaussian)


def dense(parameters: list[Tensor], viewmat: Tensor, K: Tensor, size: int) -> tuple[Tensor, int]:
    """The same image by the twin; its pairs are all there are."""
    means, quats, scales, opacities, sh = parameters
    image, _ = rasterize_dense(means, quats, scales, opacities, sh, viewmat, K, size, size)
    return image, len(parameters[0]) * (size // 16) ** 2


def measure(render: Callable[..., tuple[Tensor, int]], n: int, size: int, repeats: int) -> dict[str, float]:
    """Milliseconds of both passes (median, smallest, smallest processor time) and the number of pairs."""
    parameters, viewmat, K = scene(n, size)
    parameters = [p.requires_grad_() for p in parameters]
    weight = torch.randn(size, size, 3, generator=torch.Generator().manual_seed(1))
    clocks, pairs = [], 0
    for _ in range(repeats + 1):
        start = time.perf_counter(), time.process_time()
        image, pairs = render(parameters, viewmat, K, size)
        middle = time.perf_counter(), time.process_time()
        image.backward(weight)
        end = time.perf_counter(), time.process_time()
        clocks.append(
            [(b - a) * 1e3 for x, y in ((start, middle), (middle, end)) for a, b in zip(x, y, strict=True)]
        )
    # the first call loads or compiles the kernels
    forward, forward_processor, backward, backward_processor = zip(*clocks[1:], strict=True)
    return {
        "forward": statistics.median(forward), "forward_min": min(forward),
        "backward": statistics.median(backward), "backward_min": min(backward), "pairs": pairs,
        "forward_processor": min(forward_processor), "backward_processor": min(backward_processor),
    }  # fmt: skip


def row(name: str, n: int, size: int, t: dict[str, float]) -> str:
    return (
        f"{name:6s} {n:8d} {size:5d}² {t['pairs']:9.0f} {t['forward']:8.1f} [{t['forward_min']:.1f}] "
        f"{t['backward']:8.1f} [{t['backward_min']:.1f}]  {t['forward_processor']:8.1f} {t['backward_processor']:8.1f}"
    )


def synthetic(repeats: int) -> None:
    """Cost against the number of Gaussians and pixels, and the dense twin at a small size."""
    print(
        f"{'':6s} {'N':>8s} {'size':>6s} {'pairs':>9s}  forward [min] ms  backward [min] ms  processor time, both"
    )
    for size in SIZES:
        for n in COUNTS:
            print(row("ours", n, size, measure(ours, n, size, repeats)), flush=True)
    print(f"peak memory so far, 500,000 Gaussians at 1024² among it: {peak_memory_mib():.0f} MiB")
    iterations(COUNTS[-1], SIZES[-1])
    print(f"with three iterations of training on them: {peak_memory_mib():.0f} MiB")
    small = measure(ours, DENSE_COUNT, DENSE_SIZE, repeats)
    twin = measure(dense, DENSE_COUNT, DENSE_SIZE, repeats)
    print(row("ours", DENSE_COUNT, DENSE_SIZE, small))
    print(row("dense", DENSE_COUNT, DENSE_SIZE, twin))
    ratios = [twin[key] / small[key] for key in ("forward_processor", "backward_processor")]
    print(
        f"the dense twin takes {ratios[0]:.0f} times the processor time forward, {ratios[1]:.0f} times backward"
    )


def iterations(n: int, size: int, count: int = 3) -> None:
    """Some iterations of the space stage on a random picture."""
    (means, quats, scales, opacities, sh), viewmat, K = scene(n, size)
    parameters = {
        "means": means, "quats": quats, "log_scales": scales.log(), "logits": opacities.logit(),
        "sh0": sh[:, :1], "shn": sh[:, 1:],
    }  # fmt: skip
    adam, iteration = FusedAdam(parameters, 1.0), Iteration(10.0, 0.0)
    target, error = np.random.default_rng(0).random((size, size, 3), np.float32), np.zeros(n, np.float32)
    for _ in range(count):
        iteration(adam, viewmat.numpy(), K.numpy(), target, 3, 0.5, error)


class Trained:
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
        """Of every kernel and of whole passes."""
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

    def cameras(self, each: int) -> None:
        """Both passes of the first `CAMERAS` cameras, `each` in one call."""
        g = self.gaussians
        leaves = [a.detach().requires_grad_() for a in (g.means, g.quats, g.scales, g.opacities, g.sh)]
        for first in range(0, CAMERAS, each):
            some = slice(first, first + each)
            images, _, _ = rasterization(  # type: ignore[call-arg]
                *leaves, self.viewmats[some], self.Ks[some], *self.size, sh_degree=g.sh_degree
            )
            images.backward(torch.ones_like(images))

    def gsplat_reference(self) -> None:
        """Projection and spherical harmonics of gsplat's pure-torch reference."""
        from gsplat.cuda import _torch_impl as peer

        g = self.gaussians
        with torch.no_grad():
            covars, _ = peer._quat_scale_to_covar_preci(g.quats, g.scales)
            peer._fully_fused_projection(g.means, covars, self.viewmat[None], self.K[None], *self.size)
            centre = -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]
            peer._spherical_harmonics(g.sh_degree, g.means - centre, g.sh)


def trained(folder: str, repeats: int) -> None:
    """The kernels and whole passes on trained Gaussians, by number of threads, and gsplat's reference."""
    scene = Trained(folder)
    most = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    for threads in range(1, most + 1):
        numba.set_num_threads(threads)
        torch.set_num_threads(threads)
        print(f"\n{folder}, {scene.size[0]}×{scene.size[1]}, {threads} threads")
        times = scene.times(repeats)
        for name, t in times.items():
            print(f"  {name:24s} {t.median:7.2f} [{t.least:.2f}] ms, processor {min(t.processor):.2f} ms")
        whole = times["forward, all"]
        print(f"  {1e3 / whole.median:.0f} frames per second, at best {1e3 / whole.least:.0f}")
        batches = {f"{each} cameras a call": partial(scene.cameras, each) for each in (1, CAMERAS)}
        for name, t in timed(batches, max(repeats // 10, 3), ROUND).items():
            print(f"  both passes of {CAMERAS} cameras, {name}: {t.median:.1f} [{t.least:.1f}] ms")
    try:
        torch.set_num_threads(1)
        peer = min(times_of(scene.gsplat_reference, repeats).processor)
    except ImportError as error:
        print(f"gsplat's torch reference cannot be imported: {error}")
        return
    ratio = peer / min(times["project"].processor)
    print(
        f"gsplat's torch reference, projection + SH only: {peer:.1f} ms of processor, {ratio:.0f} times our `project`"
    )


OPTIONS = {
    "--repeats": 9,
    "--run": {"help": "a run folder with trained Gaussians"},
    "--only": {"choices": ["synthetic", "run"], "help": "one part alone"},
}


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    if options.only == "run" and not options.run:
        raise Tg4mmError("--only run needs --run")
    print(machine())
    if options.only in (None, "synthetic"):
        synthetic(options.repeats)
    if options.run and options.only in (None, "run"):
        trained(options.run, options.repeats)
