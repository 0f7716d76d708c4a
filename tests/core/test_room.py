"""Arrays beyond memory: contents stay, and what was let go of is no longer held."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tg4mm.core.memory import mapped_zeros, release

HOLD = """
import numpy as np
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.core.memory import release, mapped_zeros
array = mapped_zeros((50, 2 << 20), np.float32, in_memory={limit})  # 400 MiB
before = peak_memory_mib()
for k, row in enumerate(array):
    row[:] = k
    release(row)
total = 0.0
for row in array:
    total += float(row[::4096].mean())
    release(array)
print(total, peak_memory_mib() - before)
"""


def printed(limit: int) -> tuple[float, float]:
    code = HOLD.format(limit=limit)
    words = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    total, grown = (float(word) for word in words.split())
    return total, grown


def test_a_file_holds_what_memory_lets_go_of() -> None:
    total, grown = printed(1 << 20)
    assert total == sum(range(50))
    assert grown < 60
    _, in_memory = printed(1 << 30)
    assert in_memory > 300  # what is measured is what is held


@pytest.mark.parametrize("in_memory", [0, 1 << 20])
def test_contents_stay_as_they_were_written(in_memory: int, tmp_path: Path) -> None:
    array = mapped_zeros((3, 5), np.uint16, tmp_path, in_memory)
    assert not array.any()
    array[1] = 7
    release(array[1])
    assert array.tolist() == [[0] * 5, [7] * 5, [0] * 5]
    assert not list(tmp_path.iterdir())  # the file has no name
