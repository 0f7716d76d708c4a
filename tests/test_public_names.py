"""What `import tg4mm` gives: the names, when they are imported, and that the documentation lists them."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import tg4mm

NAMES = re.findall(
    r"\w+",
    """
    BandGain Camera Capture CaptureError Gaussians ImageStack Magnification Measurement ModalMotion
    MotionConfig MotionFit Prepared Run RunError Sensor SensorResult SpaceConfig SplatFile SplatFileError
    Tg4mmError animate capture_cameras fit_motion fit_space load_capture load_images measure orbit
    parse_sensor prepare prepare_fit rasterization read_splat render to_splat write_splat
    """,
)


def python(code, *arguments):
    root = Path(tg4mm.__file__).parent.parent
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=root)


def test_the_public_names():
    assert tg4mm.__all__ == NAMES
    assert set(NAMES) <= set(dir(tg4mm))


@pytest.mark.parametrize("name", NAMES)
def test_each_is_there_and_says_what_it_is(name):
    value = getattr(tg4mm, name)
    assert inspect.getdoc(value)
    # a dataclass without a docstring would be given its signature
    assert not inspect.getdoc(value).startswith(f"{name}(")


def test_type_checkers_see_the_same_names_in_the_same_modules():
    """A package that was written `from tg4mm.x import y as y` for them, and `"y": "x"` for Python."""
    tree = ast.parse(Path(tg4mm.__file__).read_text(encoding="utf-8"))
    (block,) = (n for n in tree.body if isinstance(n, ast.If))
    seen = {}
    for line in block.body:
        assert isinstance(line, ast.ImportFrom)
        for alias in line.names:
            assert alias.asname == alias.name
            seen[alias.name] = str(line.module).removeprefix("tg4mm.")
    assert seen == tg4mm._PUBLIC
    assert (Path(tg4mm.__file__).parent / "py.typed").is_file()


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys; before = set(sys.modules); import tg4mm; print(len(tg4mm.__all__), *set(sys.modules) - before)"
    done = python(code)
    assert done.returncode == 0, done.stderr
    new = set(done.stdout.split()[1:])
    assert {name.partition(".")[0] for name in new} <= {"tg4mm", *sys.stdlib_module_names}
    assert len(new) < 40


def test_without_torch_there_is_still_what_needs_none():
    """As in Blender's Python."""
    code = (
        "import sys\nfor name in ('torch', 'numba', 'scipy', 'bpy'): sys.modules[name] = None\n"
        "import tg4mm\nprint(tg4mm.read_splat.__name__, tg4mm.load_capture.__name__, tg4mm.Tg4mmError.__name__)\n"
        "tg4mm.fit_space"
    )
    done = python(code)
    assert done.stdout.split() == ["read_splat", "load_capture", "Tg4mmError"]
    assert "ModuleNotFoundError: import of torch halted" in done.stderr


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'tg4mm' has no attribute 'fit_sapce'"):
        tg4mm.fit_sapce  # noqa: B018
    assert tg4mm.render is importlib.import_module("tg4mm.show.render.image").render
