"""Other random numbers for the whole suite: a seed that a test gives becomes seed + TG4MM_SEED_OFFSET.

A bound that holds for one seed alone shows itself so. What the product seeds stays as it is: the caller's module
decides. A test module that holds stored bits says so by a module constant FIXED_SEEDS = "why".
"""

import importlib.util
import sys

import numpy as np


def shift_seeds(offset: int) -> None:
    """Replace numpy's and torch's makers of seeded generators, for this process."""
    default_rng = np.random.default_rng

    def shifted(seed):
        caller = sys._getframe(2).f_globals  # of what called the function below
        is_tests = caller["__name__"].startswith("tests.") and "FIXED_SEEDS" not in caller
        return seed + offset if is_tests and isinstance(seed, int) else seed

    np.random.default_rng = lambda seed=None: default_rng(shifted(seed))
    if importlib.util.find_spec("torch"):
        import torch

        class Generator(torch.Generator):
            def manual_seed(self, seed):
                super().manual_seed(shifted(seed))
                return self

        torch.Generator = Generator
