"""Blender 5.3's own splats, as far as this can be tested without that Blender: never run there (docs/blender.md)."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tg4mm.core.splatfile import read_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import import_splat, setter  # noqa: E402


def test_native_is_offered_where_blender_has_it_only(extension: ModuleType, splat_path: Path) -> None:
    obj, names = import_splat(splat_path), extension.names
    assert extension.compat.native_splats() == (bpy.app.version >= (5, 3, 0))
    if not extension.compat.native_splats():
        with pytest.raises(ValueError, match="'Native'; expected one of Ellipsoids, Splats, Points, Arrows"):
            setter(extension, obj)(names.DRAW, names.NATIVE)
        assert not [a.name for a in obj.data.attributes if a.name.startswith(names.NATIVE_PREFIX)]


def test_native_attributes_are_the_raw_coefficients_and_the_opacity(
    extension: ModuleType, splat_path: Path
) -> None:
    splat = read_splat(splat_path)
    made = extension.nodes.points.native_attributes(splat)
    assert list(made) == ["radiance:base", "radiance:sh_0", "radiance:sh_1", "radiance:sh_2"]
    np.testing.assert_array_equal(made["radiance:base"][:, :3], splat.sh[:, 0])
    np.testing.assert_array_equal(made["radiance:base"][:, 3], splat.opacities)
    np.testing.assert_array_equal(made["radiance:sh_2"], splat.sh[:, 3])


def choice(*items: str, readonly: bool = False) -> SimpleNamespace:
    return SimpleNamespace(
        type="ENUM",
        identifier="kind",
        is_readonly=readonly,
        enum_items=[SimpleNamespace(identifier=item) for item in items],
    )


def test_the_type_is_chosen_whatever_it_is_called(extension: ModuleType) -> None:
    fixed, free = choice("A_SPLAT", readonly=True), choice("POINTS", "GAUSSIAN_SPLAT")
    node = SimpleNamespace(bl_rna=SimpleNamespace(properties=[fixed, free]), kind="POINTS")
    extension.compat.choose_splats(node)
    assert node.kind == "GAUSSIAN_SPLAT"
    node.bl_rna.properties = [choice("POINTS", "DISCS")]
    with pytest.raises(RuntimeError, match="has no Gaussian splats, only POINTS, DISCS"):
        extension.compat.choose_splats(node)
