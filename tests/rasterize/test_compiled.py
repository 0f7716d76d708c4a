"""The cache of compiled kernels: used by the next process, dropped when a neighbour's file changes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tg4mm.rasterize import kernels

SCRIPT = """
import logging
import numpy as np
from small.use import ask
logging.basicConfig(level=logging.INFO, format="%(message)s")
ask(np.zeros(1, np.float32))
print(int(ask(np.zeros(1))), sum(ask.stats.cache_hits.values()))
"""


def answer(folder: Path) -> tuple[int, int, int]:
    """What the kernel says in a fresh process, how often it came from the cache, and how many lines were logged."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(folder)}
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


def test_a_change_in_a_neighbours_file_is_noticed(tmp_path: Path) -> None:
    """And that kernels are compiled, two here, is said in one line, or not at all."""
    package = tmp_path / "small"
    package.mkdir()
    shutil.copy(Path(kernels.__file__).parent / "compiled.py", package)
    (package / "constants.py").write_text("ANSWER = 41\n")
    (package / "use.py").write_text(
        "from small.compiled import kernel\nfrom small.constants import ANSWER\n\n\n"
        "@kernel()\ndef ask(x):\n    return x[0] + ANSWER\n"
    )
    assert answer(tmp_path) == (41, 0, 1)
    assert answer(tmp_path) == (41, 2, 0)
    (package / "constants.py").write_text("ANSWER = 42\n")
    assert answer(tmp_path) == (42, 0, 1)
