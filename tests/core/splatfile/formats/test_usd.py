"""A USD stage holds the splat at every timestep: read back by OpenUSD's generic interface, passed by its validators."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdValidation

from tests.core.splatfile.formats.conftest import angles, turned
from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import SplatFile, positions_at, rotations_at
from tg4mm.show.export.usd import write_usd

ROWS = {  # attribute → field, and how many rows a Gaussian has
    "positions": ("means", 1),
    "scales": ("scales", 1),
    "opacities": ("opacities", 1),
    "radiance:sphericalHarmonicsCoefficients": ("sh", 16),
}


def moments(splat, timesteps):
    for t in timesteps:
        means, quats = positions_at(splat, t).astype(np.float32), rotations_at(splat, t).astype(np.float32)
        one = SplatFile.static(means, quats, splat.scales, splat.opacities, splat.sh, splat.unit_scale_m)
        yield t, one


def values(prim, name, t):
    return np.array(prim.GetAttribute(name).Get(t))


@pytest.mark.parametrize("suffix", ["usdc", "usda"])
def test_every_timestep_is_there(splat, tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    frames = list(moments(splat, range(5)))
    write_usd(path, frames, splat.fps)
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetDefaultPrim()
    assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (30, 0, 4)
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.5)
    assert prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 3
    for t, one in frames:
        for name, (field, rows) in ROWS.items():
            want = getattr(one, field).reshape(len(one) * rows, -1)
            np.testing.assert_array_equal(values(prim, name, t).reshape(want.shape), want, err_msg=name)
        quats = [(q.real, *q.imaginary) for q in prim.GetAttribute("orientations").Get(t)]
        assert angles(np.array(quats), turned(one)).max() < 0.1
    assert prim.GetAttribute("scales").GetNumTimeSamples() == 0  # what does not change is there once
    low, high = values(prim, "extent", 0)
    for _, one in frames:
        assert (one.means >= low).all()
        assert (one.means <= high).all()


def test_openusd_validators_find_nothing(splat, tmp_path):
    write_usd(tmp_path / "a.usdc", moments(splat, range(3)), 30.0)
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    context = UsdValidation.ValidationContext(validators)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert [str(error.GetMessage()) for error in context.Validate(stage)] == []
    stage.ClearMetadata("metersPerUnit")
    assert context.Validate(stage)


def test_an_error_on_the_way_leaves_nothing(splat, tmp_path):
    def broken():
        yield from moments(splat, [0])
        raise SplatFileError("no more")

    with pytest.raises(SplatFileError, match=r"a\.usdc: no more"):
        write_usd(tmp_path / "a.usdc", broken(), 30.0)
    assert list(tmp_path.iterdir()) == []
