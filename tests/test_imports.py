"""What may be imported without what: the core without Blender, what Blender reads without torch."""

from __future__ import annotations

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

BLOCKED = "import sys\nfor name in {blocked!r}: sys.modules[name] = None\n"


def run_without(blocked: list[str], code: str, root: Path) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh Python in which importing any of `blocked` raises ImportError."""
    program = BLOCKED.format(blocked=blocked) + code
    return subprocess.run([sys.executable, "-c", program], cwd=root, capture_output=True, text=True)


def modules(root: Path, package: str) -> list[str]:
    """The dotted names of all modules of a package, `__main__` apart."""
    files = sorted((root / package).rglob("*.py"))
    names = [".".join(f.relative_to(root).with_suffix("").parts) for f in files if f.name != "__main__.py"]
    return [name.removesuffix(".__init__") for name in names]


def test_a_blocked_module_fails_the_check(repo_root: Path) -> None:
    done = run_without(["json"], "import tg4mm.core.files", repo_root)
    assert done.returncode == 1
    assert "import of json halted" in done.stderr


def test_every_module_of_the_core_imports_without_blender(repo_root: Path) -> None:
    names = modules(repo_root, "tg4mm")
    assert {"tg4mm", "tg4mm.run.folder", "tg4mm.cli.program"} <= set(names)
    code = f"import importlib\nfor name in {names!r}: importlib.import_module(name)\n"
    done = run_without(["bpy", "mathutils", "bmesh"], code, repo_root)
    assert done.returncode == 0, done.stderr


def test_every_benchmark_imports(repo_root: Path) -> None:
    names = modules(repo_root, "benchmarks")
    assert {"benchmarks.captures", "benchmarks.fox_phone_measure", "benchmarks.speckle"} <= set(names)
    code = f"import importlib\nfor name in {names!r}: importlib.import_module(name)\n"
    done = run_without([], code, repo_root)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["dataset_gen.report.write", "dataset_gen.report.overview"])
def test_a_datasets_report_needs_neither_torch_nor_blender(repo_root: Path, name: str) -> None:
    done = run_without(["torch", "bpy", "numba", "flip_evaluator"], f"import {name}", repo_root)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["tg4mm", "tg4mm.capture", "tg4mm.cli", "tg4mm.core.splatfile"])
def test_what_needs_no_torch_imports_without_it(repo_root: Path, name: str) -> None:
    done = run_without(["torch", "bpy", "numba", "scipy"], f"import {name}", repo_root)
    assert done.returncode == 0, done.stderr


def test_splat_file_reader_needs_numpy_alone(repo_root: Path) -> None:
    code = (
        "before = set(sys.modules)\n"
        "import tg4mm.core.splatfile\n"
        "new = {n.partition('.')[0] for n in set(sys.modules) - before}\n"
        "foreign = new - set(sys.stdlib_module_names) - {'tg4mm', 'numpy'}\n"
        "assert not {n for n in foreign if 'cython' not in n}, foreign\n"  # numpy's own
    )
    done = run_without(["torch", "bpy", "plyfile", "PIL"], code, repo_root)
    assert done.returncode == 0, done.stderr


def test_packages_of_the_core_import_each_other_one_way(repo_root: Path) -> None:
    """Imports inside functions count, too. `tg4mm/__init__.py`, which gives names to users, does not."""
    graph: dict[str, set[str]] = {}
    for file in sorted((repo_root / "tg4mm").rglob("*.py")):
        own, *_ = file.relative_to(repo_root / "tg4mm").with_suffix("").parts
        if own == "__init__":
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tg4mm"):
                names = [f"tg4mm.{a.name}" for a in node.names] if node.module == "tg4mm" else [node.module]
                graph.setdefault(own, set()).update(str(name).split(".")[1] for name in names)
    assert "motion" in graph["stages"]
    order = list(graphlib.TopologicalSorter({k: v - {k} for k, v in graph.items()}).static_order())
    assert order.index("rasterize") < order.index("space")
