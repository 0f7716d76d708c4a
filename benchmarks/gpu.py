"""The paper's configuration on a GPU: seconds of each stage, frames per second, the paper's figures beside them.

    python -m benchmarks gpu [--data DATASET] [--out gpu.json]
    python -m benchmarks gpu --smoke --device cpu            the same code in seconds, for CI

Both presets on 512×512 pictures: `modal` with a space stage of 20,000 iterations, `paper` with 20,000 of the space
triplane (of which 3,000 fit the base Gaussians) and 7,000 of the motion triplanes, shared by all timesteps; between
them an orbit with magnified motion at 512×512 and 1920×1080. A dataset of one timestep (the default, mic_5Hz_000) has
no motion of its own: the trained Gaussians are swayed by a known one and photographed at 30 timesteps, so that the
error of what is found can be given too. --smoke needs no dataset; its figures say only that everything runs.
"""

import argparse
import importlib.metadata
import math
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.gpu_scene import moving, rest_view_of, sway, synthetic
from tg4mm import __version__
from tg4mm.capture import Capture, ImageStack, load_capture, load_images
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_json
from tg4mm.fit.device import DEVICES, check_device
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import ModalMotion, MotionConfig
from tg4mm.fit.motion.animate import animator
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.space import SpaceConfig, rest_views
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.research.paper.config import PAPER, PaperConfig, base_config
from tg4mm.research.paper.motion import train_timesteps
from tg4mm.research.paper.space import first_views, train_triplane
from tg4mm.run import Run
from tg4mm.run.stages.motion import train_motion
from tg4mm.run.stages.space import train_space
from tg4mm.show.render.cameras import orbit
from tg4mm.show.weights import blending_weights

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "mic_5Hz_000"
ALPHA = 20.0  # of the orbit
# [TG4MM], one NVIDIA A800: training time of its Table II, rendering speed of its Fig. 6.
PUBLISHED = {"space": "5 min 12 s", "motion": "2 min 12 s", "512x512": "126"}


@dataclass(frozen=True)
class Plan:
    """How much is done."""

    iterations: int  # of the space stage
    timesteps: int  # T where the dataset has one
    frames: int  # of the orbit, for each size
    motion_iterations: int  # of conjugate gradients, at most, of up to 16,000 Gaussians
    paper: PaperConfig
    init_points: int = SpaceConfig().init_points
    sizes: tuple[tuple[int, int], ...] = ((512, 512), (1920, 1080))


FULL = Plan(20_000, 30, 240, MotionConfig().iterations, replace(PAPER, shared=True))
_SMALL = PaperConfig(channels=4, resolution=32, iterations=30, warm_up=20, motion_iterations=10, shared=True)
SMOKE = Plan(30, 6, 4, 5, _SMALL, 500, ((64, 64), (96, 54)))


def seconds_of(work: Callable[[], Any], device: str) -> tuple[float, Any]:
    """Seconds until the device has finished `work`, and its result."""
    if device == "cpu":
        began = time.perf_counter()
        result = work()
        return time.perf_counter() - began, result
    start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    torch.cuda.synchronize()
    start.record()
    result = work()
    end.record()
    torch.cuda.synchronize()
    return start.elapsed_time(end) / 1e3, result


@torch.no_grad()
def frames_per_second(
    gaussians: Gaussians,
    motion: ModalMotion,
    capture: Capture,
    size: tuple[int, int],
    frames: int,
    device: str,
) -> dict[str, float]:
    """An orbit, the magnified pose made anew for every frame: frames that stay on the device, and fetched as bytes."""
    width, height = size
    cameras = orbit(capture, frames, gaussians.means.median(0).values.numpy())
    focal = cameras[0].K[0, 0] * height / capture.height
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], device=device)[None]
    views = torch.from_numpy(np.stack([c.viewmat for c in cameras]).astype(np.float32)).to(device)
    white = torch.ones(1, 3, device=device)
    g = gaussians.to(device)
    at = animator(g, motion)

    def frame(i: int) -> Tensor:
        p = at(i % motion.n_timesteps, ALPHA)
        image, _, _ = rasterization(
            p.means, p.quats, p.scales, p.opacities, p.sh, views[i : i + 1], K, width, height,
            sh_degree=p.sh_degree, backgrounds=white,
        )  # fmt: skip
        return (image[0].clamp(0, 1) * 255 + 0.5).byte()

    def turn(fetch: bool) -> None:
        for i in range(frames):
            picture = frame(i)
            if fetch:
                picture.cpu()

    turn(False)  # allocator and kernels warm
    return {
        "on_device": frames / seconds_of(lambda: turn(False), device)[0],
        "fetched": frames / seconds_of(lambda: turn(True), device)[0],
    }


