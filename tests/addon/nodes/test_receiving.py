"""What is imported can be seen, whatever collection is the active one."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import drawn_whole, import_splat, transforms  # noqa: E402


def exclude(layer: Any) -> None:
    layer.exclude = True


def shut_eye(layer: Any) -> None:
    layer.hide_viewport = True


def disable(layer: Any) -> None:
    layer.collection.hide_viewport = True


HIDE = [exclude, shut_eye, disable]


def nested(*names: str) -> list[Any]:
    """The layer collections of new collections, each in the one before, the first in the scene's; last active."""
    layers = [bpy.context.view_layer.layer_collection]
    for name in names:
        layers[-1].collection.children.link(bpy.data.collections.new(name))
        layers.append(layers[-1].children[name])
    bpy.context.view_layer.active_layer_collection = layers[-1]
    return layers[1:]


def imported_into(path: Path, collection: Any) -> list[Any]:
    """The collections that hold what was imported while `collection` was the context's; it is seen and active."""
    with bpy.context.temp_override(collection=collection):
        obj = import_splat(path)
    assert obj.name == path.stem
    assert obj.visible_get()
    return list(obj.users_collection)


def test_a_visible_collection_takes_the_import(extension: ModuleType, splat_path: Path) -> None:
    outer, inner = nested("outer", "inner")
    assert imported_into(splat_path, inner.collection) == [inner.collection]
    assert import_splat(splat_path).users_collection == (inner.collection,)  # as the active one
    assert imported_into(splat_path.rename(splat_path.with_stem("b")), outer.collection) == [outer.collection]


@pytest.mark.parametrize("hide", HIDE)
def test_the_nearest_visible_takes_it_in_place_of_a_hidden_one(
    extension: ModuleType, splat_path: Path, hide: Any
) -> None:
    outer, inner = nested("outer", "inner")
    hide(inner)
    assert imported_into(splat_path, inner.collection) == [outer.collection]
    assert len(transforms(drawn(extension, "bell"), 1)) == 23


@pytest.mark.parametrize("hide", HIDE)
def test_the_scene_takes_it_where_all_are_hidden(extension: ModuleType, splat_path: Path, hide: Any) -> None:
    outer, inner = nested("outer", "inner")
    hide(inner)
    hide(outer)
    assert imported_into(splat_path, inner.collection) == [bpy.context.scene.collection]


@pytest.mark.parametrize("hide", [shut_eye, disable])
def test_what_lies_in_a_hidden_one_is_hidden(extension: ModuleType, splat_path: Path, hide: Any) -> None:
    outer, inner = nested("outer", "inner")
    hide(outer)
    assert imported_into(splat_path, inner.collection) == [bpy.context.scene.collection]


def test_one_that_is_seen_elsewhere_takes_it(extension: ModuleType, splat_path: Path) -> None:
    outer, inner = nested("outer", "inner")
    bpy.context.scene.collection.children.link(inner.collection)
    shut_eye(outer)
    assert imported_into(splat_path, inner.collection) == [inner.collection]


def test_one_of_no_scene_does_not_take_it(extension: ModuleType, splat_path: Path) -> None:
    loose = bpy.data.collections.new("loose")
    assert imported_into(splat_path, loose) == [bpy.context.scene.collection]


def test_a_linked_one_does_not_take_it(extension: ModuleType, splat_path: Path, tmp_path: Path) -> None:
    (layer,) = nested("theirs")
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {layer.collection})
    bpy.data.collections.remove(layer.collection)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.collections = ["theirs"]
    linked = wanted.collections[0]
    bpy.context.scene.collection.children.link(linked)
    assert imported_into(splat_path, linked) == [bpy.context.scene.collection]


def test_the_probe_sphere_is_seen_too(extension: ModuleType, splat_path: Path) -> None:
    import_splat(splat_path)
    (layer,) = nested("hidden")
    shut_eye(layer)
    with bpy.context.temp_override(collection=layer.collection):
        assert bpy.ops.tg4mm.add_probe_sphere() == {"FINISHED"}
    assert bpy.data.objects["bell probe"].visible_get()


def drawn(extension: ModuleType, name: str) -> Any:
    """An object by name, drawing every Gaussian."""
    obj = bpy.data.objects[name]
    drawn_whole(extension, obj)
    return obj
