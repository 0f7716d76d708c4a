"""The calls that compile: each kernel on next to nothing, with the types that the program calls it with."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Job:
    """A call that compiles, and the kernels that wait for it, each as module.function."""

    call: Callable[[], None]
    group: str
    kernels: tuple[str, ...]


def _gaussians(n: int = 16) -> dict[str, np.ndarray]:
    """means [N, 3], quats [N, 4], scales [N, 3], opacities [N], sh [N, 16, 3], behind the camera: nothing is seen."""
    shapes = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,), "sh": (n, 16, 3)}
    return {name: np.full(shape, -1.0, np.float32) for name, shape in shapes.items()}


def _camera() -> np.ndarray:
    from tg4mm.fit.rasterize.kernels.project import pack_camera

    return np.asarray(pack_camera(np.eye(4), np.eye(3), 0.01, 100.0, 0.3))


def _lists() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A tile without pairs: its start and end, the pairs' Gaussians, and the blocks that they reach."""
    return np.zeros(2, np.int32), np.empty(0, np.int32), np.empty(0, np.uint32)


def _project() -> None:
    from tg4mm.fit.rasterize.kernels.project import empty_splats, project_forward

    project_forward(*_gaussians().values(), 3, False, _camera(), 16, 16, empty_splats(16))


def _bin() -> None:
    from tg4mm.fit.rasterize.kernels.binning import bin_splats
    from tg4mm.fit.rasterize.kernels.layout import SPLAT_WIDTH

    bin_splats(np.full((16, SPLAT_WIDTH), -1.0, np.float32), 16, 16)


def _blend() -> None:
    from tg4mm.fit.rasterize.kernels.blend import blend_forward
    from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH

    starts, pairs, reached = _lists()
    image, transmittance = np.empty((16, 16, FEATURES), np.float32), np.empty((16, 16), np.float32)
    splats = np.zeros((1, SPLAT_WIDTH), np.float32)
    blend_forward(splats, starts, pairs, 16, 16, image, transmittance, reached=reached)


def _blend_backward() -> None:
    from tg4mm.fit.rasterize.kernels.blend_backward import blend_backward
    from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH

    starts, pairs, reached = _lists()
    image, transmittance = np.zeros((16, 16, FEATURES), np.float32), np.zeros((16, 16), np.float32)
    splats, sums = np.zeros((1, SPLAT_WIDTH), np.float32), np.empty((0, SPLAT_WIDTH), np.float32)
    blend_backward(
        splats, starts, pairs, 16, 16, image, transmittance, image, transmittance, sums, reached=reached
    )


def _gather() -> None:
    from tg4mm.fit.rasterize.kernels.binning import gather_sums
    from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH
    from tg4mm.fit.space.kernels import compare

    none, sums = np.zeros(1, np.int32), np.zeros((1, SPLAT_WIDTH), np.float32)
    gather_sums(none, 0, none, none, sums, sums)
    image, plane, rgb = (np.zeros((16, 16, *more), np.float32) for more in ((FEATURES,), (), (3,)))
    loss = 1.0, 10.0, rgb[:0, :0, :0].copy()
    compare(image, plane, rgb, 1.0, np.ones(3, np.float32), *loss, image, plane, np.empty(16))


def _step() -> None:
    from tg4mm.fit.rasterize.kernels.layout import SPLAT_WIDTH
    from tg4mm.fit.space.kernels import activate, scratch_shape, step

    g = _gaussians()
    values = (g["means"], g["quats"], g["scales"], g["opacities"], g["sh"])
    active = np.empty((16, 3), np.float32), np.empty(16, np.float32)
    activate(values[2], values[3], *active)
    splats, error = np.full((16, SPLAT_WIDTH), -1.0, np.float32), np.zeros(16, np.float32)
    first, second = (tuple(np.zeros_like(a) for a in values) for _ in range(2))
    step(
        values, first, second, active, (3, _camera(), 16, 16), splats, splats, error, np.zeros(6, np.float32),
        np.float32(1.0), np.empty(scratch_shape(16), np.float32),
    )  # fmt: skip


