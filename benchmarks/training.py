"""Iterations per second of both training stages on a run's own data.

    python benchmarks/training.py RUN [--iterations 100]

RUN is a folder that `tg4mm train` left. Space stage: the run's Gaussians from a random view each, with loss and
optimiser. Motion stage: conjugate gradient iterations for random pictures; their time does not depend on the pictures.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch
from common import machine

from tg4mm.capture import load_capture, load_images
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.differences import fixed_cameras
from tg4mm.motion.linear import rest_view
from tg4mm.motion.neighbours import neighbourhoods
from tg4mm.motion.problem import MotionProblem, information_scale
from tg4mm.motion.solve import start, step
from tg4mm.motion.triplane import sampling_matrix
from tg4mm.runs import Run
from tg4mm.space.losses import photometric_loss
from tg4mm.space.parameters import ParameterAdam, activate
from tg4mm.space.targets import rest_views
from tg4mm.space.view import render_view


def space_iteration(gaussians, views, generator: torch.Generator):
    """A function that does one iteration of the space stage, density control left out."""
    parameters = {
        "means": gaussians.means,
        "quats": gaussians.quats,
        "log_scales": gaussians.scales.log(),
        "logits": gaussians.opacities.clamp(1e-4, 1 - 1e-4).logit(),
        "sh0": gaussians.sh[:, :1],
        "shn": gaussians.sh[:, 1:],
    }
    adam = ParameterAdam(parameters, 1.0)
    viewmats, Ks, targets = (torch.from_numpy(a) for a in (views.viewmats, views.Ks, views.rgb))

    def iterate() -> None:
        v = int(torch.randint(len(targets), (), generator=generator))
        view = render_view(activate(adam.parameters), viewmats[v], Ks[v], views.size, gaussians.sh_degree)
        loss = photometric_loss(view.rgb, targets[v], 10.0, 0.0)
        (loss + (view.carrier * (view.rgb.detach() - targets[v]).abs().sum(-1)).sum()).backward()
        adam.step(0.5)

    return iterate


def per_second(iterate, iterations: int) -> float:
    """Iterations per second, by their median after three that warm up."""
    times = []
    for _ in range(iterations + 3):
        began = time.perf_counter()
        iterate()
        times.append(time.perf_counter() - began)
    return 1 / float(np.median(times[3:]))


def main() -> None:
    """Print both rates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run")
    parser.add_argument("--iterations", type=int, default=100)
    options = parser.parse_args()
    run = Run.open(options.run)
    gaussians, capture = run.load_space(), load_capture(run.dataset)
    images = load_images(capture)
    print(machine())
    size = f"{capture.width}×{capture.height}"
    iterate = space_iteration(gaussians, rest_views(capture, images), torch.Generator().manual_seed(0))
    rate = per_second(iterate, options.iterations)
    print(f"space stage, {size}, {len(gaussians)} Gaussians: {rate:.1f} iterations per second")
    config = MotionConfig()
    views = [rest_view(gaussians, c, (capture.width, capture.height)) for c in fixed_cameras(capture)]
    means, rng = gaussians.means.numpy(), np.random.default_rng(0)
    scale = information_scale(views, len(means), rng)
    problem = MotionProblem(
        views, sampling_matrix(means, config.triplane), neighbourhoods(means), scale, config
    )
    shape = (len(views), capture.height, capture.width, 3)
    state = start(problem.right_hand_side(rng.standard_normal(shape, np.float32)))

    def solve() -> None:
        nonlocal state
        state = step(state, problem.normal)

    rate = per_second(solve, max(3, options.iterations // 10))
    print(f"motion stage, {len(views)} views: {rate:.2f} conjugate gradient iterations per second")


if __name__ == "__main__":
    main()
