"""The cache of compiled kernels: used by the next process, dropped when a file of kernels or simd changes."""

import os
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


def outcome(folder):
    """What the kernel says in a fresh process, how often it came from the cache, and how many lines were logged."""
    path = f"{folder}{os.pathsep}{Path(__file__).resolve().parents[3]}"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=environment,
        cwd=folder,
        check=True,
        capture_output=True,
        text=True,
    )
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
        "@kernel()\ndef answer(x):\n    return x[0] + ANSWER\n"
    )
    assert outcome(tmp_path) == (41, 0, 1)
    assert outcome(tmp_path) == (41, 2, 0)
    constants.write_text("ANSWER = 42\n")
    assert outcome(tmp_path) == (42, 0, 1)
