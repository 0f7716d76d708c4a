"""Files of unknown origin are read by a few modules, which check them: no other module reads a format by itself.

The harness feeds these modules damaged files. A new reader of files belongs behind one of them, or into ALLOWED with
its reason and into `readers.py`.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

# Packages that are imported for reading, and functions of packages that have other uses, too.
MODULES = {
    *("pickle", "marshal", "shelve", "dill", "joblib", "sqlite3", "tarfile", "zipfile", "gzip", "bz2", "lzma"),
    *("tomllib", "configparser", "xml", "csv", "yaml", "safetensors", "plyfile", "OpenEXR", "av", "cv2"),
    *("imageio", "h5py"),
}  # fmt: skip
CALLS = {
    *("json.load", "json.loads", "torch.load", "PIL.Image.open", "skimage.io.imread", "scipy.io.loadmat"),
    *(f"numpy.{name}" for name in ("load", "fromfile", "memmap", "loadtxt", "genfromtxt", "fromregex")),
    *("eval", "exec", "matplotlib.image.imread", "matplotlib.pyplot.imread"),
}
COLMAP = {"Reconstruction"}  # of pycolmap, which a function gives; with a folder it reads that
ALLOWED = {
    # Checked readers, each in the mutation harness.
    "tg4mm/core/untrusted.py": "JSON, YAML, .npz",
    "tg4mm/core/pictures/decode.py": "PNG and JPEG by Pillow, after the header was checked",
    "tg4mm/core/pictures/exr.py": "EXR",
    "tg4mm/capture/points.py": "PLY",
    "tg4mm/capture/sfm/staging.py": "EXIF of a photograph that decode.py has checked",
    "tg4mm/capture/video.py": "videos",
    "tg4mm/core/splatfile/header.py": "PLY, as long as its header says",
    "tg4mm/core/splatfile/read.py": ".splat, as long as its records are",
    "tg4mm/core/splatfile/sog.py": "SOG: lossless WebP by Pillow, after the header was checked",
    "tg4mm/research/evaluate/lpips.py": "weights",
    "tg4mm/show/analyse/channel.py": "CSV, each value and the times checked",
    "tg4mm/run/tensor_file.py": "a run's tensors",
    "tg4mm/run/folder.py": "one row of a run's tensor that was checked",
    "tg4mm/capture/sfm/mapping.py": "COLMAP's model in its working folder",
    "tg4mm/research/paper/preset.py": "its own cache, by checksums",
    "dataset_gen/sources/bodies_file.py": "the end of a packed .blend file",
    "dataset_gen/sources/mesh_file.py": "PLY, as long as its header says",
    # What this program has just written itself, or another of its own processes says.
    "tg4mm/core/memory.py": "temporary arrays without a name",
    "tg4mm/capture/sfm/config.py": "a request, as JSON would give it back",
    "tg4mm/core/steps.py": "a request, as JSON would give it back",
    "tg4mm/core/work_folder.py": "a request, as JSON would give it back",
    "dataset_gen/worker.py": "the task given to a render process",
    "dataset_gen/render.py": "what Blender rendered a moment ago",
    "dataset_gen/pictures.py": "a JPEG made in memory",
    "dataset_gen/effects/codec.py": "a video made a moment ago",
    "addon/jobs/runner.py": "lines of the generator's standard error",
    "addon/jobs/core_check.py": "a line of another Python",
    "addon/make_extension.py": "this repository's own files",
    # Writers alone.
    "dataset_gen/exr.py": "writes EXR",
    "dataset_gen/truth.py": "writes EXR",
    "tg4mm/show/measure/tables.py": "writes CSV",
    "tg4mm/show/analyse/write.py": "writes CSV",
    "tg4mm/show/measure/arrays.py": "writes HDF5",
    "tg4mm/core/splatfile/spz.py": "writes gzip",
}  # fmt: skip


def raw_readers(source: str) -> set[str]:
    """What a module imports or calls of MODULES and CALLS, by its full name."""
    tree = ast.parse(source)
    names = dict(_imported(tree))
    found = {name for name in names.values() if name.partition(".")[0] in MODULES or name in CALLS}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = _dotted(node.func, names)
        if name in CALLS or (node.args and name.rpartition(".")[2] in COLMAP):
            found.add(name)
    return found


def _imported(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """(name in the module, full name)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                full = alias.name if alias.asname else alias.name.partition(".")[0]
                yield alias.asname or full, full
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            for alias in node.names:
                yield alias.asname or alias.name, f"{node.module}.{alias.name}"


def _dotted(node: ast.AST, names: dict[str, str]) -> str:
    if isinstance(node, ast.Name):
        return names.get(node.id, node.id)
    if isinstance(node, ast.Attribute):
        return f"{_dotted(node.value, names)}.{node.attr}"
    return ""


def test_only_checked_readers_read_files(repo_root: Path) -> None:
    files = [
        f
        for package in ("tg4mm", "dataset_gen", "addon")
        for f in sorted((repo_root / package).rglob("*.py"))
    ]
    found = {f.relative_to(repo_root).as_posix(): raw_readers(f.read_text(encoding="utf-8")) for f in files}
    raw = {name: sorted(what) for name, what in found.items() if what}
    assert {name: what for name, what in raw.items() if name not in ALLOWED} == {}
    assert sorted(set(ALLOWED) - set(raw)) == [], "these read nothing by themselves any more"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from json import load as get", "json.load"),
        ("import numpy as np\nnp.load(path)", "numpy.load"),
        ("def f():\n    from PIL import Image\n    with Image.open(path) as image: pass", "PIL.Image.open"),
        ("import torch as t\nt.load(path)", "torch.load"),
        ("import yaml", "yaml"),
        ("from safetensors.torch import load_file", "safetensors.torch.load_file"),
        ("eval(text)", "eval"),
        ("colmap('x').Reconstruction(folder)", ".Reconstruction"),
    ],
)
def test_a_raw_reader_is_found(source: str, found: str) -> None:
    assert raw_readers(source) == {found}