def measure(data: Path | None, plan: Plan, device: str, folder: Path) -> dict[str, Any]:
    """Everything, in the order of a user's work. `data` None: the synthetic scene."""
    capture, images = synthetic() if data is None else _loaded(data)
    run = Run.create(folder / "run", folder, "modal", {})
    views = rest_views(capture, images)
    at_rest = rest_view_of(capture)
    space = SpaceConfig(iterations=plan.iterations, init_points=plan.init_points)
    space_s, gaussians = seconds_of(lambda: train_space(run, views, capture.points, space, device), device)
    truth = None
    if capture.n_timesteps == 1:
        truth = sway(gaussians, plan.timesteps)
        capture, images = moving(gaussians.to(device), truth, capture)
    config = MotionConfig(iterations=plan.motion_iterations)
    motion_s, motion = seconds_of(lambda: train_motion(run, capture, images, config, device), device)
    log = run.log()
    figures: dict[str, Any] = {
        "space": log["space"] | {"seconds": space_s},
        "motion": log["motion"] | {"seconds": motion_s},
        "fps": {
            f"{w}x{h}": frames_per_second(gaussians, motion, at_rest, (w, h), plan.frames, device)
            for w, h in plan.sizes
        },
    }
    figures["paper"] = measure_paper(folder, capture, images, plan, device)
    if truth is not None:
        weights = blending_weights(gaussians.to(device), capture)
        figures["motion"]["relative_error"] = displacement_figures(motion, truth, weights)["relative_error"]
    return figures


def measure_paper(
    folder: Path, capture: Capture, images: ImageStack, plan: Plan, device: str
) -> dict[str, dict[str, Any]]:
    """The preset `paper` on a capture of several timesteps: seconds and the log of its three parts."""
    run = Run.create(folder / "paper", folder, "paper", {})
    views, config = first_views(capture, images), plan.paper
    base = base_config(SpaceConfig(l2=0.0, init_points=plan.init_points), config)
    base_s, gaussians = seconds_of(lambda: train_space(run, views, capture.points, base, device), device)
    planes_s, model = seconds_of(lambda: train_triplane(run, gaussians, views, config, device), device)
    motion_s, _ = seconds_of(lambda: train_timesteps(run, model, capture, images, config, device), device)
    log = run.log()
    stages = (("space", base_s), ("triplane", planes_s), ("motion", motion_s))
    return {name: log[name] | {"seconds": seconds} for name, seconds in stages}


def _loaded(data: Path) -> tuple[Capture, ImageStack]:
    capture = load_capture(data, split="train")
    return capture, load_images(capture)


def warm_up(device: str) -> float:
    """Seconds until the first picture has its gradient: contexts, libraries and kernels come up."""
    capture, _ = synthetic(16, 1, 4)
    began = time.perf_counter()
    means = torch.zeros(1, 3, device=device, requires_grad=True)
    one = torch.ones(1, 3, device=device)
    view = torch.from_numpy(capture.viewmats.astype(np.float32)).to(device)
    K = torch.from_numpy(capture.Ks.astype(np.float32)).to(device)
    quats = torch.ones(1, 4, device=device)
    image, _, _ = rasterization(means, quats, 0.1 * one, 0.5 * one[:, 0], one, view, K, 16, 16)
    image.sum().backward()
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter() - began


