"""How long the space stage takes on photographs, and how well it shows those that it was not given.

    python -m benchmarks photographs DATASET [--shrink 4] [--set space.iterations=3000 …] [--spoil 0.1] [--out FOLDER]

Every eighth picture from the fifth is held out. --shrink: pictures are made so many times smaller first (means over
squares). --spoil: every training picture and channel is multiplied by a gain of its own, of this standard deviation in
its logarithm, and clipped; what the stage finds of these gains is printed. --out: the held-out views there as PNG,
rendered beside the photograph and four times the difference, and one from between the first two cameras.

Prints processor seconds (with NUMBA_NUM_THREADS=1 they hardly depend on what else the machine does) and seconds by the
clock of the stage, peak memory, Gaussians, and the mean PSNR of the held-out views: as they are, and with the gain of
each channel that fits best.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.common import machine
from benchmarks.initialisation import fitted, sheet
from tg4mm.capture import load_capture, load_images
from tg4mm.core.metrics import psnr
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space import RestViews, rest_views
from tg4mm.fit.space.levels import shrunk
from tg4mm.fit.space.losses import fitting_gain
from tg4mm.run.train import parse_settings
from tg4mm.show.render.image import render_image

EACH, FIRST = 8, 4  # pictures held out


def chosen(views: RestViews, mask: np.ndarray) -> RestViews:
    """The cameras where mask [V] is true."""
    images = tuple(rows for rows, wanted in zip(views.images, mask, strict=True) if wanted)
    parts = {name: getattr(views, name)[mask] for name in ("viewmats", "Ks", "rgb", "alpha")}
    return replace(views, **parts, images=images)


def spoilt(views: RestViews, deviation: float) -> tuple[RestViews, np.ndarray]:
    """The views with gains of their own, and these [V, 3], whose logarithms have mean 0 in each channel."""
    logs = np.random.default_rng(1).normal(0, deviation, (len(views.rgb), 3))
    gains = np.exp(logs - logs.mean(0)).astype(np.float32)
    return replace(views, rgb=np.clip(views.rgb * gains[:, None, None], 0, 1)), gains


def rendered(gaussians: Gaussians, views: RestViews) -> list[np.ndarray]:
    """One picture [H, W, 3] in 0..1 for each camera."""
    cameras = zip(views.viewmats, views.Ks, strict=True)
    return [np.clip(render_image(gaussians, m, K, *views.size), 0, 1) for m, K in cameras]


def with_best_gain(picture: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The picture times the gain of each channel that fits best."""
    return np.clip(picture * fitting_gain(picture, truth), 0, 1)


def between(views: RestViews) -> np.ndarray:
    """viewmat [4, 4] half way from the first camera to the second, looking as the first does."""
    viewmat = views.viewmats[0].copy()
    centres = [-m[:3, :3].T @ m[:3, 3] for m in views.viewmats[:2]]
    viewmat[:3, 3] = -viewmat[:3, :3] @ (centres[0] + centres[1]) / 2
    return viewmat


def save_pictures(
    folder: Path, gaussians: Gaussians, training: RestViews, test: RestViews, pictures: list[np.ndarray]
) -> None:
    """The held-out views and one from where no camera was."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, (picture, truth) in enumerate(zip(pictures, test.rgb, strict=True)):
        sheet(picture, truth).save(folder / f"held_out_{i}.png")
    view = np.clip(render_image(gaussians, between(training), training.Ks[0], *training.size), 0, 1)
    Image.fromarray((view * 255 + 0.5).astype(np.uint8)).save(folder / "between.png")


OPTIONS = {
    "dataset": Path,
    "--shrink": 1,
    "--set": {"action": "append", "default": [], "metavar": "KEY=VALUE"},
    "--spoil": 0.0,
    "--out": Path,
}


def run(options: argparse.Namespace) -> None:
    """Fit, and print the figures."""
    settings = dict(pair.split("=", 1) for pair in options.set)
    config = parse_settings(settings)["space"]
    capture = load_capture(options.dataset, split="train")
    views = shrunk(rest_views(capture, load_images(capture)), options.shrink)
    held = np.arange(len(views.rgb)) % EACH == FIRST
    training, test = chosen(views, ~held), chosen(views, held)
    del views
    given = None
    if options.spoil:
        training, given = spoilt(training, options.spoil)
    fitted(options.dataset, training, capture.points, replace(config, iterations=3))  # loads the kernels
    gaussians, log, processor, clock = fitted(options.dataset, training, capture.points, config)
    pictures = rendered(gaussians, test)
    plain = [psnr(p, t) for p, t in zip(pictures, test.rgb, strict=True)]
    fitting = [psnr(with_best_gain(p, t), t) for p, t in zip(pictures, test.rgb, strict=True)]
    width, height = test.size
    print(
        f"{machine()}\n{width}×{height}, {len(training.rgb)} pictures, {len(test.rgb)} held out, {settings}\n"
        f"processor {processor:.0f} s, clock {clock:.0f} s, {log['peak_memory_mib']:.0f} MiB, "
        f"{log['iterations']} iterations, {len(gaussians)} Gaussians\n"
        f"held out {np.mean(plain):.2f} dB ({', '.join(f'{p:.2f}' for p in plain)}), "
        f"with the best gains {np.mean(fitting):.2f} dB"
    )
    if given is not None and "gains" in log:
        found = np.array(log["gains"])
        off = np.log(found) - np.log(given)
        print(f"gains: deviation {np.log(given).std():.4f} given, {off.std():.4f} from what was found")
    if options.out:
        save_pictures(options.out, gaussians, training, test, pictures)
