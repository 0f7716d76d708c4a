"""PSNR of test views at ½, 1, 2 and 4 times the training resolution, with and without the low-pass in the scales.

python -m benchmarks low_pass DATASET WORK [--shrink 4]

DATASET is one NeRF-synthetic folder. Its pictures are made smaller by --shrink (means of pixels) in WORK/data, trained
into WORK/run unless that is there, and rendered against the pictures of the full size, made smaller likewise, over
white. A viewer without a low-pass is simulated by 4×4 samples a pixel, one that widens by 0.3 px² by `eps2d`.
"""

import argparse
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from tg4mm.capture import Capture, load_capture
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize import rasterization
from tg4mm.run import Run
from tg4mm.show.export.lowpass import BAKED_PX2, widened
from tg4mm.show.export.splat import smoothing_of

FACTORS = (0.5, 1, 2, 4)
VIEWERS = {"without": (1e-6, 4), "0.3 px²": (0.3, 1)}  # low-pass in px², samples along a pixel's side


def smaller(rgba: np.ndarray, factor: int) -> np.ndarray:
    """[H/f, W/f, 4] premultiplied means of pixels."""
    h, w = rgba.shape[:2]
    return rgba.reshape(h // factor, factor, w // factor, factor, 4).mean((1, 3))


def premultiplied(path: Path) -> np.ndarray:
    """[H, W, 4] of a picture file."""
    rgba = np.asarray(Image.open(path).convert("RGBA"), float) / 255
    return np.concatenate([rgba[..., :3] * rgba[..., 3:], rgba[..., 3:]], axis=-1)


def shrink(dataset: Path, out: Path, factor: int) -> None:
    """Write the dataset with smaller pictures."""
    for split in ("train", "test"):
        (out / split).mkdir(parents=True, exist_ok=True)
        shutil.copyfile(dataset / f"transforms_{split}.json", out / f"transforms_{split}.json")
        for path in sorted((dataset / split).glob("*.png")):
            small = smaller(premultiplied(path), factor)
            small[..., :3] /= np.maximum(small[..., 3:], 1e-9)
            Image.fromarray((small * 255 + 0.5).clip(0, 255).astype(np.uint8)).save(out / split / path.name)


def picture(
    gaussians: Gaussians, test: Capture, view: int, side: int, low_pass: float, samples: int
) -> np.ndarray:
    """[side, side, 3] over white."""
    g, many = gaussians, side * samples
    K = torch.tensor(test.Ks[view] * [[many / test.width], [many / test.width], [1]], dtype=torch.float32)
    viewmat = torch.tensor(test.viewmats[view], dtype=torch.float32)
    rgb, _, _ = rasterization(
        g.means, g.quats, g.scales, g.opacities, g.sh, viewmat[None], K[None], many, many,
        eps2d=low_pass, sh_degree=g.sh_degree, backgrounds=torch.ones(1, 3),
    )  # fmt: skip
    fine = rgb[0].clamp(0, 1).double().numpy()
    return fine.reshape(side, samples, side, samples, 3).mean((1, 3))


def scores(gaussians: Gaussians, test: Capture, trained: int, low_pass: float, samples: int) -> list[float]:
    """Mean PSNR in dB of the test views at each factor that the truth's size allows."""
    found = []
    for factor in FACTORS:
        side = round(trained * factor)
        if side > test.width:
            break
        each = []
        for view, path in enumerate(test.paths):
            truth = smaller(premultiplied(path), test.width // side)
            error = (
                picture(gaussians, test, view, side, low_pass, samples) - truth[..., :3] - 1 + truth[..., 3:]
            )
            each.append(-10 * np.log10(np.square(error).mean()))
        found.append(float(np.mean(each)))
    return found


OPTIONS = {"dataset": Path, "work": Path, "--shrink": 4}


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    data, trained_in = options.work / "data", options.work / "run"
    if not (trained_in / "space.safetensors").exists():
        shrink(options.dataset, data, options.shrink)
        subprocess.run(
            [sys.executable, "-m", "tg4mm", "train", str(data), "--out", str(trained_in)], check=True
        )
    opened = Run.open(trained_in)
    gaussians, test = opened.load_space(), load_capture(options.dataset, split="test")
    trained, variance = load_capture(opened.dataset).width, smoothing_of(opened)
    old = gaussians.scales.numpy()
    wide = torch.tensor(widened(old, variance), dtype=torch.float32)
    volumes = torch.tensor(np.prod(old / wide.numpy(), axis=1), dtype=torch.float32)
    files = {
        "as trained": gaussians,
        f"{BAKED_PX2} px² in scales": replace(gaussians, scales=wide),
        "and opacity by volume": replace(gaussians, scales=wide, opacities=gaussians.opacities * volumes),
    }
    factors = ", ".join(f"{f:g}" for f in FACTORS)
    print(f"{trained}×{trained}, {len(gaussians)} Gaussians; dB at {factors} times that")
    for viewer, (low_pass, samples) in VIEWERS.items():
        for file, content in files.items():
            row = scores(content, test, trained, low_pass, samples)
            print(f"viewer {viewer:8s} {file:22s}", *(f"{value:6.2f}" for value in row), flush=True)
