"""Processors without AVX-512: kernels made of what such a one has, compared with the twin, and cached apart."""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import warnings
from tests.fit.rasterize.oracle import check, make_scene
from tg4mm.fit.rasterize.kernels import blend, blend_backward

check(make_scene(0, n=300, size=(50, 38)))
outer = (blend._forward, blend_backward._backward)
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # a kernel from the cache has no machine code to show
    code = [k.inspect_asm(k.signatures[0]) for k in outer]
hits = sum(sum(k.stats.cache_hits.values()) for k in outer)
print(sum("zmm" in c for c in code), sum("ymm" in c for c in code), hits)
"""


def compared(cache, processor):
    """Checks against the twin in a fresh process. Of two kernels: with zmm registers, with ymm, from the cache."""
    root = Path(__file__).resolve().parents[3]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_CPU")} | processor
    environment |= {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, cwd=root, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return [int(x) for x in done.stdout.split()]


@pytest.mark.slow
@pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64"),
    reason="needs a processor that runs AVX2's instructions",
)
def test_without_avx512_the_kernels_are_others_and_right(tmp_path):
    """Haswell (2013): AVX2 and FMA, sixteen registers of eight numbers."""
    haswell = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx2"}
    shutil.copytree(os.environ["NUMBA_CACHE_DIR"], tmp_path, dirs_exist_ok=True)
    compared(tmp_path, {})  # compiles for this machine what the tests before have not
    assert compared(tmp_path, {})[2] == 2
    assert compared(tmp_path, haswell) == [0, 2, 0]  # not this machine's kernels from the same folder
    assert compared(tmp_path, haswell)[2] == 2
