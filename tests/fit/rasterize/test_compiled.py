"""The cache of compiled kernels: used by the next process, dropped when a file of kernels or simd changes.

Processors without AVX-512: kernels made of what such a one has, compared with the twin, and cached apart.
"""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tg4mm.fit.rasterize import kernels

SCRIPT = """
import logging
import numpy as np
from small.kernels.use import answer
logging.basicConfig(level=logging.INFO, format="%(message)s")
answer(np.zeros(1, np.float32))
print(int(answer(np.zeros(1))), sum(answer.stats.cache_hits.values()))
"""
PROCESSORS_SCRIPT = """
import warnings
from tests.fit.rasterize.oracle import check, make_scene
from tg4mm.fit.rasterize.kernels import blend, blend_backward

check(make_scene(0, n=300, size=(50, 38)))
outer = (blend._forward.__wrapped__, blend_backward._backward.__wrapped__)
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # a kernel from the cache has no machine code to show
    code = [k.inspect_asm(k.signatures[0]) for k in outer]
hits = sum(sum(k.stats.cache_hits.values()) for k in outer)
print(sum("zmm" in c for c in code), sum("ymm" in c for c in code), hits)
"""
THREADS_SCRIPT = """
import os, sys
import numba, numpy as np
from tg4mm.fit.rasterize.kernels.compiled import on_each, shared
numba.set_num_threads(2)

@shared
def mark(worker, workers, out):
    for k in range(worker, len(out), workers):
        out[k] = worker + 1

def marked():
    out = np.zeros(5)
    mark(out)
    return out.tolist()

print(marked())
print(on_each(lambda k: (k, *marked()[:2]), "abc"), on_each(lambda k: marked()[:2], "a"))
sys.stdout.flush()
if hasattr(os, "fork"):
    child = os.fork()
    if child == 0:
        os._exit(marked() != [1, 2, 1, 2, 1])
    assert os.waitpid(child, 0)[1] == 0
try:
    mark("no array")
except numba.TypingError:
    print("refused")
"""


def outcome(folder):
    """What the kernel says in a fresh process, how often it came from the cache, and how many lines were logged."""
    path = f"{folder}{os.pathsep}{Path(__file__).resolve().parents[3]}"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": path}
    place = {"env": environment, "cwd": folder}
    done = subprocess.run([sys.executable, "-c", SCRIPT], **place, check=True, capture_output=True, text=True)
    value, hits = done.stdout.split()
    lines = done.stderr.splitlines()
    assert all(line.startswith("compiling kernels for this processor, once: ") for line in lines)
    return int(value), int(hits), len(lines)


@pytest.mark.parametrize("folder", ["kernels", "simd"])
def test_a_change_in_another_file_is_noticed(tmp_path, folder):
    """And that kernels are compiled, two here, is said in one line, or not at all."""
    package = tmp_path / "small"
    (package / "kernels").mkdir(parents=True)
    (package / "simd").mkdir()
    shutil.copy(Path(kernels.__file__).parent / "compiled.py", package / "kernels")
    constants = package / folder / "constants.py"
    constants.write_text("ANSWER = 41\n")
    (package / "kernels" / "use.py").write_text(
        f"from small.kernels.compiled import kernel\nfrom small.{folder}.constants import ANSWER\n\n\n"
        "@kernel\ndef answer(x):\n    return x[0] + ANSWER\n"
    )
    assert outcome(tmp_path) == (41, 0, 1)
    assert outcome(tmp_path) == (41, 2, 0)
    constants.write_text("ANSWER = 42\n")
    assert outcome(tmp_path) == (42, 0, 1)


def test_threads_share_a_kernel_also_in_a_forked_process_and_say_what_is_wrong(tmp_path):
    (tmp_path / "threads.py").write_text(THREADS_SCRIPT)
    root = Path(__file__).resolve().parents[3]
    environment = os.environ | {"NUMBA_NUM_THREADS": "2", "PYTHONPATH": str(root), "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "threads.py"]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    alone = [(item, 1.0, 1.0) for item in "abc"]  # each on one thread, in the order given
    said = ["[1.0, 2.0, 1.0, 2.0, 1.0]", f"{alone} [[1.0, 2.0]]", "refused"]
    assert done.stdout.splitlines() == said, done.stderr


def compared(cache, processor):
    """Checks against the twin in a fresh process. Of two kernels: with zmm registers, with ymm, from the cache."""
    root = Path(__file__).resolve().parents[3]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_CPU")} | processor
    environment |= {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(root)}
    command, place = [sys.executable, "-c", PROCESSORS_SCRIPT], {"env": environment, "cwd": root}
    done = subprocess.run(command, **place, capture_output=True, text=True)
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
