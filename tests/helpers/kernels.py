"""The compiled functions that a job of `tg4mm.fit.precompile` names."""

import importlib

from tg4mm.fit.kernel_calls import Job

MODULES = {
    "project": "tg4mm.fit.rasterize.kernels.project",
    "project_backward": "tg4mm.fit.rasterize.kernels.project_backward",
    "binning": "tg4mm.fit.rasterize.kernels.binning", "blend": "tg4mm.fit.rasterize.kernels.blend",
    "blend_backward": "tg4mm.fit.rasterize.kernels.blend_backward", "normal": "tg4mm.fit.rasterize.kernels.normal",
    "linearised": "tg4mm.fit.rasterize.kernels.linearised", "kernels": "tg4mm.fit.space.kernels",
    "projection": "tg4mm.fit.motion.jacobian.projection", "packed": "tg4mm.fit.motion.jacobian.packed",
}  # fmt: skip


def kernels_of(job: Job) -> list:
    names = [kernel.split(".") for kernel in job.kernels]
    return [getattr(importlib.import_module(MODULES[module]), name) for module, name in names]
