"""How far the space stage gets from each initialisation, one row for a dataset and a start.

    python -m benchmarks initialisation SET [SET …] --out FOLDER [--inits hull,points,sfm,random] [--iterations 1500]
                                        [--pictures]

Trains the Gaussians at rest alone (means over time, as `tg4mm train` does) and compares the test views' means over
time. A row is printed and kept in FOLDER/<set>/<start>.json as soon as it is there; the same command goes on where it
was stopped. --pictures: FOLDER/<set>/<start>_<view>.png, rendered beside the truth and four times the difference.

Columns: points there were to choose from; how many were taken; Gaussians at the end; PSNR and SSIM, means over the test
views; processor seconds of finding the points and of the whole stage, finding included (with NUMBA_NUM_THREADS=1 they
hardly depend on what else the machine does).
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tg4mm.capture import Capture, SurfacePoints, load_capture, load_images
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_json
from tg4mm.core.metrics import psnr, ssim
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space import RestViews, SpaceConfig, rest_views
from tg4mm.fit.space.config import INITS
from tg4mm.fit.space.initial import initial_points
from tg4mm.fit.space.levels import resolved
from tg4mm.research.text import table
from tg4mm.run import Run
from tg4mm.run.stages.space import train_space
from tg4mm.show.render.image import render_image

STARTS = ("hull", "points", "sfm", "random")
HEADER = ("set", "start", "found", "taken", "Gaussians", "PSNR dB", "SSIM", "start s", "all s")
_WARM_UP = 3  # iterations


def rendered(gaussians: Gaussians, views: RestViews) -> list[np.ndarray]:
    """One picture [H, W, 3] for each camera."""
    return [render_image(gaussians, m, K, *views.size) for m, K in zip(views.viewmats, views.Ks, strict=True)]


def sheet(picture: np.ndarray, truth: np.ndarray) -> Image.Image:
    """Rendered, truth, four times the difference, side by side, at least 256 pixels high each."""
    side = np.concatenate([picture, truth, np.clip(4 * np.abs(picture - truth), 0, 1)], axis=1)
    grow = max(1, round(256 / len(picture)))
    return Image.fromarray((side * 255 + 0.5).astype(np.uint8).repeat(grow, 0).repeat(grow, 1))


def fitted(root: Path, views: RestViews, points: SurfacePoints | None, config: SpaceConfig) -> tuple:
    """Gaussians at rest, the stage's part of the run's log, processor seconds and seconds."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run.create(Path(folder) / "run", root, "modal", {"space": asdict(config)})
        began = time.process_time(), time.monotonic()
        gaussians = train_space(run, views, points, config)
        used = time.process_time() - began[0], time.monotonic() - began[1]
        return gaussians, run.log()["space"], *used


def measured(
    root: Path, start: str, capture: Capture, views: RestViews, test: RestViews, config: SpaceConfig
) -> tuple[dict[str, Any], list[np.ndarray]]:
    """A row's figures, and the test views as rendered."""
    config = replace(resolved(config, views), init=start)
    count, began = min(config.init_points, config.max_gaussians), time.process_time()
    first = initial_points(views, capture.points, start, count, np.random.default_rng(config.seed))
    finding = time.process_time() - began
    gaussians, _, seconds, _ = fitted(root, views, capture.points, config)
    pictures = rendered(gaussians, test)
    truths = list(test.rgb)
    return {
        "source": first.source,
        "found": first.found,
        "taken": len(first.xyz),
        "gaussians": len(gaussians),
        "psnr": float(np.mean([psnr(p, t) for p, t in zip(pictures, truths, strict=True)])),
        "ssim": float(np.mean([ssim(p, t) for p, t in zip(pictures, truths, strict=True)])),
        "start_s": finding,
        "seconds": seconds,
    }, pictures


def rows_of(root: Path, out: Path, starts: Sequence[str], config: SpaceConfig, pictures: bool) -> list[dict]:
    """The rows of one dataset; those whose file is there are read, if they were made with these settings."""
    asked = {"dataset": str(root.resolve()), "settings": asdict(config)}
    rows, loaded = [], None
    for start in starts:
        path = out / root.name / f"{start}.json"
        kept = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
        if kept is not None and kept["asked"] != asked:
            raise Tg4mmError(f"{path} was made with other settings; choose another --out")
        if kept is None:
            loaded = loaded or _load(root, config)
            figures, images = measured(root, start, *loaded, config)
            kept = {"set": root.name, "start": start, "asked": asked, **figures}
            path.parent.mkdir(parents=True, exist_ok=True)
            for i, image in enumerate(images if pictures else ()):
                sheet(image, loaded[2].rgb[i]).save(path.with_name(f"{start}_{i}.png"))
            write_json(path, kept)
        print("  ".join(cells(kept)), flush=True)
        rows.append(kept)
    return rows


def _load(root: Path, config: SpaceConfig) -> tuple[Capture, RestViews, RestViews]:
    capture, test = (load_capture(root, split=split) for split in ("train", "test"))
    views = rest_views(capture, load_images(capture))
    fitted(
        root, views, capture.points, replace(config, iterations=_WARM_UP, init="random")
    )  # loads the kernels
    return capture, views, rest_views(test, load_images(test))


def cells(row: dict[str, Any]) -> list[str]:
    """One row's texts, in the order of HEADER."""
    return [
        row["set"],
        row["start"] if row["source"].startswith(row["start"]) else f"{row['start']} → {row['source']}",
        f"{row['found']:,}", f"{row['taken']:,}", f"{row['gaussians']:,}", f"{row['psnr']:.2f}",
        f"{row['ssim']:.4f}", f"{row['start_s']:.1f}", f"{row['seconds']:.1f}",
    ]  # fmt: skip


def means(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """One line for each start: means over the datasets."""
    lines = []
    for start in dict.fromkeys(row["start"] for row in rows):
        mine = [row for row in rows if row["start"] == start]
        mean = {k: sum(row[k] for row in mine) / len(mine) for k in ("psnr", "ssim", "start_s", "seconds")}
        whole = {k: round(sum(row[k] for row in mine) / len(mine)) for k in ("found", "taken", "gaussians")}
        lines.append(cells({"set": f"mean of {len(mine)}", "start": start, "source": start, **mean, **whole}))
    return lines


OPTIONS = {
    "sets": {"nargs": "+", "type": Path, "metavar": "SET"}, "--out": {"type": Path, "required": True},
    "--inits": ",".join(STARTS), "--iterations": 1500, "--seed": 0, "--pictures": False,
}  # fmt: skip


def run(options: argparse.Namespace) -> None:
    """Print a row for each dataset and start, then means."""
    starts = options.inits.split(",")
    if unknown := [start for start in starts if start not in INITS]:
        raise Tg4mmError(f"--inits: {unknown[0]!r} is none of {', '.join(INITS)}")
    config = SpaceConfig(iterations=options.iterations, seed=options.seed)
    each = (rows_of(root, options.out, starts, config, options.pictures) for root in options.sets)
    rows = [row for some in each for row in some]
    print("\n" + table(HEADER, [cells(row) for row in rows] + means(rows), text_columns=2))
