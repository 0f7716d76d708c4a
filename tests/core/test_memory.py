"""Peak memory follows what the process holds; mapped arrays keep their contents and hold no memory once let go."""

import subprocess
import sys

import numpy as np
import pytest

from tg4mm.core.memory import mapped_zeros, release

HOLD = """
before = peak_memory_mib()
block = np.ones(100 << 20, dtype=np.uint8)
held = peak_memory_mib()
del block
print(before, held, peak_memory_mib() if reset_peak_memory() else -1)
"""
MAPPED = """
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


def printed(code):
    """In a process of its own: one that has run other tests may take a block from memory it holds already."""
    names = "peak_memory_mib, mapped_zeros, release, reset_peak_memory"
    start = f"import numpy as np\nfrom tg4mm.core.memory import {names}\nreset_peak_memory()\n"
    done = subprocess.run([sys.executable, "-c", start + code], check=True, capture_output=True, text=True)
    return [float(word) for word in done.stdout.split()]


def test_peak_grows_by_what_was_held_and_falls_at_a_reset():
    before, held, after = printed(HOLD)
    assert 90 <= held - before <= 120
    if after < 0:
        pytest.skip("this system cannot reset the peak")
    assert after < held - 80


def test_child_of_a_large_process_does_not_report_its_parents_peak():
    block = np.ones(300 << 20, dtype=np.uint8)
    code = "from tg4mm.core.memory import peak_memory_mib; print(peak_memory_mib())"  # and no reset
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert float(done) < 100
    del block


def test_a_file_holds_what_memory_lets_go_of():
    total, grown = printed(MAPPED.format(limit=1 << 20))
    assert total == sum(range(50))
    assert grown < 60
    _, in_memory = printed(MAPPED.format(limit=1 << 30))
    assert in_memory > 300  # what is measured is what is held


@pytest.mark.parametrize("in_memory", [0, 1 << 20])
def test_contents_stay_as_they_were_written(in_memory, tmp_path):
    array = mapped_zeros((3, 5), np.uint16, tmp_path, in_memory)
    assert not array.any()
    array[1] = 7
    release(array[1])
    assert array.tolist() == [[0] * 5, [7] * 5, [0] * 5]
    assert not list(tmp_path.iterdir())  # the file has no name