def _project_backward() -> None:
    from tg4mm.fit.rasterize.kernels.layout import SPLAT_WIDTH
    from tg4mm.fit.rasterize.kernels.project_backward import project_backward

    g, splats = _gaussians(), np.full((16, SPLAT_WIDTH), -1.0, np.float32)
    inputs = g["means"], g["quats"], g["scales"], g["sh"]
    gradients = [np.zeros_like(a) for a in g.values()]
    view = 3, False, _camera(), 16, 16
    project_backward(*inputs, *view, splats, splats, True, *gradients, np.empty((0, 12), np.float32), False)


def _jacobian() -> None:
    from tg4mm.fit.motion.jacobian.projection import splat_jacobian
    from tg4mm.fit.rasterize.kernels.layout import SPLAT_WIDTH

    g, splats = _gaussians(), np.full((16, SPLAT_WIDTH), -1.0, np.float32)
    splat_jacobian(g["means"], g["quats"], g["scales"], g["sh"], 3, _camera(), (16, 16), splats)


def _normal() -> None:
    from tg4mm.fit.rasterize.kernels.layout import SPLAT_WIDTH
    from tg4mm.fit.rasterize.kernels.normal import blend_normal, most_blocks

    starts, pairs, reached = _lists()
    splats, changes = np.zeros((1, SPLAT_WIDTH), np.float32), np.zeros((1, 1, 8), np.float32)
    most = most_blocks(starts, reached)
    pixels, gradients = np.ones((16, 16), np.float32), np.empty((0, 1, 8), np.float32)
    blend_normal(splats, changes, starts, pairs, reached, most, 1.0, pixels, gradients, 1e-3)


def _cotangents() -> None:
    from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH
    from tg4mm.fit.rasterize.kernels.linearised import blend_cotangents

    starts, pairs, _ = _lists()
    splats, image = np.zeros((1, SPLAT_WIDTH), np.float32), np.zeros((16, 16, FEATURES), np.float32)
    pictures, gradients = np.zeros((1, 16, 16, 3), np.float32), np.empty((0, 1, 8), np.float32)
    blend_cotangents(splats, starts, pairs, 1.0, image, image[..., 0].copy(), pictures, gradients, 1e-3)


def _rows() -> None:
    from tg4mm.fit.motion.jacobian.packed import jvp_rows, pack, vjp_rows

    values, rows = pack(np.zeros((1, 8, 6), np.float32)), np.zeros(1, np.int32)
    motions, changes = np.zeros((1, 1, 6), np.float32), np.zeros((1, 1, 8), np.float32)
    jvp_rows(values, rows, motions, changes)
    vjp_rows(values, rows, np.zeros(2, np.int32), rows, changes, motions)


# What training needs comes first, the longest before the others, so that two processes end at about the same time.
JOBS = {
    "step": Job(_step, "training", ("project_backward.backward_rows", "kernels.activate", "kernels.step")),
    "blend": Job(_blend, "pictures", ("blend._forward_tiles", "blend._forward")),
    "backward": Job(
        _blend_backward, "gradients", ("blend_backward._backward_tiles", "blend_backward._backward")
    ),
    "bin": Job(
        _bin,
        "pictures",
        ("binning.depth_order", "binning.list_pairs", "binning.offsets", "binning.fill_pairs"),
    ),
    "project": Job(_project, "pictures", ("project.project_forward",)),
    "gather": Job(_gather, "gradients", ("binning.gather_sums", "kernels.compare")),
    "jacobian": Job(_jacobian, "motion", ("projection._of_some", "projection._of_all")),
    "normal": Job(_normal, "motion", ("normal._normal_tiles", "normal._normal", "normal.most_blocks")),
    "cotangents": Job(_cotangents, "motion", ("linearised._vjp_tiles", "linearised._vjp")),
    "rows": Job(_rows, "motion", ("packed._jvp_range", "packed._vjp_range", "packed._jvp", "packed._vjp")),
    "project backward": Job(_project_backward, "gradients by torch", ("project_backward.project_backward",)),
}
# Groups that a first iteration asks for one after the other: waited for together.
TOGETHER = {"training": ("training", "pictures", "gradients")}
JOB_OF = {kernel: name for name, job in JOBS.items() for kernel in job.kernels}
