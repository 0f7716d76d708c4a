"""The sidebar, drawn on a stand-in for Blender's layout: what it offers for each kind of file."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from tests.addon.conftest import some_splat
from tg4mm.splatfile import SplatFile, read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install 'tg4mm[generate]'")

from tests.addon.playing import import_splat, setter  # noqa: E402


class Layout:
    """Records labels, operators and properties; reads every property, as drawing does."""

    def __init__(self) -> None:
        self.drawn: list[str] = []

    def label(self, text: str = "", **_: Any) -> None:
        self.drawn.append(text)

    def operator(self, name: str, **_: Any) -> None:
        assert getattr(getattr(bpy.ops, name.split(".")[0]), name.split(".")[1]).get_rna_type()
        self.drawn.append(name)

    def prop(self, owner: Any, path: str, text: str = "") -> None:
        owner.path_resolve(path)
        self.drawn.append(text)

    def column(self, **_: Any) -> Layout:
        return self


def drawn(extension: ModuleType, obj: Any) -> list[str]:
    """Everything the panels show for an object, in order."""
    layout, context = Layout(), SimpleNamespace(object=obj, scene=bpy.context.scene)
    for cls in extension.panel._CLASSES:
        if not hasattr(cls, "poll") or cls.poll(context):
            cls.draw(SimpleNamespace(layout=layout), context)
    return layout.drawn


def test_without_a_splat_it_offers_the_import(extension: ModuleType) -> None:
    shown = drawn(extension, None)
    assert shown == ["import_scene.tg4mm_splat", "Select an imported splat object"]


def test_moving_file_has_every_control(extension: ModuleType, splat_path: Path) -> None:
    obj = import_splat(splat_path)
    names, put = extension.names, setter(extension, obj)
    shown = drawn(extension, obj)
    wanted = (names.ALPHA, names.LOW, names.HIGH, names.FIRST, names.SPEED, "3 Hz", "7.5 Hz", names.DRAW)
    assert set(wanted) | {names.SIZE, names.RADIUS, names.MIN_OPACITY, names.VIEW_COLOUR} <= set(shown)
    assert "tg4mm.true_colours" in shown
    bpy.ops.tg4mm.true_colours()
    put(names.DRAW, names.ARROWS)
    put(names.COLOUR_BY, names.AMPLITUDE_COLOUR)
    put(names.COLOUR_RANGE, 0.25)
    shown = drawn(extension, obj)
    assert {names.ARROW_LENGTH, names.ARROW_EVERY, "0 to 0.25 scene units"} <= set(shown)
    assert not {"tg4mm.true_colours", names.RADIUS} & set(shown)


def test_legend_speaks_of_millimetres_where_the_scale_is_known(
    extension: ModuleType, tmp_path: Path, splat_path: Path
) -> None:
    known = SplatFile(**{**vars(read_splat(splat_path)), "unit_scale_m": 0.1})
    write_splat(tmp_path / "known.ply", known)
    obj = import_splat(tmp_path / "known.ply")
    put = setter(extension, obj)
    put(extension.names.COLOUR_BY, extension.names.AMPLITUDE_COLOUR)
    put(extension.names.COLOUR_RANGE, 0.5)
    assert "0 to 0.5 scene units (50 mm)" in drawn(extension, obj)


def test_static_file_has_no_motion_controls(extension: ModuleType, tmp_path: Path) -> None:
    write_splat(tmp_path / "still.ply", some_splat(5, (), degree=0))
    shown = drawn(extension, import_splat(tmp_path / "still.ply"))
    assert "This file holds no motion" in shown
    assert not {extension.names.ALPHA, extension.names.VIEW_COLOUR, extension.names.COLOUR_BY} & set(shown)