def machine(device: str) -> dict[str, str]:
    """What was measured on."""
    info = {
        "device": device, "python": platform.python_version(), "torch": torch.__version__, "tg4mm": __version__,
    }  # fmt: skip
    if device == "cuda":
        info["gpu"] = torch.cuda.get_device_name()
        info["cuda"] = str(torch.version.cuda)
        info["gsplat"] = importlib.metadata.version("gsplat")
    return info


def minutes(seconds: float) -> str:
    whole, rest = divmod(round(seconds), 60)
    return f"{whole} min {rest:02d} s" if seconds >= 60 else f"{seconds:.1f} s"


def table(result: dict[str, Any]) -> str:
    """The figures beside the paper's, as text."""
    space, motion, paper = result["space"], result["motion"], result["paper"]
    found = f", displacement error {motion['relative_error']:.3f}" if "relative_error" in motion else ""
    planes = paper["space"]["iterations"] + paper["triplane"]["iterations"]
    rows = [
        ("", result["machine"].get("gpu", result["machine"]["device"]), "TG4MM, one A800", ""),
        (
            f"preset paper: space, {planes:,} iterations",
            minutes(paper["space"]["seconds"] + paper["triplane"]["seconds"]), PUBLISHED["space"],
            f"{paper['triplane']['n_gaussians']:,} Gaussians",
        ),
        (
            f"preset paper: motion, {paper['motion']['iterations']:,} iterations",
            minutes(paper["motion"]["seconds"]), PUBLISHED["motion"], "all timesteps together",
        ),
        (
            f"preset modal: space, {space['iterations']:,} iterations", minutes(space["seconds"]), "-",
            f"{space['n_gaussians']:,} Gaussians, {space['psnr_train']:.2f} dB on training views",
        ),
        (
            "preset modal: motion", minutes(motion["seconds"]), "-",
            f"{motion['components']} components, all timesteps{found}",
        ),
        *(
            (f"frames per second, {size}", f"{fps['on_device']:.0f}", PUBLISHED.get(size, "-"),
             f"{fps['fetched']:.0f} with each frame brought to the host")
            for size, fps in result["fps"].items()
        ),
    ]  # fmt: skip
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    lines = [f"{a:{widths[0]}s}  {b:>{widths[1]}s}  {c:>{widths[2]}s}  {d}".rstrip() for a, b, c, d in rows]
    lines.append(
        "The paper's 7,000 iterations are taken to be those of all timesteps, as its 2 min 12 s suggest; the picture "
        "size of its frame rate to be that of its synthetic videos, 512×512."
    )
    if result["smoke"]:
        lines.append("--smoke: a tiny scene and a few iterations; these figures measure nothing.")
    return "\n".join(lines)


OPTIONS = {
    "--data": {"type": Path, "help": f"dataset folder [default: {DATA}; none with --smoke]"},
    "--device": {"choices": DEVICES, "default": "cuda"},
    "--smoke": {"action": "store_true", "help": "a tiny scene, a few iterations"},
    "--out": Path("gpu.json"),  # where the figures go
}


def run(options: argparse.Namespace) -> None:
    """Measure, write the JSON, print the table."""
    data = options.data if options.smoke or options.data is not None else DATA
    try:
        check_device(options.device)
        with tempfile.TemporaryDirectory() as folder:
            setup = warm_up(options.device)
            figures = measure(data, SMOKE if options.smoke else FULL, options.device, Path(folder))
    except Tg4mmError as error:
        hint = "" if options.smoke else " (--device cpu --smoke runs the same code anywhere)"
        raise Tg4mmError(f"{error}{hint}") from None
    result = {
        "machine": machine(options.device), "smoke": options.smoke, "data": str(data or "synthetic"),
        "setup_seconds": setup, **figures, "published": {"gpu": "NVIDIA A800", **PUBLISHED},
    }  # fmt: skip
    write_json(options.out, _finite(result))
    print(table(result))


def _finite(value: Any) -> Any:
    """NaN and infinity as None, which JSON has."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
