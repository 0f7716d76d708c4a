"""A short space stage, one that is killed, and its score on the test views."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from tg4mm.capture import load_capture, load_images
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.space import SpaceConfig

SHORT = SpaceConfig(iterations=36, max_gaussians=500, init_points=300)


def psnr_of_test_views(gaussians: Gaussians, data: Path) -> float:
    capture = load_capture(data, split="test")
    images = load_images(capture)
    g = gaussians
    viewmats, Ks = (torch.as_tensor(a, dtype=torch.float32) for a in (capture.viewmats, capture.Ks))
    renders, _, _ = rasterization(
        g.means, g.quats, g.scales, g.opacities, g.sh, viewmats, Ks, capture.width, capture.height,
        sh_degree=g.sh_degree, backgrounds=torch.ones(len(capture), 3),
    )  # fmt: skip
    truth = np.stack([images.rgb(i) for i in range(len(capture))])
    return float(-10 * np.log10(((renders.numpy() - truth) ** 2).mean()))


class Killed(Exception):
    pass


def killed_after(updates: int) -> Callable:
    """A stand-in for `progress` that dies at its n-th update."""

    @contextmanager
    def progress(label: str, total: int, unit="it", start=0, brief=False) -> Iterator[Callable]:
        calls = [0]

        def update(done: int, **figures: object) -> None:
            calls[0] += 1
            if calls[0] == updates and not brief:
                raise Killed

        yield update

    return progress
