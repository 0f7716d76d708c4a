"""Datasets like a given one, but with another amplitude: rendered by the generator, unless they are there."""

from __future__ import annotations

from pathlib import Path

from tg4mm.bench.errors import BenchError, StepError
from tg4mm.bench.sets import BenchSet
from tg4mm.errors import RunError
from tg4mm.files import write_json
from tg4mm.form import check_form
from tg4mm.generator import run_generator
from tg4mm.run.config import read_json

TARGETS_PX = (1.0, 2.0, 4.0, 8.0)  # α times the amplitude, of which there is ground truth
_MOST_ALPHA = 999  # the generator's
DONE = "complete.json"
_SCENE = {
    "scene": str,
    "cameras": {"kind": str},
    "engine": {"samples": int},
    "frequency_hz": float,
    "n_test": int,
    "seed?": int,
    "images?": str,
    "background?": str,
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
    arguments = generator_arguments(data, pixels, folder)
    if not _is_done(folder, arguments):
        status = run_generator(arguments)
        if status != 0:
            raise StepError(f"rendering {data.label} at {pixels:g} px ended with status {status}; see above")
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


def generator_arguments(data: BenchSet, pixels: float, folder: Path) -> list[str]:
    """What `python -m dataset_gen` is called with. Raises BenchError for a dataset it did not render."""
    from dataset_gen.scenes import NAMES

    scene = read_json(data.root / "scene.json")
    try:
        check_form(scene, _SCENE)
        made_here = scene["scene"] in NAMES and scene["cameras"]["kind"] in {"orbit", "rig"}
    except ValueError:
        made_here = False
    if not made_here or scene.get("sensor"):
        raise BenchError(
            f"dataset {data.root} is not what tg4mm generate makes of a built-in scene with an orbit or a rig and "
            "without a sensor, so it cannot be made with another amplitude"
        )
    name, cameras, engine = scene["scene"], scene["cameras"], scene["engine"]
    options = {
        "--out": folder,
        "--amplitude-px": f"{pixels:g}",
        "--frequency": f"{float(scene['frequency_hz']):g}",
        "--size": data.width,
        "--timesteps": data.n_timesteps,
        "--fps": f"{data.fps:g}",
        "--cameras": cameras["kind"],
        "--views": data.n_views,
        "--test-views": scene["n_test"],
        "--samples": engine["samples"],
        "--seed": scene.get("seed", 0),
        "--images": scene.get("images", "png8"),
        "--background": scene.get("background", "transparent"),
        "--alphas": ",".join(map(str, alphas_for(pixels))),
        "--truth": "none",
    }
    return [str(name), *(str(part) for pair in options.items() for part in pair)]
