"""The space stage's own unit: cameras DISTANCE away from the middle of what they see, whatever unit the scene is in."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from tg4mm.capture import SurfacePoints
from tg4mm.capture.cameras import middle_distance, relative_to
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space.targets import RestViews
from tg4mm.fit.space.view import DISTANCE

# Places are rounded to this: a scene written in another unit, or elsewhere, then gives the same bits nearly always.
# Seen from DISTANCE it is a four-millionth of a radian.
_GRAIN = 2.0**-20


@dataclass(frozen=True)
class SceneUnit:
    """x = centre + unit · x', with x in the scene's unit and x' in the stage's."""

    centre: np.ndarray  # [3] float64, scene units
    unit: float  # scene units

    @classmethod
    def of(cls, views: RestViews, points: SurfacePoints | None) -> "SceneUnit":
        """Compute the unit from the cameras or, if they share one position, from the points."""
        xyz = None if points is None else points.xyz
        centre, distance = middle_distance(views.viewmats, views.Ks, views.size, xyz)
        return cls(centre, distance / DISTANCE)

    def views(self, views: RestViews) -> RestViews:
        """Views from the same cameras, float32."""
        moved = relative_to(views.viewmats.astype(np.float64), self.centre)
        moved[:, :3, 3] = _rounded(moved[:, :3, 3] / self.unit)
        return replace(views, viewmats=moved.astype(np.float32), Ks=views.Ks.astype(np.float32))

    def points(self, points: SurfacePoints | None) -> SurfacePoints | None:
        """The same points, float32."""
        if points is None:
            return None
        xyz = _rounded((points.xyz.astype(np.float64) - self.centre) / self.unit)
        return replace(points, xyz=xyz.astype(np.float32))

    def back(self, gaussians: Gaussians) -> Gaussians:
        """Gaussians in scene units, float32."""
        means = gaussians.means.double() * self.unit + torch.from_numpy(self.centre)
        scales = gaussians.scales.double() * self.unit
        return replace(gaussians, means=means.float(), scales=scales.float())


def _rounded(places: np.ndarray) -> np.ndarray:
    return np.asarray(np.round(places / _GRAIN) * _GRAIN)
