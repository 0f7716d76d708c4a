"""Datasets like a given one: with fewer cameras or timesteps, with noise, of another amplitude, filmed otherwise."""

import os
import shutil
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.truth_file import TRUTH_FILE
from tg4mm.core.errors import RunError
from tg4mm.core.files import write_json
from tg4mm.core.pictures.decode import decode, image_header
from tg4mm.core.pictures.frames import write_png
from tg4mm.core.records import read_record
from tg4mm.core.untrusted import read_npz
from tg4mm.core.values import check_form
from tg4mm.research.bench import BenchError, StepError
from tg4mm.research.bench.sets import BenchSet
from tg4mm.research.generator import run_generator
from tg4mm.run.config import read_json

TARGETS_PX = (1.0, 2.0, 4.0, 8.0)  # α times the amplitude, of which there is ground truth
_MOST_ALPHA = 999  # the generator's
DONE = "complete.json"
_SCENE = {
    "scene": str,
    "cameras": {"kind": str, "clock_offset_s?": float},
    "engine": {"name": str, "samples": int},
    "frequency_hz": float,
    "amplitude?": float,
    "n_test": int,
    "n_points?": int,
    "seed?": int,
    "images?": str,
    "background?": str,
}
SLOW = ("--frequency", "3.4")  # Hz: no whole number of periods, as outside of generated data
# How a scene is filmed, as options of the generator; orbit is the reference, 30 views of 30 timesteps by default.
KINDS: dict[str, tuple[str, ...]] = {
    "orbit": (),
    "sweep": ("--cameras", "sweep", "--timesteps", "90", *SLOW),
    "handheld": ("--cameras", "handheld", "--timesteps", "150", *SLOW),
    "rig": ("--cameras", "rig", "--views", "8", "--clock-offsets", "0.5", "--timesteps", "60", *SLOW),
    "clips": ("--cameras", "clips", "--views", "7", "--timesteps", "75", *SLOW),
}


def alphas_for(pixels: float) -> tuple[int, ...]:
    """α at which the magnified motion is `TARGETS_PX`, as whole numbers from 1 to 999."""
    alphas = (round(target / pixels) for target in TARGETS_PX)
    return tuple(dict.fromkeys(a for a in alphas if 1 <= a <= _MOST_ALPHA))


def with_amplitude(data: BenchSet, pixels: float, folder: Path) -> Path:
    """The dataset's scene again, the main mode's amplitude `pixels`; rendered into `folder` where it is not there.

    Size, cameras, timesteps, samples, seed and engine are the dataset's own. Raises BenchError where the dataset is not
    one of the generator's scenes, StepError where rendering fails.
    """
    changed = {"--amplitude-px": f"{pixels:g}", "--alphas": ",".join(map(str, alphas_for(pixels)))}
    return _rendered(data, changed, folder)


def with_kind(data: BenchSet, kind: str, alphas: Sequence[float] | None, folder: Path) -> Path:
    """The dataset's scene filmed in another way, one of `KINDS`; otherwise as `with_amplitude`.

    alphas: those of the dataset's that are rendered; None for all.
    """
    return _rendered(data, kind_options(data, kind, alphas), folder)


def kind_options(data: BenchSet, kind: str, alphas: Sequence[float] | None) -> dict[str, str]:
    """What differs from the dataset's own options; "" takes one away.

    A longer recording has fewer test cameras, at least one, so that there are about as many test pictures.
    """
    given = KINDS[kind] or ("--cameras", "orbit")
    changed = dict(zip(given[::2], given[1::2], strict=True))
    scene = _scene(data)
    if kind != "orbit":  # how many views there are is the kind's own
        n_test = round(scene["n_test"] * data.n_timesteps / int(changed["--timesteps"]))
        changed |= {"--views": changed.get("--views", ""), "--test-views": str(max(n_test, 1))}
    if (amplitude := scene.get("amplitude")) is not None:
        changed["--amplitude"] = f"{amplitude:g}"
    wanted = [str(a) for a in data.alphas if alphas is None or a in alphas]
    return changed | {"--alphas": ",".join(wanted)}


def _rendered(data: BenchSet, changed: Mapping[str, str], folder: Path) -> Path:
    arguments = generator_arguments(data, changed, folder)
    if not _is_done(folder, arguments):
        status = run_generator(arguments)
        if status != 0:
            said = " ".join(f"{k} {v}" for k, v in changed.items() if v)
            raise StepError(f"rendering {data.label} with {said} ended with status {status}; see above")
        write_json(folder / DONE, {"arguments": arguments})
    found = sorted(path.parent for path in folder.glob("*/scene.json"))
    if len(found) != 1:
        raise BenchError(f"{folder} should hold one dataset, it holds {len(found)}")
    return found[0]


def _is_done(folder: Path, arguments: list[str]) -> bool:
    try:
        return read_json(folder / DONE).get("arguments") == arguments
    except RunError:  # it is not there, or torn
        return False


def generator_arguments(data: BenchSet, changed: Mapping[str, str], folder: Path) -> list[str]:
    """What `python -m dataset_gen` is called with: the dataset's own options, and over them what is `changed`.

    Raises BenchError for a dataset it did not render.
    """
    scene = _scene(data)
    name, cameras, engine = scene["scene"], scene["cameras"], scene["engine"]
    options: dict[str, Any] = {
        "--out": folder,
        "--frequency": f"{float(scene['frequency_hz']):g}",
        "--size": data.width,
        "--timesteps": data.n_timesteps,
        "--fps": f"{data.fps:g}",
        "--cameras": cameras["kind"],
        "--views": data.n_views,
        "--test-views": scene["n_test"],
        "--samples": engine["samples"],
        "--seed": scene.get("seed", 0),
        "--points": scene.get("n_points", ""),
        "--images": scene.get("images", "png8"),
        "--background": scene.get("background", "transparent"),
        "--truth": "none",
    }
    options |= changed
    return [str(name), *(str(part) for pair in options.items() if pair[1] != "" for part in pair)]


def _scene(data: BenchSet) -> dict[str, Any]:
    """scene.json of a set that the generator can make anew. Raises BenchError for another."""
    from dataset_gen.scenes import NAMES

    scene = read_json(data.root / "scene.json")
    try:
        check_form(scene, _SCENE)
        plain = scene["engine"]["name"] == "CYCLES" and not scene["cameras"].get("clock_offset_s")
        made_here = scene["scene"] in NAMES and scene["cameras"]["kind"] in {"orbit", "rig"} and plain
    except ValueError:
        made_here = False
    if not made_here or scene.get("sensor") or scene.get("effects"):
        raise BenchError(
            f"dataset {data.root} is not what tg4mm generate makes of a built-in scene by Cycles with an orbit or a "
            "rig of one clock, without a sensor and effects of real cameras, so it cannot be made with another "
            "amplitude or other cameras"
        )
    return scene


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
