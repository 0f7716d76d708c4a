"""Blender 4.5 and 5.2 make the same set. Runs where both environments are there: `make test-52` makes the second."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("bpy")
pytest.importorskip("OpenEXR")
Image = pytest.importorskip("PIL.Image")

from benchmarks.blender_lines import difference, make  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    other = ROOT / (".venv52" if sys.version_info < (3, 13) else ".venv") / "bin/python"
    if not other.exists():
        pytest.skip(f"no other Blender: {other} is absent (make install test-52)")
    out = tmp_path_factory.mktemp("lines")
    return (make(Path(sys.executable), "mic", out / "this", 48, 4), make(other, "mic", out / "other", 48, 4))


@pytest.mark.slow
def test_both_lines_make_the_same_pictures_and_truth(both):
    d = difference(*both)
    assert d.share < 0.02  # with 4 samples one light path that goes elsewhere is many grey levels
    assert d.mean < 0.02
    assert d.seen < 1e-3
    assert d.passes["Depth"] < 1e-4
    assert d.passes["Position"] < 1e-4
    assert d.passes["Displacement"] < 1e-6
