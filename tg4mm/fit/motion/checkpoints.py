"""Checkpoints: each step of a fit is computed once, and a run that was stopped goes on after the last finished one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from enum import StrEnum
from typing import Protocol

import numpy as np
import torch

from tg4mm.fit.gaussians import Gaussians

Arrays = dict[str, np.ndarray]


class Step(StrEnum):
    """The steps of a fit that are kept, by the name in the checkpoint; some have a number or a suffix."""

    registration = "registration"
    scene = "scene"
    regions = "regions"
    noise = "noise"
    smoothness = "smoothness"
    phases = "phases"
    first_pass = "first_pass"
    second_pass = "second_pass"
    gauss_newton = "gauss_newton"
    support = "support"
    whole_pixels = "whole_pixels"

    def numbered(self, k: int) -> str:
        """Return the name of the k-th such step."""
        return f"{self}_{k}"


class Checkpoint(Protocol):
    """`checkpoint(name, compute)` returns the result of `compute()`, kept if the run was stopped after it."""

    def __call__(self, name: str, compute: Callable[[], Arrays]) -> Arrays: ...


def no_checkpoint(name: str, compute: Callable[[], Arrays]) -> Arrays:
    """Compute without keeping anything."""
    return compute()


def suffixed(checkpoint: Checkpoint, suffix: str) -> Checkpoint:
    """Return the checkpoint with a suffix added to each name."""
    return lambda name, compute: checkpoint(f"{name}_{suffix}", compute)


def arrays_of(gaussians: Gaussians) -> Arrays:
    """Return Gaussians as arrays of a checkpoint."""
    return {f.name: getattr(gaussians, f.name).numpy() for f in fields(gaussians)}


def gaussians_of(arrays: Mapping[str, np.ndarray]) -> Gaussians:
    """Return the Gaussians of `arrays_of`; other arrays are ignored."""
    return Gaussians(**{f.name: torch.from_numpy(np.array(arrays[f.name])) for f in fields(Gaussians)})


def concatenated(some: Sequence[Arrays]) -> Arrays:
    """Concatenate the arrays of each name."""
    return {name: np.concatenate([arrays[name] for arrays in some]) for name in some[0]}
