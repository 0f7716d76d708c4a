"""The splat file needs numpy alone, so that the add-on can carry it."""

import subprocess
import sys

from tg4mm.core.splatfile import write_splat

BLOCKED = ("torch", "bpy", "plyfile", "PIL", "scipy", "numba", "rich", "typer")
READ = """
import sys
for name in {blocked!r}:
    sys.modules[name] = None
from {package} import {module}
splat = {module}.read_splat(sys.argv[1])
{module}.write_splat(sys.argv[1] + ".copy", splat)
third = {{m.partition(".")[0] for m in sys.modules}} - set(sys.stdlib_module_names)
print(len(splat), sorted(m for m in third if sys.modules[m] and not m.startswith(("_", "cython"))))
"""


def run(code, *arguments, **options):
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, **options)


def test_tg4mm_and_the_splat_file_work_with_numpy_alone(make, tmp_path):
    write_splat(tmp_path / "a.ply", make.splat())
    done = run(
        READ.format(blocked=BLOCKED, package="tg4mm.core", module="splatfile"), str(tmp_path / "a.ply")
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "5 ['numpy', 'tg4mm']"
    assert (tmp_path / "a.ply.copy").exists()


def test_the_block_itself_works(tmp_path):
    code = "import sys; sys.modules['numpy'] = None; import tg4mm.core.splatfile"
    assert run(code).returncode != 0
