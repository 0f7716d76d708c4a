"""What an evaluation was asked for, against what there is: the file for the figures, α, metrics, test pictures."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.dataset_tree import magnified_alphas
from tg4mm.core.errors import CaptureError
from tg4mm.core.metrics import SSIM_WINDOW, flip, psnr, ssim
from tg4mm.core.untrusted import read_json
from tg4mm.research.evaluate import EvaluationError
from tg4mm.research.evaluate.lpips import MIN_SIZE, load_lpips
from tg4mm.research.evaluate.scores import Metric
from tg4mm.run import Run
from tg4mm.run.figures_file import FORMAT


def target_file(run: Run, out: Path | str | None) -> Path:
    """The file for the figures, its folder made: one that cannot be is better known before minutes of scoring."""
    target = Path(out) if out is not None else run.path / "metrics.json"
    if target.is_dir():
        raise EvaluationError(
            f"--out {target}: is a folder; expected a file such as {target / 'metrics.json'}"
        )
    if target.exists() and not _is_ours(target):
        raise EvaluationError(f"--out {target}: exists, and is no {FORMAT} file; choose another name")
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        tempfile.TemporaryFile(dir=target.parent).close()
    except OSError as error:
        raise EvaluationError(f"--out {target}: cannot be written: {error.strerror}") from None
    return target


def _is_ours(target: Path) -> bool:
    try:
        found = read_json(target)
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("format") == FORMAT


def alphas_with_truth(alphas: Sequence[float] | None, root: Path, absent: dict[str, str]) -> list[int]:
    """0 and the whole α that have ground truth; the others go to `absent`."""
    for alpha in alphas or ():
        if not (math.isfinite(alpha) and alpha >= 0):
            raise EvaluationError(f"--alphas holds {alpha}, expected numbers ≥ 0")
    found = magnified_alphas(root)
    if alphas is None and not found:
        absent["magnified images"] = f"{root / 'magnified'} has no x… folder: no ground truth beyond α = 0"
    for alpha in alphas or ():
        if alpha not in found and alpha != 0:
            there = ", ".join(map(str, found)) or "none"
            absent[f"α = {alpha:g}"] = f"no such ground truth under {root / 'magnified'} (there: {there})"
    return [0, *(a for a in found if alphas is None or a in alphas)]


def check_alphas(alphas: Sequence[float] | None, root: Path) -> list[int]:
    """The α that are scored. Raises EvaluationError for one that is asked for and has no ground truth."""
    absent: dict[str, str] = {}
    found = alphas_with_truth(alphas, root, absent)
    if alphas is not None and absent:
        what, why = next(iter(absent.items()))
        raise EvaluationError(f"--alphas holds {what}: {why}")
    return found


def image_metrics(
    lpips_weights: Path | str | Sequence[Path | str] | None,
    absent: dict[str, str],
    names: Sequence[str] | None = None,
) -> dict[str, Metric]:
    """The metrics `names`, None for all. LPIPS without weights goes to `absent`. Raises EvaluationError for others."""
    found: dict[str, Metric] = {"psnr_db": psnr, "ssim": ssim, "flip": flip}
    for name in names or ():
        if name not in {*found, "lpips"}:
            raise EvaluationError(f"metrics hold {name!r}, expected some of {', '.join(found)}, lpips")
    wanted = {*found, "lpips"} if names is None else set(names)
    if "lpips" in wanted and lpips_weights is None:
        absent["LPIPS"] = "no weights given (AlexNet's trunk and LPIPS' heads, as local files)"
    elif "lpips" in wanted and lpips_weights is not None:
        found["lpips"] = load_lpips(lpips_weights)
    return {name: metric for name, metric in found.items() if name in wanted}


def capture_with_truth(root: Path, alpha: int, absent: dict[str, str]) -> Capture | None:
    if alpha:
        return load_capture(root, split="test", magnification=alpha)
    try:
        return load_capture(root, split="test")
    except CaptureError as error:
        # Absent is said; present and broken is an error.
        if any(root.glob("transforms_test.json")) or any(root.glob("*/transforms_test.json")):
            raise
        absent["α = 0"] = f"no test split ({error})"
        return None


def fitting(metrics: Mapping[str, Metric], capture: Capture, absent: dict[str, str]) -> dict[str, Metric]:
    """The metrics that images of this size allow."""
    least = {"ssim": SSIM_WINDOW, "lpips": MIN_SIZE}
    small = {m for m in metrics if min(capture.width, capture.height) < least.get(m, 1)}
    for name in small:
        absent[name.upper()] = f"images of {capture.width}×{capture.height} pixels, it needs {least[name]}²"
    return {m: f for m, f in metrics.items() if m not in small}
