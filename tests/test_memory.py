"""Peak memory follows what the process holds."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from tg4mm.memory import peak_memory_mib, reset_peak_memory


def test_peak_grows_by_what_was_held_and_falls_at_a_reset() -> None:
    reset_peak_memory()
    before = peak_memory_mib()
    block = np.ones(100 << 20, dtype=np.uint8)
    held = peak_memory_mib()
    assert 90 <= held - before <= 120
    del block
    if not reset_peak_memory():
        pytest.skip("this system cannot reset the peak")
    assert peak_memory_mib() < held - 80


def test_child_of_a_large_process_does_not_report_its_parents_peak() -> None:
    block = np.ones(300 << 20, dtype=np.uint8)
    code = "from tg4mm.memory import peak_memory_mib; print(peak_memory_mib())"
    printed = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert float(printed) < 100
    del block
