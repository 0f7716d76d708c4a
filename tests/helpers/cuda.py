"""What every test that needs a GPU carries."""

import importlib.util

import pytest
import torch

needs_cuda = pytest.mark.skipif(
    not torch.cuda.is_available() or importlib.util.find_spec("gsplat") is None,
    reason="needs a CUDA device and gsplat; torch sees no device here"
    if not torch.cuda.is_available()
    else 'gsplat is not installed (pip install ".[cuda]")',
)
