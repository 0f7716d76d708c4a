"""The splat file needs numpy alone, so that the add-on can carry it."""

import subprocess
import sys

from tests.core.splatfile.conftest import random_splat
from tg4mm.core.splatfile import write_splat

COPY = """
import sys
for name in ("torch", "bpy", "plyfile", "PIL", "scipy", "numba", "rich", "cyclopts"):
    sys.modules[name] = None
from tg4mm.core import splatfile
splat = splatfile.read_splat(sys.argv[1])
splatfile.write_splat(sys.argv[1] + ".copy", splat)
third = {m.partition(".")[0] for m in sys.modules} - set(sys.stdlib_module_names)
print(len(splat), sorted(m for m in third if sys.modules[m] and not m.startswith(("_", "cython"))))
"""


def test_tg4mm_and_the_splat_file_work_with_numpy_alone(tmp_path):
    write_splat(tmp_path / "a.ply", random_splat())
    command = [sys.executable, "-c", COPY, str(tmp_path / "a.ply")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "5 ['numpy', 'tg4mm']"
    assert (tmp_path / "a.ply.copy").exists()
