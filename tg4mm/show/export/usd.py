"""USD: a ParticleField3DGaussianSplat (OpenUSD 26.03 and later) whose values are sampled at every timestep."""

import errno
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.splatfile.ply import replacing

from ...core.errors import SplatFileError
from ...core.extras import install
from ...core.splatfile.model import SplatFile

SUFFIXES = (".usdc", ".usda", ".usd")
_SIGMAS = 3.0  # drawn extent of a Gaussian


def usd_modules() -> tuple[Any, Any, Any, Any]:
    """Import Usd, UsdGeom, UsdVol, Vt. Raises SplatFileError if usd-core is absent or too old for the schema."""
    try:
        from pxr import Usd, UsdGeom, UsdVol, Vt
    except ImportError:
        raise SplatFileError(f"usd needs the Python package usd-core: {install('usd')}") from None
    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        version = ".".join(str(n) for n in Usd.GetVersion())
        raise SplatFileError(
            f"OpenUSD {version} has no Gaussian splats: pip install 'usd-core>=26.3' (26.11 is the tested one)"
        )
    return Usd, UsdGeom, UsdVol, Vt


def write_usd(path: str | Path, frames: Iterable[tuple[int, SplatFile]], fps: float) -> None:
    """Write moments of one scene, (timestep, Gaussians) in order of time, as one stage; its time codes are timesteps.

    Z is up. Where the scale is not known a scene unit is a metre: without metersPerUnit it would be a centimetre. One
    moment alone is a scene without time. `fps` in Hz. Replaces `path` in one step. Raises SplatFileError if the file
    cannot be written or OpenUSD lacks the schema.
    """
    Usd, UsdGeom, UsdVol, Vt = usd_modules()
    from pxr import Tf

    with replacing(Path(path)) as temporary:
        temporary.touch()  # OpenUSD's message for a missing folder names its source files
        temporary.unlink()
        try:
            stage = Usd.Stage.CreateNew(str(temporary))
            _fill(stage, UsdGeom, UsdVol, Vt, frames, fps)
            stage.GetRootLayer().Save()
        except Tf.ErrorException as error:
            full = os.strerror(errno.ENOSPC)
            if full in str(error):  # among names of source files
                raise OSError(errno.ENOSPC, full, str(path)) from None
            raise SplatFileError("OpenUSD could not write it") from error


def _fill(
    stage: Any, UsdGeom: Any, UsdVol: Any, Vt: Any, frames: Iterable[tuple[int, SplatFile]], fps: float
) -> None:
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/splat")
    stage.SetDefaultPrim(prim.GetPrim())
    series = {
        "means": _Series(prim.CreatePositionsAttr(), Vt.Vec3fArray.FromNumpy),
        "quats": _Series(prim.CreateOrientationsAttr(), lambda q: Vt.QuatfArray.FromNumpy(_unit_xyzw(q))),
        "scales": _Series(prim.CreateScalesAttr(), Vt.Vec3fArray.FromNumpy),
        "opacities": _Series(prim.CreateOpacitiesAttr(), Vt.FloatArray.FromNumpy),
        "sh": _Series(
            prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(),
            lambda sh: Vt.Vec3fArray.FromNumpy(sh.reshape(-1, 3)),
        ),
    }
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    times: list[int] = []
    for t, splat in frames:
        if not times:
            prim.CreateRadianceSphericalHarmonicsDegreeAttr(splat.sh_degree)
            coefficients = UsdGeom.Primvar(prim.GetRadianceSphericalHarmonicsCoefficientsAttr())
            coefficients.SetInterpolation(UsdGeom.Tokens.vertex)
            coefficients.SetElementSize(splat.sh.shape[1])  # asset validators require it
            UsdGeom.SetStageMetersPerUnit(stage, splat.unit_scale_m or 1.0)
        for name, one in series.items():
            one.add(t, np.ascontiguousarray(getattr(splat, name), np.float32))
        reach = _SIGMAS * splat.scales.max(axis=1, keepdims=True)
        low = np.minimum(low, (splat.means - reach).min(axis=0))
        high = np.maximum(high, (splat.means + reach).max(axis=0))
        times.append(t)
    prim.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([low, high]).astype(np.float32)))
    if len(times) > 1:
        stage.SetStartTimeCode(times[0])
        stage.SetEndTimeCode(times[-1])
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)


class _Series:
    """An attribute over time: its first value, and time samples from its first change on."""

    def __init__(self, attribute: Any, convert: Any) -> None:
        self.attribute, self.convert = attribute, convert
        self.first: np.ndarray | None = None
        self.before: list[int] = []  # times at which it was still the first value
        self.changes = False

    def add(self, t: int, values: np.ndarray) -> None:
        if self.first is None:
            self.first = values
            self.attribute.Set(self.convert(values))
        if not self.changes and np.array_equal(values, self.first):
            self.before.append(t)
            return
        if not self.changes:
            for still in {self.before[0], self.before[-1]}:  # values are interpolated linearly
                self.attribute.Set(self.convert(self.first), still)
            self.changes = True
        self.attribute.Set(self.convert(values), t)


def _unit_xyzw(quats: np.ndarray) -> np.ndarray:
    """Return unit quaternions wxyz [N, 4] in the order of OpenUSD's arrays, x, y, z, w."""
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    return np.ascontiguousarray(unit[:, [1, 2, 3, 0]])
