"""LPIPS (Zhang et al. 2018, version 0.1) with an AlexNet trunk, from weight files that the user gives.

Own definition of AlexNet's five convolutions; nothing is downloaded and there is no random trunk: without
files the metric is absent. Understood names of weights, as torchvision and the `lpips` package write them:
trunk `features.<i>.weight|bias` or `net.slice<j>.<i>.weight|bias`, i in 0, 3, 6, 8, 10; heads
`lin<k>.model.1.weight`, k in 0..4.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor

from tg4mm.core.metrics import check_images
from tg4mm.research.evaluate import EvaluationError

MIN_SIZE = 31  # pixels: below it the second pooling has no window left
_SUFFIXES = (".safetensors", ".pth", ".pt")
_TRUNK = re.compile(r"(?:features|net\.slice[1-5])\.(0|3|6|8|10)\.(weight|bias)")
_HEAD = re.compile(r"lin([0-4])\.model\.1\.weight")
_STAGES = (0, 3, 6, 8, 10)  # indices of the convolutions in AlexNet's feature stack
_WEIGHT_SHAPES = ((64, 3, 11, 11), (192, 64, 5, 5), (384, 192, 3, 3), (256, 384, 3, 3), (256, 256, 3, 3))
_STRIDE_PADDING = ((4, 2), (1, 2), (1, 1), (1, 1), (1, 1))
_POOL_BEFORE = (False, True, True, False, False)
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of images in -1..1, LPIPS' own constants
_EPS = 1e-10


@dataclass(frozen=True)
class Lpips:
    """The weights of the metric; call it with two images [H, W, 3] in 0..1 for their distance, 0 = equal."""

    weights: tuple[Tensor, ...]  # five, [out, in, k, k]
    biases: tuple[Tensor, ...]  # five, [out]
    heads: tuple[Tensor, ...]  # five, [1, out, 1, 1]

    def __call__(self, image: np.ndarray, truth: np.ndarray) -> float:
        image, truth = check_images(image, truth)
        if min(image.shape[:2]) < MIN_SIZE:
            raise ValueError(
                f"image of {image.shape[1]}×{image.shape[0]} pixels, LPIPS needs {MIN_SIZE}×{MIN_SIZE}"
            )
        pair = torch.from_numpy(np.stack([image, truth]).astype(np.float32)).permute(0, 3, 1, 2)
        with torch.no_grad():
            total = sum(
                F.conv2d((f[:1] - f[1:]) ** 2, head).mean()
                for f, head in zip(map(_unit, self._features(pair * 2.0 - 1.0)), self.heads, strict=True)
            )
        return float(total)

    def _features(self, x: Tensor) -> list[Tensor]:
        """The five rectified feature maps of AlexNet for images [B, 3, H, W] in -1..1."""
        x = (x - x.new_tensor(_SHIFT).view(1, 3, 1, 1)) / x.new_tensor(_SCALE).view(1, 3, 1, 1)
        maps = []
        for weight, bias, pool, (stride, padding) in zip(
            self.weights, self.biases, _POOL_BEFORE, _STRIDE_PADDING, strict=True
        ):
            if pool:
                x = F.max_pool2d(x, 3, 2)
            x = F.relu(F.conv2d(x, weight, bias, stride, padding))
            maps.append(x)
        return maps


def _unit(features: Tensor) -> Tensor:
    """Features [B, C, h, w] with each pixel's channel vector scaled to length 1."""
    return features / (features.norm(dim=1, keepdim=True) + _EPS)


def load_lpips(paths: Path | str | Sequence[Path | str]) -> Lpips:
    """The metric from one or several files, or all weight files of a folder; trunk and heads may be apart.

    `.safetensors`, or `.pth`/`.pt` read with `weights_only=True`. Raises EvaluationError naming the file that
    cannot be read, the weight that is missing, or the one whose shape is not AlexNet's.
    """
    files = _files([paths] if isinstance(paths, str | Path) else paths)
    found: dict[str, tuple[Path, Tensor]] = {}
    for file in files:
        found |= {key: (file, tensor) for name, tensor in _read(file).items() if (key := _key(name))}
    where = ", ".join(str(f) for f in files)
    weights = tuple(
        _take(found, f"weight {i}", s, where) for i, s in zip(_STAGES, _WEIGHT_SHAPES, strict=True)
    )
    biases = tuple(
        _take(found, f"bias {i}", s[:1], where) for i, s in zip(_STAGES, _WEIGHT_SHAPES, strict=True)
    )
    heads = tuple(_take(found, f"head {k}", (1, s[0], 1, 1), where) for k, s in enumerate(_WEIGHT_SHAPES))
    return Lpips(weights, biases, heads)


def _key(name: str) -> str | None:
    if match := _TRUNK.fullmatch(name):
        return f"{match[2]} {match[1]}"
    match = _HEAD.fullmatch(name)
    return f"head {match[1]}" if match else None


def _files(paths: Sequence[Path | str]) -> list[Path]:
    files: list[Path] = []
    for path in map(Path, paths):
        inside = sorted(p for p in path.iterdir() if p.suffix in _SUFFIXES) if path.is_dir() else [path]
        if not inside:
            raise EvaluationError(f"LPIPS weights: {path} holds no {' or '.join(_SUFFIXES)} file")
        files += inside
    return files


def _read(file: Path) -> dict[str, Tensor]:
    if not file.is_file():
        raise EvaluationError(f"LPIPS weights: {file} does not exist")
    if file.suffix not in _SUFFIXES:
        raise EvaluationError(
            f"LPIPS weights: {file} has the suffix {file.suffix!r}, expected {' or '.join(_SUFFIXES)}"
        )
    try:
        state = load_file(file) if file.suffix == ".safetensors" else _load_pth(file)
    # Both packages report damage by many types: SafetensorError, UnpicklingError, IndexError of torch's unpickler.
    except Exception as error:
        # The first sentence: what torch adds to it is advice to run the file's code.
        line = (str(error).strip() or type(error).__name__).splitlines()[0].partition(". ")[0]
        raise EvaluationError(f"LPIPS weights: {file} cannot be read: {line[:160]}") from None
    if not isinstance(state, dict):
        raise EvaluationError(f"LPIPS weights: {file} holds {type(state).__name__}, expected named tensors")
    return {
        name: value for name, value in state.items() if isinstance(name, str) and isinstance(value, Tensor)
    }


def _load_pth(file: Path) -> object:
    # A .pth is a pickle: weights_only restricts it to tensors and plain containers, and refuses all else.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on the pickle's protocol; whether it was read is what counts
        return torch.load(file, map_location="cpu", weights_only=True)


def _take(found: dict[str, tuple[Path, Tensor]], key: str, shape: tuple[int, ...], where: str) -> Tensor:
    if key not in found:
        kind, index = key.split()
        name = f"lin{index}.model.1.weight" if kind == "head" else f"features.{index}.{kind}"
        raise EvaluationError(f"LPIPS weights: {name} is not in {where}")
    file, tensor = found[key]
    if tuple(tensor.shape) != shape:
        raise EvaluationError(
            f"LPIPS weights: {key} in {file} has shape {tuple(tensor.shape)}, expected {shape}"
        )
    if not bool(torch.isfinite(tensor).all()):
        raise EvaluationError(f"LPIPS weights: {key} in {file} holds a value that is not finite")
    return tensor.float()
