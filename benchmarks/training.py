"""Iterations per second of both training stages on a run's own data, each beside what it took the place of.

    python -m benchmarks training RUN [--iterations 60] [--stage space|motion|both]

RUN is a folder that `tg4mm train` left. Space stage: the run's Gaussians from a random view each, with loss and
optimiser, by torch around the rendering kernels (`ParameterAdam`) and by `fused.py`. Motion stage: conjugate gradient
iterations for random pictures, whose time does not depend on the pictures, one component at a time and several.

The ways are measured in turn, one iteration of each, so that whatever else the machine does falls on all alike.
Processor time with one thread hardly depends on the load; with more, the system books short work late.
"""

import argparse
import statistics
from collections.abc import Callable

import numba
import numpy as np
import torch

from benchmarks.common import machine, timed
from tg4mm.capture import load_capture, load_images
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.hyperparameters import DEFAULT
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.observations import fixed_cameras
from tg4mm.fit.motion.solver.cpu import CpuOperator
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.space.config import SpaceConfig
from tg4mm.fit.space.fused import FusedAdam
from tg4mm.fit.space.parameters import ParameterAdam
from tg4mm.fit.space.targets import rest_views
from tg4mm.fit.space.train import _Fit, _Views
from tg4mm.run import Run

BLOCKS = (1, 2, 4, 8)  # components solved for at once


def space_iterations(gaussians, views) -> dict[str, Callable[[], object]]:
    """Functions that do one iteration of the space stage each, density control left out."""
    parameters = {
        "means": gaussians.means,
        "quats": gaussians.quats,
        "log_scales": gaussians.scales.log(),
        "logits": gaussians.opacities.clamp(1e-4, 1 - 1e-4).logit(),
        "sh0": gaussians.sh[:, :1],
        "shn": gaussians.sh[:, 1:],
    }
    cameras = _Views(views, SpaceConfig(), "cpu")
    calls: dict[str, Callable[[], object]] = {}
    for name, kind in (("torch", ParameterAdam), ("fused", FusedAdam)):
        generator = torch.Generator().manual_seed(0)
        error, psnr = torch.zeros(len(gaussians)), torch.zeros(())
        fit = _Fit(kind(parameters, 1.0), error, psnr, generator, generator)

        def iterate(fit: _Fit = fit) -> None:
            v = int(torch.randint(len(cameras), (), generator=fit.generator))
            cameras.iterate(fit, v, gaussians.sh_degree, 0.5)

        calls[name] = iterate
    return calls


def motion_iterations(operator: CpuOperator) -> dict[str, Callable[[], object]]:
    """Functions that apply the operator of the motion stage to several components at once."""
    rng = np.random.default_rng(0)
    calls: dict[str, Callable[[], object]] = {}
    two_level = operator.preconditioner
    unknowns = 4 * len(two_level.blocks) + len(two_level.coarse_factor)
    for block in BLOCKS:
        theta = rng.standard_normal((block, unknowns, 3), np.float32)
        calls[f"{block}"] = lambda theta=theta: operator.products(theta)
    return calls


def table(title: str, calls: dict[str, Callable[[], object]], rounds: int, units: dict[str, int]) -> None:
    """Print the times with one thread and with all; `units`: of work that a call does."""
    threads = {1, numba.config.NUMBA_NUM_THREADS}  # type: ignore[attr-defined]
    print(
        f"\n{title}\n{'':8s} {'threads':>7s} {'median':>8s} {'least':>8s} {'processor':>9s} ms a unit, first ÷ this"
    )
    for count in sorted(threads):
        numba.set_num_threads(count)
        torch.set_num_threads(count)
        found = timed(calls, rounds)
        times = {n: (t.median, t.least, statistics.median(t.processor)) for n, t in found.items()}
        first = [t / units[next(iter(calls))] for t in times[next(iter(calls))]]
        for name, values in times.items():
            per = [t / units[name] for t in values]
            ratios = " ".join(f"{a / b:5.2f}" for a, b in zip(first, per, strict=True))
            print(f"{name:8s} {count:7d} {per[0]:8.2f} {per[1]:8.2f} {per[2]:9.2f}   {ratios}", flush=True)


OPTIONS = {
    "run": str,
    "--iterations": 60,
    "--stage": {"choices": ["space", "motion", "both"], "default": "both"},
}


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    trained = Run.open(options.run)
    gaussians, capture = trained.load_space(), load_capture(trained.dataset)
    images = load_images(capture)
    print(machine())
    size = f"{capture.width}×{capture.height}, {len(gaussians)} Gaussians"
    if options.stage != "motion":
        calls = space_iterations(gaussians, rest_views(capture, images))
        table(f"space stage, {size}: an iteration", calls, options.iterations, dict.fromkeys(calls, 1))
    if options.stage != "space":
        views = [view_jacobian(gaussians, c, (capture.width, capture.height)) for c in fixed_cameras(capture)]
        problem = Problem.of(views, gaussians, MotionConfig(), "cpu")
        title = f"motion stage, {size}, {len(views)} views: a component's iteration, so many at once"
        calls = motion_iterations(problem.on_cpu(problem.everything, DEFAULT))
        table(title, calls, max(3, options.iterations // 10), {name: int(name) for name in calls})
