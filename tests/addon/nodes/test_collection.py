"""What is imported can be seen, whatever collection is the active one."""

import pytest

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import import_splat  # noqa: E402


def hide(layer, how):
    """Leave a layer collection out, shut its eye, or take it from all views."""
    setattr(
        layer.collection if how == "disable" else layer,
        "exclude" if how == "exclude" else "hide_viewport",
        True,
    )


def nested(*names):
    """The scene's layer collection and those of new collections, each in the one before; the last is active."""
    layers = [bpy.context.view_layer.layer_collection]
    for name in names:
        layers[-1].collection.children.link(bpy.data.collections.new(name))
        layers.append(layers[-1].children[name])
    bpy.context.view_layer.active_layer_collection = layers[-1]
    return layers


def holders(path, collection):
    """The collections that hold what was imported while `collection` was the context's; it is seen."""
    with bpy.context.temp_override(collection=collection):
        obj = import_splat(path)
    assert obj.visible_get()
    return list(obj.users_collection)


@pytest.mark.parametrize(
    ("hidden", "takes"),  # of the scene's 0, outer 1 and inner 2, which is active
    [
        ([], 2),
        *(([(how, 2)], 1) for how in ("exclude", "shut", "disable")),
        *(([(how, 2), (how, 1)], 0) for how in ("exclude", "shut", "disable")),
        *(([(how, 1)], 0) for how in ("shut", "disable")),  # what lies in a hidden one is hidden
    ],
)
def test_the_nearest_visible_collection_takes_the_import(extension, splat_path, hidden, takes):
    layers = nested("outer", "inner")
    for how, number in hidden:
        hide(layers[number], how)
    assert holders(splat_path, layers[2].collection) == [layers[takes].collection]


def test_one_that_is_seen_elsewhere_takes_it(extension, splat_path):
    _, outer, inner = nested("outer", "inner")
    bpy.context.scene.collection.children.link(inner.collection)
    hide(outer, "shut")
    assert holders(splat_path, inner.collection) == [inner.collection]


@pytest.mark.parametrize("linked", [False, True])
def test_one_of_no_scene_or_of_a_library_does_not_take_it(extension, splat_path, tmp_path, linked):
    other = bpy.data.collections.new("theirs")
    if linked:
        bpy.data.libraries.write(str(tmp_path / "library.blend"), {other})
        bpy.data.collections.remove(other)
        with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
            wanted.collections = ["theirs"]
        other = wanted.collections[0]
        bpy.context.scene.collection.children.link(other)
    assert holders(splat_path, other) == [bpy.context.scene.collection]
