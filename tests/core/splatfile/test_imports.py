"""The splat file needs numpy alone, so that the add-on can carry it, also under another package name."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import tg4mm
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


def test_a_copy_inside_another_package_works(make, tmp_path):
    """Inside Blender the package is bl_ext.<repository>.tg4mm: nothing may import `tg4mm` by that name."""
    source = Path(tg4mm.__file__).parent / "core"
    target = tmp_path / "extension" / "core"
    shutil.copytree(source / "splatfile", target / "splatfile", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("errors.py", "temporary.py", "untrusted.py", "values.py"):
        shutil.copy(source / name, target / name)
    (tmp_path / "extension" / "__init__.py").touch()
    (target / "__init__.py").touch()
    write_splat(tmp_path / "a.ply", make.splat())
    code = READ.format(blocked=(*BLOCKED, "tg4mm"), package="extension.core", module="splatfile")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = run(code, str(tmp_path / "a.ply"), cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("5 [")
