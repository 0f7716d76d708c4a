"""What may be imported without what: the core without Blender, what Blender reads without torch."""

import ast
import subprocess
import sys

import pytest

BLOCKED = "import sys\nfor name in {blocked!r}: sys.modules[name] = None\n"
FLOORS = ("core", "capture", "fit", "run", "show", "research", "cli")  # each may import those before it
MAY_IMPORT = {room: {*FLOORS[:floor]} for floor, room in enumerate(FLOORS)}
_ADDON = ("compat", "names", "units", "nodes", "preferences", "declare", "panels", "io", "probe")

# `__init__` gives names to users or registers, `__main__` is a door; make_extension runs outside of Blender
DOORS = {"tg4mm/__init__.py", "tg4mm/__main__.py", "addon/__init__.py", "addon/make_extension.py"}


def run_without(blocked, code, root):
    """Run code in a fresh Python in which importing any of `blocked` raises ImportError."""
    program = BLOCKED.format(blocked=blocked) + code
    return subprocess.run([sys.executable, "-c", program], cwd=root, capture_output=True, text=True)


def modules(root, package):
    """The dotted names of all modules of a package, `__main__` apart."""
    files = sorted((root / package).rglob("*.py"))
    names = [".".join(f.relative_to(root).with_suffix("").parts) for f in files if f.name != "__main__.py"]
    return [name.removesuffix(".__init__") for name in names]


def test_every_module_of_the_core_imports_without_blender_and_every_benchmark_with_it(repo_root):
    core, benchmarks = modules(repo_root, "tg4mm"), modules(repo_root, "benchmarks")
    assert {"tg4mm", "tg4mm.run.folder", "tg4mm.cli.program"} <= set(core)
    assert {"benchmarks.ablations", "benchmarks.fox_phone", "benchmarks.rasterize"} <= set(benchmarks)
    blender = ["bpy", "mathutils", "bmesh"]
    code = f"import importlib\nfor name in {core!r}: importlib.import_module(name)\n"
    code += f"for name in {blender!r}: del sys.modules[name]\n"
    code += f"for name in {benchmarks!r}: importlib.import_module(name)\n"
    done = run_without(blender, code, repo_root)
    assert done.returncode == 0, done.stderr


def test_a_datasets_report_needs_neither_torch_nor_blender(repo_root):
    lacking = ["torch", "bpy", "numba", "flip_evaluator"]
    done = run_without(lacking, "import dataset_gen.report.page", repo_root)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["tg4mm", "tg4mm.capture", "tg4mm.cli", "tg4mm.core.splatfile"])
def test_what_needs_no_torch_imports_without_it(repo_root, name):
    done = run_without(["torch", "bpy", "numba", "scipy"], f"import {name}", repo_root)
    assert done.returncode == 0, done.stderr


MAY_IMPORT |= {room: {*MAY_IMPORT[room], "dataset_gen"} for room in ("research", "cli")}
MAY_IMPORT |= {"dataset_gen": {"core", "capture"}}
ADDON_MAY_IMPORT = {room: {*_ADDON[:floor], "core"} for floor, room in enumerate(_ADDON)}
ADDON_MAY_IMPORT |= {"jobs": {*_ADDON[: _ADDON.index("probe")], "core", "dataset_gen"}}


def room_of(module):
    """The room a dotted name lies in: `core` of `tg4mm.core.files`, `dataset_gen` of all that is in it."""
    top, *rest = module.split(".")
    return rest[0] if top in ("tg4mm", "addon") and rest else top


def imported(name, source):
    """(line, room) of every import from our packages in a file, those inside functions and of types, too."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(name.split("/")[: -node.level]) if node.level else ""
            whole = ".".join(part for part in (base, node.module) if part)
            modules = [f"{whole}.{a.name}" for a in node.names] if whole in ("tg4mm", "addon") else [whole]
        else:
            continue
        ours = [m for m in modules if m.split(".")[0] in ("tg4mm", "addon", "dataset_gen")]
        found += [(node.lineno, room_of(m)) for m in ours]
    return found


def climbs(name, source):
    """The imports of a file that its floor does not allow."""
    own = room_of(name.removesuffix(".py").replace("/", "."))
    allowed = (ADDON_MAY_IMPORT if name.startswith("addon/") else MAY_IMPORT)[own] | {own}
    return [
        f"{name}:{line}: {own} imports {room}" for line, room in imported(name, source) if room not in allowed
    ]


def test_every_import_goes_down_a_floor(repo_root):
    """docs/architecture.md; imports inside functions count."""
    files = sorted(f for top in ("tg4mm", "dataset_gen", "addon") for f in (repo_root / top).rglob("*.py"))
    names = {f.relative_to(repo_root).as_posix(): f for f in files}
    assert set(names) > DOORS
    assert [c for n, f in names.items() if n not in DOORS for c in climbs(n, f.read_text("utf-8"))] == []


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("tg4mm/run/train.py", "def f():\n    from tg4mm.research.paper import PAPER"),
        ("tg4mm/core/files.py", "import tg4mm.capture.model"),
        ("tg4mm/fit/device.py", "from tg4mm import show"),
        ("tg4mm/show/maps.py", "import dataset_gen"),
        ("dataset_gen/run.py", "from tg4mm.fit.gaussians import Gaussians"),
        ("dataset_gen/farm/jobs.py", "from ...tg4mm.run import Run"),
        ("addon/nodes/points.py", "from ..panels import panel"),
        ("addon/io/loading.py", "from .. import probe"),
    ],
)
def test_an_import_that_goes_up_is_found(name, source):
    assert len(climbs(name, source)) == 1


def graph(root, packages):
    """{module: the modules that it imports} of packages; imports inside functions and for types count."""
    names = {name for package in packages for name in modules(root, package)}
    found = {}
    for name in names:
        path = root.joinpath(*name.split("."))
        file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        package = name if path.is_dir() else name.rpartition(".")[0]
        found[name] = set()
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                found[name] |= {alias.name for alias in node.names} & names
            elif isinstance(node, ast.ImportFrom):
                up = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
                base = ".".join([*up, *filter(None, [node.module])])
                found[name] |= {
                    f"{base}.{a.name}" if f"{base}.{a.name}" in names else base for a in node.names
                } & names
    return found


def circles(imports):
    """Modules that import one another, or themselves, in any number of steps."""
    left = {name: set(others) for name, others in imports.items()}
    while ends := [name for name, others in left.items() if not others & left.keys()]:
        for name in ends:
            del left[name]
    while heads := [name for name in left if not any(name in others for others in left.values())]:
        for name in heads:
            del left[name]
    return sorted(left)


@pytest.mark.parametrize("package", ["tg4mm", "dataset_gen", "benchmarks"])
def test_no_modules_import_one_another(repo_root, package):
    assert circles(graph(repo_root, [package])) == []


def test_a_circle_of_imports_is_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"c"}, "e": set()}) == ["b", "c"]
    assert circles({"a": {"a"}}) == ["a"]
    assert circles({"a": {"b"}, "b": set()}) == []
