"""Compute devices: availability, requirements and memory."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from tg4mm.core.errors import Tg4mmError

DEVICES = ("cpu", "cuda")


def check_device(device: str) -> str:
    """`device` if it can be used. Raises Tg4mmError for an unknown one, and for cuda without a GPU or gsplat."""
    if device not in DEVICES:
        raise Tg4mmError(f"device is {device!r}, expected {' or '.join(DEVICES)}")
    if device == "cuda":
        if not torch.cuda.is_available():
            raise Tg4mmError("device is cuda, but torch finds no CUDA device here")
        from tg4mm.fit.rasterize.api import require_gsplat

        require_gsplat()
    return device


@contextmanager
def full_precision(device: str) -> Iterator[None]:
    """Disable reduced-precision float32 on the GPU; the CPU always uses full precision.

    By default torch lets cuDNN round the factors of a convolution to 10 bits (TF32). SSIM takes a
    variance as E[x²] − E[x]² of two convolutions: most of those bits cancel, and the loss would be noise.
    """
    if device == "cpu":
        yield
        return
    before = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = False
    try:
        yield
    finally:
        torch.backends.cudnn.allow_tf32 = before


def reset_gpu_peak(device: str) -> None:
    """Start the peak that `gpu_figures` gives anew."""
    if device == "cuda":
        torch.cuda.reset_peak_memory_stats()


def gpu_figures(device: str) -> dict[str, float]:
    """Return {"peak_gpu_memory_mib": …}, torch's peak allocation, for a stage's log; {} on the CPU."""
    if device != "cuda":
        return {}
    return {"peak_gpu_memory_mib": torch.cuda.max_memory_allocated() / (1 << 20)}
