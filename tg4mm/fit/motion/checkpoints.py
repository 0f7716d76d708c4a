"""Checkpoints: each step of a fit is computed once, and a run that was stopped goes on after the last finished one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Protocol

import numpy as np
import torch

from tg4mm.fit.gaussians import Gaussians

Arrays = dict[str, np.ndarray]


class Checkpoint(Protocol):
    """`checkpoint(name, compute)`: what `compute()` gives, or gave before the run was stopped."""

    def __call__(self, name: str, compute: Callable[[], Arrays]) -> Arrays: ...


def no_checkpoint(name: str, compute: Callable[[], Arrays]) -> Arrays:
    """Nothing is kept."""
    return compute()


def suffixed(checkpoint: Checkpoint, suffix: str) -> Checkpoint:
    """The checkpoint under other names: each with a suffix."""
    return lambda name, compute: checkpoint(f"{name}_{suffix}", compute)


def arrays_of(gaussians: Gaussians) -> Arrays:
    """Gaussians as what a step gives, or a part of it."""
    return {f.name: getattr(gaussians, f.name).numpy() for f in fields(gaussians)}


def gaussians_of(arrays: Mapping[str, np.ndarray]) -> Gaussians:
    """From what `arrays_of` gave, among other arrays."""
    return Gaussians(**{f.name: torch.from_numpy(np.array(arrays[f.name])) for f in fields(Gaussians)})


def concatenated(some: Sequence[Arrays]) -> Arrays:
    """Each of the named arrays, one after the other."""
    return {name: np.concatenate([arrays[name] for arrays in some]) for name in some[0]}
