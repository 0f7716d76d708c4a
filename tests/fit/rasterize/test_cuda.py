"""gsplat: what must be there, that its constants and signatures are those we rely on, and its pictures."""

import sys
import types

import pytest
import torch

from tests.fit.rasterize.oracle import check, make_scene, uniform, with_channels
from tests.helpers.cuda import needs_cuda
from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.rasterize.api import require_gsplat

BUILD = RuntimeError("Ninja is required to load C++ extensions\nand then two hundred lines")
TWO = OSError("CUDA_HOME environment variable is not set."), ImportError("no gsplat_cuda.so")


def harmonics_of_1_5(degrees_to_use, dirs, coeffs): ...


def harmonics_of_1_6(degrees_to_use, means, viewmats, coeffs): ...


def fake(monkeypatch, projection, backend, harmonics=harmonics_of_1_5):
    """A gsplat of which the check sees no more than this."""
    package, cuda = types.ModuleType("gsplat"), types.ModuleType("gsplat.cuda")
    package.__version__ = "1.2.3"
    package.fully_fused_projection = projection
    package.spherical_harmonics = harmonics
    package.__path__, cuda.__path__ = [], []
    modules = {"gsplat": package, "gsplat.cuda": cuda, "gsplat.cuda._backend": backend}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)


def backend(kernels):
    module = types.ModuleType("gsplat.cuda._backend")
    module._C = kernels
    return module


def new(means, opacities): ...


def old(means): ...


def broken(*errors):
    """Kernels that do not load: the first error, while it is handled the next."""

    class Broken(types.ModuleType):
        def __getattr__(self, name):
            try:
                raise errors[0]
            except type(errors[0]):
                raise errors[-1]  # noqa: B904

    return Broken("gsplat.cuda._backend")


REFUSED = {
    "too old": ((old, backend(object())), "gsplat 1.2.3 is too old"),
    "other pictures": ((new, backend(object()), harmonics_of_1_6), "gsplat 1.2.3 is too new"),
    "no kernels": ((new, backend(None)), "gsplat is installed without CUDA kernels and finds no nvcc"),
    "no build": ((new, broken(BUILD)), "gsplat's CUDA kernels do not load: Ninja is required"),
    "two failures": ((new, broken(*TWO)), "gsplat's CUDA kernels do not load: CUDA_HOME environment variable"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_one_that_will_not_do_is_refused_in_one_line(kind, monkeypatch):
    parts, match = REFUSED[kind]
    fake(monkeypatch, *parts)
    with pytest.raises(Tg4mmError, match=rf"\A[^\n]*{match}[^\n]*\Z"):
        require_gsplat()


def test_none_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(Tg4mmError, match=r'\A[^\n]*device cuda needs gsplat: pip install "tg4mm\[cuda\]"'):
        require_gsplat()


@needs_cuda
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_pictures_and_gradients_on_cuda_are_the_twins(seed, degree):
    check(make_scene(seed, cameras=2), sh_degree=degree, tolerance=1e-3, margin=1e-3, device="cuda")


@needs_cuda
def test_channels_and_backgrounds_on_cuda_are_the_twins():
    fill = uniform(torch.Generator().manual_seed(1), 2, 5)
    scene = with_channels(make_scene(0, cameras=2), 5)
    check(scene, None, fill, tolerance=2e-3, margin=1e-3, device="cuda")
