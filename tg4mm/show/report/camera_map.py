"""Where the cameras stand: the scene from above and from the side, with the box of the Gaussians."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from tg4mm.core.pages.charts import CEILING, MUTED, OURS, STILL, chart
from tg4mm.core.pages.page import Block, Figure, drawing
from tg4mm.show.report.summary import Material

_POINTS = 250  # Gaussians that are drawn
_ARROWS = 60  # cameras with a line of sight
_VIEWS = (("From above", 0, 1), ("From the side", 0, 2))  # title and the two world axes


def camera_map(m: Material) -> Block:
    """Two charts side by side, lengths in metres where the scale is known."""
    scale = m.train.unit_scale_m
    factor, unit = (1.0, "scene units") if scale is None else (scale, "m")
    eyes, ahead = _poses(m)
    points = _points(m) * factor
    low, high = np.percentile(points, [1, 99], axis=0)
    reach = 0.25 * float(np.median(np.linalg.norm(eyes * factor - (low + high) / 2, axis=1)))

    def draw(axes: Any, a: int, b: int) -> None:
        axes.plot(points[:, a], points[:, b], ".", ms=1.6, color=STILL, zorder=1)
        box = np.array(
            [[low[a], low[b]], [high[a], low[b]], [high[a], high[b]], [low[a], high[b]], [low[a], low[b]]]
        )
        axes.plot(box[:, 0], box[:, 1], color=CEILING, lw=1.1, label="Gaussians, 98 % on each axis")
        own = eyes * factor
        for i in np.unique(np.linspace(0, len(own) - 1, min(len(own), _ARROWS)).round().astype(int)):
            tip = own[i] + reach * ahead[i]
            axes.plot([own[i, a], tip[a]], [own[i, b], tip[b]], color=MUTED, lw=0.7)
        axes.plot(own[:, a], own[:, b], "s", ms=3.2, color=MUTED, label="training cameras")
        shown = m.view.camera.position * factor
        tip = shown + reach * m.view.camera.forward
        axes.plot([shown[a], tip[a]], [shown[b], tip[b]], color=OURS, lw=1.4)
        axes.plot(shown[a], shown[b], "o", ms=6, color=OURS, label="the camera shown here")
        axes.set(xlabel=f"{'xyz'[a]}, {unit}", ylabel=f"{'xyz'[b]}, {unit}")
        axes.set_aspect("equal", adjustable="datalim")

    charts = []
    for title, a, b in _VIEWS:
        label = f"cameras and Gaussians {title.lower()}"
        charts.append(drawing(chart(partial(draw, a=a, b=b), label, (5.0, 4.2)), title))
    caption = (
        "Camera map in the world's axes, z up: squares are training cameras with their lines of sight, the large dot "
        "is the camera of the videos and maps, the box holds 98 % of what is seen of the Gaussians on each axis, small "
        "dots some of them."
    )
    return Figure(charts, caption)


def _poses(m: Material) -> tuple[np.ndarray, np.ndarray]:
    """Positions and viewing directions [C, 3] of the different training cameras, scene units."""
    first = np.unique(m.train.camera_ids, return_index=True)[1]
    viewmats = m.train.viewmats[first]
    return -np.einsum("cij,ci->cj", viewmats[:, :3, :3], viewmats[:, :3, 3]), viewmats[:, 2, :3]


def _points(m: Material) -> np.ndarray:
    """[n, 3] some Gaussians, drawn by their blending weight."""
    means = m.model.gaussians.means.numpy().astype(np.float64)
    weights = np.maximum(m.model.weights, 0).astype(np.float64)
    if not weights.sum() > 0:
        weights = np.ones(len(means))
    chosen = np.random.default_rng(0).choice(len(means), _POINTS, p=weights / weights.sum())
    return means[chosen]
