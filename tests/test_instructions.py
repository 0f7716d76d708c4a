"""`make test-avx2` holds every library that computes to AVX2: what rounds otherwise would not be tested."""

import importlib
import os

import numpy as np
import pytest

threadpoolctl = pytest.importorskip("threadpoolctl")
numba, torch = pytest.importorskip("numba"), pytest.importorskip("torch")
pytestmark = pytest.mark.skipif(
    os.environ.get("ATEN_CPU_CAPABILITY") != "avx2", reason="runs in make test-avx2"
)


def test_numpy_is_held_to_avx2():
    package = "numpy.core" if np.__version__ < "2" else "numpy._core"
    umath = importlib.import_module(f"{package}._multiarray_umath")
    used = [name for name in umath.__cpu_dispatch__ if umath.__cpu_features__[name]]
    assert "AVX2" in used or "X86_V3" in used
    assert not [name for name in used if name.startswith("AVX512") or name == "X86_V4"]


def test_blas_is_held_to_avx2():
    import scipy.linalg  # noqa: F401  has an OpenBLAS of its own

    found = [x["architecture"] for x in threadpoolctl.threadpool_info() if x["internal_api"] == "openblas"]
    assert len(found) == 2
    assert set(found) == {"Haswell"}


def test_torch_is_held_to_avx2():
    assert torch.backends.cpu.get_cpu_capability() == "AVX2"


def test_numba_is_held_to_avx2():
    @numba.njit("f4(f4[::1])", fastmath=True)
    def total(values):
        out = np.float32(0)
        for value in values:
            out += value
        return out

    code = "".join(total.inspect_asm().values())
    assert "ymm" in code
    assert "zmm" not in code
