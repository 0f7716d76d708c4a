"""A dataset with some of its training cameras or timesteps, or with noise: its files under another folder."""

from __future__ import annotations

import os
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.truth_file import TRUTH_FILE
from tg4mm.core.files import write_json
from tg4mm.core.pictures.decode import decode, image_header
from tg4mm.core.pictures.frames import write_png
from tg4mm.core.records import read_record
from tg4mm.core.untrusted import read_npz
from tg4mm.research.bench.errors import BenchError
from tg4mm.research.bench.sets import BenchSet

TRAIN = "transforms_train.json"


def with_views(data: BenchSet, n: int, folder: Path) -> Path:
    """The dataset with `n` training cameras, evenly spread, in `folder`/<its name>; made once.

    Everything else is the same: test cameras, ground truth, points. Raises BenchError where the dataset has fewer
    cameras than that, or is no tree of timesteps.
    """
    if n > data.n_views:
        raise BenchError(f"dataset {data.root} has {data.n_views} training cameras, {n} are asked for")
    target = folder / data.root.name
    if target.is_dir():
        return target
    if not (data.root / "000" / TRAIN).is_file():
        raise BenchError(f"dataset {data.root} has no 000/{TRAIN}: its cameras cannot be thinned out")
    kept = set(np.unique(np.linspace(0, data.n_views - 1, n).round().astype(int)).tolist())
    with _made(data, target, [TRAIN]) as making:
        for source in sorted(data.root.glob(f"*/{TRAIN}")):
            _write_thinned(source, making / source.relative_to(data.root), kept)
        _record(making, {"n_train": len(kept)})
    return target


def with_timesteps(data: BenchSet, n: int, folder: Path) -> Path:
    """The dataset with its first `n` timesteps, in `folder`/<its name>; made once. Raises BenchError for too many."""
    if n > data.n_timesteps:
        raise BenchError(f"dataset {data.root} has {data.n_timesteps} timesteps, {n} are asked for")
    target = folder / data.root.name
    if target.is_dir():
        return target
    if not (data.root / "000" / TRAIN).is_file():
        raise BenchError(f"dataset {data.root} has no 000/{TRAIN}: its timesteps cannot be cut")
    later = [f"{t:03d}" for t in range(n, data.n_timesteps)]
    with _made(data, target, later) as making:
        _cut_gains(making / TRUTH_FILE, n)
        _record(making, {"n_timesteps": n})
    return target


def with_noise(data: BenchSet, sigma: float, folder: Path) -> Path:
    """The dataset with normal noise of `sigma`/255 on its training pictures where they are not transparent; made once.

    The noise of a picture depends on its place in the dataset alone. Raises BenchError for pictures of another kind
    than PNG of 8 bits.
    """
    target = folder / data.root.name
    if target.is_dir():
        return target
    with _made(data, target, []) as making:
        for path in sorted(making.glob("[0-9]*/train/*")):
            _add_noise(path, sigma, path.relative_to(making).as_posix())
    return target


def _cut_gains(file: Path, n: int) -> None:
    arrays = read_npz(file)
    if "gains" in arrays:
        arrays["gains"] = arrays["gains"][:, :n]
    file.unlink()  # the name only: the original keeps its content
    np.savez_compressed(file, **arrays)


def _add_noise(path: Path, sigma: float, name: str) -> None:
    if path.suffix.lower() != ".png" or image_header(path).bits != 8:
        raise BenchError(f"{path}: noise is added to PNG of 8 bits")
    image = decode(path)
    draw = np.random.default_rng(zlib.crc32(name.encode()))
    noisy = np.clip(image[..., :3] + draw.normal(0, sigma, image[..., :3].shape), 0, 255).round()
    seen = image[..., 3:] > 0
    colour = np.where(seen, noisy, image[..., :3]).astype(np.uint8)
    path.unlink()
    write_png(path, np.concatenate([colour, image[..., 3:]], -1))


@contextmanager
def _made(data: BenchSet, target: Path, without: list[str]) -> Iterator[Path]:
    """A copy by hard links, but for names `without`, under a temporary name until it is whole."""
    target.parent.mkdir(parents=True, exist_ok=True)
    making = target.parent / f".{target.name}.tmp"
    shutil.rmtree(making, ignore_errors=True)  # what a killed call has left
    shutil.copytree(data.root, making, copy_function=_same_file, ignore=shutil.ignore_patterns(*without))
    yield making
    os.replace(making, target)


def _same_file(source: str, target: str) -> None:
    """A hard link, since a dataset's paths may not leave its folder; a copy where that cannot be."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _write_thinned(source: Path, target: Path, kept: set[int]) -> None:
    record = read_record(source)
    frames = record.values.get("frames")
    if not isinstance(frames, list):
        raise record.error("frames", "a list")
    content: dict[str, Any] = record.values | {"frames": [f for i, f in enumerate(frames) if i in kept]}
    target.unlink(missing_ok=True)
    write_json(target, content)


def _record(root: Path, changed: dict[str, int]) -> None:
    file = root / "scene.json"
    scene = read_record(file).values
    file.unlink()  # the name only: the original keeps its content
    write_json(file, scene | changed)
