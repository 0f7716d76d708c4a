"""Validation of an unfinished space stage's checkpoint, before anything is computed with it."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import RunError
from tg4mm.core.progress import progress
from tg4mm.core.values import POSITIVE, Number
from tg4mm.fit.space.config import SpaceConfig
from tg4mm.fit.space.targets import RestViews


def pictures_digest(views: RestViews) -> str:
    """SHA-256 of cameras and pictures."""
    digest = hashlib.sha256(repr(views.rgb.shape).encode())
    for array in (views.viewmats, views.Ks):
        digest.update(np.ascontiguousarray(array).data)
    with progress("digest of the pictures", len(views.rgb), "pictures", brief=True) as update:
        for done, picture in enumerate(views.rgb, 1):
            digest.update(np.ascontiguousarray(picture).data)
            update(done)
    return digest.hexdigest()


def check_checkpoint(
    tensors: Mapping[str, Tensor], state: Mapping[str, Any], pictures: str, n_views: int, config: SpaceConfig
) -> None:
    """Raise RunError, with the first thing wrong, unless the stage can continue from this checkpoint.

    `config` has its zeros filled in; `pictures` is the digest of the n_views pictures.
    """
    if state.get("pictures") != pictures:
        raise RunError("cameras or pictures of the dataset have changed since")
    _check_state(state, n_views, config)
    _check_tensors(tensors, state["iteration"], n_views, config)


def _check_state(state: Mapping[str, Any], n_views: int, config: SpaceConfig) -> None:
    order, view = state.get("order"), Number(0, n_views - 1, whole=True)
    good = {
        "iteration": Number(0, config.iterations, whole=True).fits(state.get("iteration")),
        "order": isinstance(order, list) and all(map(view.fits, order)) and len(set(order)) == len(order),
        "psnr": Number().fits(state.get("psnr")),
        "extent": POSITIVE.fits(state.get("extent")),
    }
    for name, is_good in good.items():
        if not is_good:
            text = json.dumps(state.get(name))
            raise RunError(f"{name} is {text}: no state of {config.iterations} iterations on {n_views} views")


def _check_tensors(tensors: Mapping[str, Tensor], iteration: int, n_views: int, config: SpaceConfig) -> None:
    """Check names, types and shapes: the kernels would write past arrays that are too short."""
    n = len(tensors["logits"]) if tensors.get("logits", torch.empty(())).dim() == 1 else 0
    if not 1 <= n <= config.max_gaussians:
        raise RunError(f"it holds {n} Gaussians, expected 1 to {config.max_gaussians}")
    expected = _shapes(n, config.sh_degree, stepped=iteration > 0)
    if config.gains:
        expected["gains"] = (n_views, 3)
    found = set(tensors) - {"generator", "draws"}
    if found != set(expected) or "generator" not in tensors:
        raise RunError(f"it holds the tensors {sorted(tensors)}, expected {sorted([*expected, 'generator'])}")
    for name, shape in expected.items():
        tensor = tensors[name]
        if tensor.dtype != torch.float32 or tuple(tensor.shape) != shape:
            raise RunError(f"{name} is {tensor.dtype} {tuple(tensor.shape)}, expected float32 {shape}")
    try:
        torch.Generator().set_state(tensors["generator"])
    except (RuntimeError, TypeError) as error:
        raise RunError(f"generator is no state of a random generator: {error}") from None


def _shapes(n: int, sh_degree: int, stepped: bool) -> dict[str, tuple[int, ...]]:
    """Shapes of the tensors but the generators; Adam has moments once it has stepped."""
    parameters: dict[str, tuple[int, ...]] = {
        "means": (n, 3),
        "quats": (n, 4),
        "log_scales": (n, 3),
        "logits": (n,),
        "sh0": (n, 1, 3),
        "shn": (n, (sh_degree + 1) ** 2 - 1, 3),
    }
    moments = {f"adam.{name}.{kind}": shape for name, shape in parameters.items() for kind in "mv"}
    return parameters | {"error": (n,)} | (moments | {"adam.step": ()} if stepped else {})
