"""What must not be imported: no torch and no bpy by the capture readers."""

import subprocess
import sys

import pytest

READ = """
import sys
sys.modules["torch"] = sys.modules["bpy"] = None
import tg4mm
from tg4mm.capture import load_capture, load_images
print(load_images(load_capture(sys.argv[1])).rgb(0).shape)
"""


def test_captures_are_read_without_torch_and_bpy(folder):
    done = subprocess.run([sys.executable, "-c", READ, folder], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout.strip()) == (0, "(8, 12, 3)"), done.stderr


@pytest.mark.parametrize("module", ["torch", "bpy"])
def test_the_block_itself_works(module):
    code = f"import sys; sys.modules[{module!r}] = None; import {module}"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=120).returncode != 0
