"""gsplat: what must be there, that its constants and signatures are those we rely on, and its pictures."""

import inspect
import re
import sys
import types
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.utils.cpp_extension as cpp_extension

from tests.fit.rasterize.oracle import check, make_scene, uniform, with_channels
from tests.helpers.cuda import needs_cuda
from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.rasterize.cuda import require_gsplat
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, ALPHA_MIN, T_MIN

WITHOUT = 'gsplat is not installed (pip install ".[cuda]")'


def harmonics_of_1_5(degrees_to_use: Any, dirs: Any, coeffs: Any) -> None: ...


def harmonics_of_1_6(degrees_to_use: Any, means: Any, viewmats: Any, coeffs: Any) -> None: ...


def fake(
    monkeypatch: pytest.MonkeyPatch,
    projection: Any,
    backend: types.ModuleType,
    harmonics: Any = harmonics_of_1_5,
) -> None:
    """A gsplat of which the check sees no more than this."""
    package, cuda = types.ModuleType("gsplat"), types.ModuleType("gsplat.cuda")
    package.__version__ = "1.2.3"  # type: ignore[attr-defined]
    package.fully_fused_projection = projection  # type: ignore[attr-defined]
    package.spherical_harmonics = harmonics  # type: ignore[attr-defined]
    package.__path__, cuda.__path__ = [], []
    modules = {"gsplat": package, "gsplat.cuda": cuda, "gsplat.cuda._backend": backend}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)


def backend(kernels: object) -> types.ModuleType:
    module = types.ModuleType("gsplat.cuda._backend")
    module._C = kernels  # type: ignore[attr-defined]
    return module


def new(means: Any, opacities: Any) -> None: ...


def old(means: Any) -> None: ...


def broken(*errors: Exception) -> types.ModuleType:
    """Kernels that do not load: the first error, while it is handled the next."""

    class Broken(types.ModuleType):
        def __getattr__(self, name: str) -> object:
            try:
                raise errors[0]
            except type(errors[0]):
                raise errors[-1]  # noqa: B904

    return Broken("gsplat.cuda._backend")


BUILD = RuntimeError("Ninja is required to load C++ extensions\nand then two hundred lines")
TWO = OSError("CUDA_HOME environment variable is not set."), ImportError("no gsplat_cuda.so")
REFUSED = {
    "too old": ((old, backend(object())), "gsplat 1.2.3 is too old"),
    "other pictures": ((new, backend(object()), harmonics_of_1_6), "gsplat 1.2.3 is too new"),
    "no kernels": ((new, backend(None)), "gsplat is installed without CUDA kernels and finds no nvcc"),
    "no build": ((new, broken(BUILD)), "gsplat's CUDA kernels do not load: Ninja is required"),
    "two failures": ((new, broken(*TWO)), "gsplat's CUDA kernels do not load: CUDA_HOME environment variable"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_one_that_will_not_do_is_refused_in_one_line(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parts, match = REFUSED[kind]
    fake(monkeypatch, *parts)
    with pytest.raises(Tg4mmError, match=rf"\A[^\n]*{match}[^\n]*\Z"):
        require_gsplat()


def test_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(Tg4mmError, match=r'\A[^\n]*device cuda needs gsplat: pip install "\.\[cuda\]"'):
        require_gsplat()


def test_the_installed_one_takes_opacities_in_its_projection() -> None:
    """With them an ellipse ends where its alpha falls to 1/255, as ours; without, at three standard deviations."""
    gsplat = pytest.importorskip("gsplat", reason=WITHOUT)
    assert "opacities" in inspect.signature(gsplat.fully_fused_projection).parameters


def test_the_installed_ones_harmonics_take_our_arguments() -> None:
    gsplat = pytest.importorskip("gsplat", reason=WITHOUT)
    names = list(inspect.signature(gsplat.spherical_harmonics).parameters)
    assert names[:3] == ["degrees_to_use", "dirs", "coeffs"]


def test_its_thresholds_are_ours() -> None:
    """Read in its source: they are compiled in."""
    gsplat = pytest.importorskip("gsplat", reason=WITHOUT)
    root = Path(gsplat.__file__).parent / "cuda"
    if not (root / "csrc").is_dir():
        pytest.skip("this gsplat is a binary wheel without its source")
    common = (root / "include" / "Common.h").read_text()
    assert re.search(r"#define ALPHA_THRESHOLD \(1\.f / 255\.f\)", common)
    assert ALPHA_MIN == 1 / 255
    forward = (root / "csrc" / "RasterizeToPixels3DGSFwd.cu").read_text()
    assert re.findall(r"min\(([\d.]+)f, opac", forward) == [str(ALPHA_MAX)]
    assert [float(t) for t in re.findall(r"next_T <= ([\de.-]+)f", forward)] == [T_MIN]
    projection = (root / "csrc" / "ProjectionEWA3DGSFused.cu").read_text()
    assert "sqrt(2.0f * __logf(opacity / ALPHA_THRESHOLD))" in projection


def test_its_way_to_compile_is_known_to_this_torch() -> None:
    """gsplat calls torch's private `_jit_compile` with one of two argument lists; the second since torch 2.7."""
    pytest.importorskip("gsplat", reason=WITHOUT)
    signature = inspect.signature(cpp_extension._jit_compile)
    keywords = {
        "with_cuda": None,
        "is_python_module": True,
        "is_standalone": False,
        "keep_intermediates": True,
    }
    lists: list[tuple[list[object], dict[str, object]]] = [
        ([None] * 8, keywords), ([None] * 9, keywords | {"with_sycl": None})
    ]  # fmt: skip

    def fits(arguments: tuple[list[object], dict[str, object]]) -> bool:
        try:
            signature.bind(*arguments[0], **arguments[1])
        except TypeError:
            return False
        return True

    assert any(fits(a) for a in lists)


@needs_cuda
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_pictures_and_gradients_on_cuda_are_the_twins(seed: int, degree: int) -> None:
    check(make_scene(seed, cameras=2), sh_degree=degree, tolerance=1e-3, margin=1e-3, device="cuda")


@needs_cuda
@pytest.mark.parametrize("mode", ["RGB", "D", "ED", "RGB+D", "RGB+ED"])
def test_render_modes_and_backgrounds_on_cuda_are_the_twins(mode: str) -> None:
    fill = uniform(torch.Generator().manual_seed(1), 2, 5)
    scene = with_channels(make_scene(0, cameras=2), 5)
    backgrounds = fill if "RGB" in mode else None
    check(scene, None, backgrounds, mode, tolerance=2e-3, margin=1e-3, device="cuda")
